"""Angular tube current modulation."""

import numpy as np

from ...base.geometry import orbit_of
from ..effect import Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Modulate the fluence from view to view."""
    angles = orbit_of(state.geometry, "current_modulation").angles_rad
    wave = values["cosine"] * np.cos(2 * angles) + values["sine"] * np.sin(2 * angles)
    state.fluence = state.fluence * (1 + wave)[:, None, None]


EFFECT = Effect(
    name="current_modulation",
    physics="The tube current follows the patient width during rotation. The monitor corrects the mean signal.",
    equation="fluence(b) = 1 + c cos 2b + s sin 2b",
    source="M. Gies et al., Med. Phys. 26, 2235 (1999)",
    stage="fluence",
    signature="noise changes twice per turn and the mean does not",
    settled_by="make air scans with the same modulation",
    parameters=(
        Parameter("cosine", "1", "c: amplitude of cos 2b", -0.65, 0.65, 0.1, 0.4),
        Parameter("sine", "1", "s: amplitude of sin 2b", -0.65, 0.65, 0.0, 0.0),
    ),
    apply=apply,
)
