"""Detector roll."""

from dataclasses import replace

from ..effect import Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Rotate the detector in its plane."""
    state.mounting = replace(state.mounting, roll_deg=values["angle_deg"])


EFFECT = Effect(
    name="detector_roll",
    physics="The detector is rotated in its plane, so its rows are not perpendicular to the axis of rotation.",
    equation="pixel (u, v) at c + u' a + v' b, u' = u cos r - v sin r, v' = u sin r + v cos r. Vectors a and b are "
    "the nominal directions of columns and rows, c is the reference point of the detector",
    source="K. Yang et al., Med. Phys. 33, 1695 (2006); M. Ferrucci et al., Meas. Sci. Technol. 26, 092003 (2015)",
    stage="geometry",
    signature="edges along the axis are shifted with opposite signs in upper and lower rows; edges across it are "
    "tilted along the rows, equally in all views",
    settled_by="scan a wire along the axis: the angle between its shadow and the columns is the roll",
    parameters=(
        Parameter(
            "angle_deg", "degrees", "rotation r from the column direction toward the row direction", -2.0, 2.0, 0.0, 0.5
        ),
    ),
    apply=apply,
)
