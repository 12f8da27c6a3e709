"""Detector skew."""

from dataclasses import replace

from ..effect import Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Rotate the detector about the row direction."""
    state.mounting = replace(state.mounting, skew_deg=values["angle_deg"])


EFFECT = Effect(
    name="detector_skew",
    physics="The detector is rotated about its vertical axis, so one end of its rows is nearer to the source than the "
    "other.",
    equation="pixel (u, v) at c + u (a cos s - n sin s) + v b, n: direction away from the source; applied after roll "
    "and tilt",
    source="K. Yang et al., Med. Phys. 33, 1695 (2006); M. Ferrucci et al., Meas. Sci. Technol. 26, 092003 (2015)",
    stage="geometry",
    signature="both edges of the shadow shift in the same direction, with the square of their distance from the "
    "center, in all views",
    settled_by="scan a ball far from the axis over a full turn: its track is asymmetric",
    parameters=(
        Parameter("angle_deg", "degrees", "rotation s of the column direction to the source", -5.0, 5.0, 0.0, 1.0),
    ),
    apply=apply,
)
