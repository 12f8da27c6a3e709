"""Tube current modulation along the axis."""

import numpy as np

from ...base.geometry import orbit_of
from ..effect import Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Modulate the fluence with the source height."""
    z = orbit_of(state.geometry, "current_along_z").source_z_mm
    z = z - (z.min() + z.max()) / 2
    factor = np.exp(values["linear_per_mm"] * z + values["quadratic_per_mm2"] * z**2)
    state.fluence = state.fluence * factor[:, None, None]


EFFECT = Effect(
    name="current_along_z",
    physics="The tube current follows the patient thickness along z. The monitor corrects the mean signal.",
    equation="fluence(z) = exp(a z + b z^2), z: height of the focal spot above the center of the scan",
    source="M. K. Kalra et al., Radiology 233, 649 (2004), z-axis modulation",
    stage="fluence",
    signature="noise changes along z and the mean does not",
    settled_by="read the tube current of every view from the raw data headers, or make an air scan with the same "
    "modulation",
    parameters=(
        Parameter("linear_per_mm", "1/mm", "a: linear coefficient", -0.05, 0.05, 0.002, 0.005),
        Parameter("quadratic_per_mm2", "1/mm2", "b: quadratic coefficient", -0.001, 0.001, 0.0, 0.0),
    ),
    apply=apply,
)
