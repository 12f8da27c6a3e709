"""What speaks against taking a diagnosis at its word."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..residuals.dataset import Prepared
from ..residuals.residual_tests import EDGES, Location
from ..selection.forward_selection import Choice

ALIKE = 0.9  # correlation of recording and simulation; less is another object, place or geometry
# Of chi-square beyond noise, what the steepest tenth must hold to lie along edges. Cylinders drawn in voxels of 0.25 to
# 2 mm left 0.32 to 1.1 there once the physics was fitted; scatter and a spectrum that were not fitted, and were more
# than what voxels leave, 0.08 to 0.15.
ALONG_EDGES = 0.25
HARDENED = 10.0  # log score by which a spectrum must lose for it to be missed


def caveats(
    prepared: Prepared, choice: Choice, tube_kvp: float | None = None, left: Sequence[Location] = ()
) -> list[str]:
    """Sentences for the report, none if all is well.

    Parameters
    ----------
    tube_kvp : float, optional
        As the label says, kV.
    left : sequence of Location, optional
        Where something is left, the worst first.
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
    if prepared.voxels and EDGES in [place.domain for place in left] and _along_edges(prepared, choice):
        found.append(
            f"What is left lies along edges, {prepared.voxels} would show whether anything else is left "
            "(docs/how-to/objects.md)."
        )
    return found


def likeness(prepared: Prepared, choice: Choice) -> float:
    """Correlation of what was recorded with what the chosen model says, where rays or voxels count."""
    recorded = prepared.recorded()
    modelled = recorded - prepared.difference(choice.chosen.fit, held_out=False)
    return float(np.corrcoef(recorded, modelled)[0, 1])


def _along_edges(prepared: Prepared, choice: Choice) -> bool:
    share = prepared.share_at_edges(choice.chosen.fit)
    return share is not None and share >= ALONG_EDGES


def _stands_in(choice: Choice) -> bool:
    return any("spectrum" in choice.ambiguous_with(name) for name in choice.chosen.fit.effects)
