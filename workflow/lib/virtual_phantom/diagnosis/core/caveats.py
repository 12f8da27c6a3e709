"""What speaks against taking a diagnosis at its word."""

from __future__ import annotations

import numpy as np

from .attribute import Choice
from .prepared import Prepared

ALIKE = 0.9  # correlation of recording and simulation; less is another object, place or geometry
HARDENED = 10.0  # log score by which a spectrum must lose for it to be missed


def caveats(prepared: Prepared, choice: Choice, tube_kvp: float | None = None) -> list[str]:
    """Sentences for the report, none if all is well.

    Parameters
    ----------
    prepared : Prepared
    choice : Choice
    tube_kvp : float, optional
        As the label says, kV.

    Returns
    -------
    list of str
    """
    found = prepared.caveats()
    if prepared.lacking:
        found.append(f"In recording.yaml {prepared.lacking}.")
    alike = likeness(prepared, choice)
    if alike < ALIKE:
        found.append(
            f"Recording and simulation correlate by {alike:.2f} only, whatever the effects: this is another object, at "
            "another place, or scanned in another geometry. Mend that first."
        )
    if tube_kvp is not None and "spectrum" in choice.alone and "spectrum" not in choice.chosen.fit.effects:
        if choice.chosen.score - choice.baseline.score - choice.alone["spectrum"] > HARDENED and not _stands_in(choice):
            found.append(
                f"The label says a tube of {tube_kvp:g} kV, but no beam hardening is seen: the recording may have been "
                "corrected for it already."
            )
    return found


def likeness(prepared: Prepared, choice: Choice) -> float:
    """Correlation of what was recorded with what the chosen model says, where rays or voxels count."""
    recorded = prepared.recorded()
    modelled = recorded - prepared.difference(choice.chosen.fit, held_out=False)
    return float(np.corrcoef(recorded, modelled)[0, 1])


def _stands_in(choice: Choice) -> bool:
    return any("spectrum" in choice.ambiguous_with(name) for name in choice.chosen.fit.effects)
