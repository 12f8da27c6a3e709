"""View angle error with one period per turn."""

from dataclasses import replace

import numpy as np

from ...base.geometry import orbit_of
from ..effect import Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Rotate source and detector in every view."""
    geometry = orbit_of(state.geometry, "view_angle_error")
    angles = geometry.angles_rad
    error_deg = values["cosine_deg"] * np.cos(angles) + values["sine_deg"] * np.sin(angles)
    state.geometry = replace(geometry, angles_rad=angles + np.radians(error_deg))


# Random angle errors of single views are not an effect, because they have as many unknowns as views. The residual
# tests by view detect them.
EFFECT = Effect(
    name="view_angle_error",
    physics="The encoder disc is off the axis of rotation, so views are taken before or after their stated angles, "
    "with one period per turn.",
    equation="b' = b + c cos b + s sin b",
    source="M. Ferrucci et al., Meas. Sci. Technol. 26, 092003 (2015)",
    stage="geometry",
    signature="residuals at edges far from the axis that change their sign several times per turn; none on the axis",
    settled_by="scan a ball far from the axis and compare its track with a uniform rotation",
    parameters=(
        Parameter("cosine_deg", "degrees", "c: amplitude of cos b", -1.0, 1.0, 0.0, 0.1),
        Parameter("sine_deg", "degrees", "s: amplitude of sin b", -1.0, 1.0, 0.0, 0.0),
    ),
    apply=apply,
)
