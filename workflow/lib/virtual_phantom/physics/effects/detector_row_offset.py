"""Detector row offset."""

from dataclasses import replace

from ..effect import Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Shift the detector rows."""
    geometry = state.geometry
    shift_px = values["rows_mm"] / geometry.row_pitch_mm
    state.geometry = replace(geometry, row_offset_px=geometry.row_offset_px + shift_px)


EFFECT = Effect(
    name="detector_row_offset",
    physics="The detector is shifted along the axis of rotation.",
    equation="v' = v + d",
    source="K. Yang et al., Med. Phys. 33, 1695 (2006); M. Ferrucci et al., Meas. Sci. Technol. 26, 092003 (2015)",
    stage="geometry",
    signature="as for an object displaced along the axis, which the pose absorbs, but with a shift on the detector "
    "that does not depend on magnification",
    settled_by="scan two balls at different distances from the axis over a full turn: the centers of their tracks "
    "give the height of the central ray",
    parameters=(Parameter("rows_mm", "mm", "shift d along the rows, at the detector", -10.0, 10.0, 0.0, 1.0),),
    apply=apply,
)
