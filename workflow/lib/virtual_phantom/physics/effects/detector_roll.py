"""Detector roll."""

from dataclasses import replace

from ..effect import Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Turn the detector in its plane."""
    state.mounting = replace(state.mounting, roll_deg=values["angle_deg"])


EFFECT = Effect(
    name="detector_roll",
    physics="The detector is turned in its plane: its rows are not at right angles to the axis of rotation.",
    equation="pixel (u, v) at c + u' a + v' b, u' = u cos r - v sin r, v' = u sin r + v cos r; a and b: the stated "
    "directions of columns and rows, c: the detector's reference point",
    source="K. Yang et al., Med. Phys. 33, 1695 (2006); M. Ferrucci et al., Meas. Sci. Technol. 26, 092003 (2015)",
    stage="geometry",
    signature="edges along the axis of rotation lie beside their place, with opposite signs in upper and lower rows; "
    "edges across it rise from one end of the rows to the other, the same in all views",
    settled_by="a wire along the axis of rotation: the angle between its shadow and the columns",
    parameters=(
        Parameter(
            "angle_deg", "degrees", "turn in the plane, from growing columns to growing rows", -2.0, 2.0, 0.0, 0.5
        ),
    ),
    apply=apply,
)
