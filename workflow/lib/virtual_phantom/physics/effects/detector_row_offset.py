"""Detector row offset."""

from dataclasses import replace

from ..effect import Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Shift the detector's rows."""
    geometry = state.geometry
    shift_px = values["rows_mm"] / geometry.row_pitch_mm
    state.geometry = replace(geometry, row_offset_px=geometry.row_offset_px + shift_px)


EFFECT = Effect(
    name="detector_row_offset",
    physics="The detector is shifted along the axis of rotation against what the geometry says.",
    equation="v' = v + d",
    source="K. Yang et al., Med. Phys. 33, 1695 (2006); M. Ferrucci et al., Meas. Sci. Technol. 26, 092003 (2015)",
    stage="geometry",
    signature="as of an object displaced along the axis, which the alignment takes up, but by the same on the detector "
    "near the source and far from it",
    settled_by="two balls at different distances from the axis over a turn: the middles of their tracks say the height "
    "of the central ray",
    parameters=(Parameter("rows_mm", "mm", "shift along the rows, at the detector", -10.0, 10.0, 0.0, 1.0),),
    apply=apply,
)
