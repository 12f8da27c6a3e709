"""Detector tilt."""

from dataclasses import replace

from ..effect import Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Tilt the detector toward the source or away from it."""
    state.mounting = replace(state.mounting, tilt_deg=values["angle_deg"])


EFFECT = Effect(
    name="detector_tilt",
    physics="The detector is tilted, so its upper rows are nearer to the source than its lower ones, or farther away.",
    equation="pixel (u, v) at c + u a + v (b cos t - n sin t), n: direction away from the source; applied after the "
    "roll",
    source="K. Yang et al., Med. Phys. 33, 1695 (2006); M. Ferrucci et al., Meas. Sci. Technol. 26, 092003 (2015)",
    stage="geometry",
    signature="the shadow is narrower in rows near the source and wider in the others, in all views",
    settled_by="scan a ball at two heights over a full turn: the ratio of its track widths differs from the "
    "ratio of the magnifications",
    parameters=(
        Parameter("angle_deg", "degrees", "rotation t of the row direction to the source", -5.0, 5.0, 0.0, 1.0),
    ),
    apply=apply,
)
