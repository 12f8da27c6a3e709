"""Tube current that follows the object along the axis."""

import numpy as np

from ...base.geometry import orbit_of
from ..effect import HELIX, Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Modulate the fluence with the height of the source."""
    z = orbit_of(state.geometry, "current_along_z").source_z_mm
    z = z - (z.min() + z.max()) / 2
    factor = np.exp(values["linear_per_mm"] * z + values["quadratic_per_mm2"] * z**2)
    state.fluence = state.fluence * factor[:, None, None]


EFFECT = Effect(
    name="current_along_z",
    physics="The tube current follows the patient's thickness along the axis; the monitor corrects the mean.",
    equation="fluence(z) = exp(a z + b z^2), z: the focal spot's height over the middle of the scan",
    source="M. K. Kalra et al., Radiology 233, 649 (2004), z-axis modulation",
    stage="fluence",
    signature="noise changes along the axis; the mean stays",
    settled_by="the tube current of every view, as headers of raw data say it, or an air scan with the same modulation",
    parameters=(
        Parameter("linear_per_mm", "1/mm", "a", -0.05, 0.05, 0.002, 0.005),
        Parameter("quadratic_per_mm2", "1/mm2", "b", -0.001, 0.001, 0.0, 0.0),
    ),
    apply=apply,
    needs=(HELIX,),
)
