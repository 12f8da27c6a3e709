"""Views beside their angles, by a wave of one period per turn."""

from dataclasses import replace

import numpy as np

from ...base.geometry import orbit_of
from ..effect import Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Turn source and detector, or the object the other way, in every view."""
    geometry = orbit_of(state.geometry, "view_angle_error")
    angles = geometry.angles_rad
    error_deg = values["cosine_deg"] * np.cos(angles) + values["sine_deg"] * np.sin(angles)
    state.geometry = replace(geometry, angles_rad=angles + np.radians(error_deg))


# Angles that err at random, each by itself, are as many unknowns as there are views: no template holds them. The kinds
# of change from view to view find them.
EFFECT = Effect(
    name="view_angle_error",
    physics="The encoder's disc lies beside the axis of rotation: views are taken before or behind their angles, by a "
    "wave of one period per turn.",
    equation="b' = b + c cos b + s sin b",
    source="M. Ferrucci et al., Meas. Sci. Technol. 26, 092003 (2015)",
    stage="geometry",
    signature="residuals at edges far from the axis that change their sign several times per turn; none of what is on "
    "the axis",
    settled_by="a ball far from the axis: its track against an even turn",
    parameters=(
        Parameter("cosine_deg", "degrees", "amplitude of cos b", -1.0, 1.0, 0.0, 0.1),
        Parameter("sine_deg", "degrees", "amplitude of sin b", -1.0, 1.0, 0.0, 0.0),
    ),
    apply=apply,
)
