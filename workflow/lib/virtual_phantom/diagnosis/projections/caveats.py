"""What speaks against taking a diagnosis at its word: a recording incomplete, of something else, or corrected."""

from __future__ import annotations

import numpy as np

from ...base.errors import InputError
from ..core.attribute import Choice
from .observed import LEAST_TRANSMISSION, Scans
from .prepared import Prepared

LEAST_VIEWS = 16  # fewer cannot tell the object's place from its physics
MOST_LOST = 0.5  # share of rays that measured nothing
MENTIONED_LOST = 0.001
ALIKE = 0.9  # correlation of recording and simulation; less is another object, place or geometry
HARDENED = 10.0  # log score by which a spectrum must lose for it to be missed


def check_scans(taken: Scans, source: str) -> None:
    """Raise InputError for repeats that no diagnosis can be made of: too few views, or most rays without signal."""
    views = taken.usable.shape[0]
    if views < LEAST_VIEWS:
        raise InputError(f"{source}: {views} views are too few for a diagnosis; it needs {LEAST_VIEWS}")
    lost = 1 - taken.usable.mean()
    if lost > MOST_LOST:
        raise InputError(
            f"{source}: {100 * lost:.0f} % of the rays measured nothing (under {LEAST_TRANSMISSION:g} of air) or were "
            "saturated; is the white field another scan's, or the object opaque?"
        )


def caveats(prepared: Prepared, choice: Choice, tube_kvp: float | None = None) -> list[str]:
    """Sentences for the report, none if all is well.

    tube_kvp   as the label says
    """
    found = []
    if prepared.look.unit == "line_integral":
        lost = 1 - prepared.usable.mean()
        if lost > MENTIONED_LOST:
            found.append(
                f"{100 * lost:.2g} % of the rays measured nothing, or stood at the detector's saturation, in "
                "some repeat; they were left out."
            )
    if prepared.lacking:
        found.append(f"In recording.yaml {prepared.lacking}.")
    alike = likeness(prepared, choice)
    if alike < ALIKE:
        found.append(
            f"Recording and simulation correlate by {alike:.2f} only, whatever the effects: this is another object, at "
            "another place, or scanned in another geometry. Mend that first."
        )
    if tube_kvp is not None and "spectrum" in choice.singles and "spectrum" not in choice.chosen.fit.effects:
        if choice.chosen.score - choice.singles["spectrum"].score > HARDENED and not _stands_in(choice):
            found.append(
                f"The label says a tube of {tube_kvp:g} kV, but no beam hardening is seen: the recording may have been "
                "corrected for it already."
            )
    return found


def likeness(prepared: Prepared, choice: Choice) -> float:
    """Correlation of what was recorded with what the chosen model says, where rays or voxels count."""
    data = prepared.data
    recorded = (data.mean if prepared.look.unit == "line_integral" else data.hu)[data.usable]
    modelled = recorded - prepared.look.difference(prepared, choice.chosen.fit, False)
    return float(np.corrcoef(recorded, modelled)[0, 1])


def _stands_in(choice: Choice) -> bool:
    return any("spectrum" in choice.ambiguous_with(name) for name in choice.chosen.fit.effects)
