"""Detector skew."""

from dataclasses import replace

from ..effect import Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Turn the detector about its columns."""
    state.mounting = replace(state.mounting, skew_deg=values["angle_deg"])


EFFECT = Effect(
    name="detector_skew",
    physics="The detector is turned like a door: one end of its rows is nearer to the source than the other.",
    equation="pixel (u, v) at c + u (a cos s - n sin s) + v b, n: away from the source; after roll and tilt",
    source="K. Yang et al., Med. Phys. 33, 1695 (2006); M. Ferrucci et al., Meas. Sci. Technol. 26, 092003 (2015)",
    stage="geometry",
    signature="both edges of the shadow are displaced the same way, by the square of their distance from the middle, "
    "in all views",
    settled_by="a ball far from the axis over a turn: its track is not alike on both sides",
    parameters=(Parameter("angle_deg", "degrees", "of growing columns towards the source", -5.0, 5.0, 0.0, 1.0),),
    apply=apply,
)
