"""Detector tilt."""

from dataclasses import replace

from ..effect import Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Lean the detector towards the source or away from it."""
    state.mounting = replace(state.mounting, tilt_deg=values["angle_deg"])


EFFECT = Effect(
    name="detector_tilt",
    physics="The detector leans: its upper rows are nearer to the source than its lower ones, or farther.",
    equation="pixel (u, v) at c + u a + v (b cos t - n sin t), n: away from the source; after the roll",
    source="K. Yang et al., Med. Phys. 33, 1695 (2006); M. Ferrucci et al., Meas. Sci. Technol. 26, 092003 (2015)",
    stage="geometry",
    signature="a shadow that is narrower in the rows that lean towards the source and wider in the others, in all "
    "views",
    settled_by="a ball at two heights over a turn: its tracks' widths differ by more than their magnifications",
    parameters=(Parameter("angle_deg", "degrees", "of growing rows towards the source", -5.0, 5.0, 0.0, 1.0),),
    apply=apply,
)
