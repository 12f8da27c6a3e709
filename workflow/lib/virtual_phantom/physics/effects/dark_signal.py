"""Residual dark signal and its drift."""

import math

from ..effect import DARK_DRIFT, DARK_LEVEL, OF_AIR, OF_AIR_PER_SCAN, OF_SCAN, Effect, Parameter, Reach
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Set the dark signal of the scan and of the air scan."""
    level, drift = values["level_units"], values["drift_units_per_s"]
    time = state.geometry.times_s[:, None, None] if drift else 0.0
    state.dark, state.dark_air = level + drift * time, level


LEVEL = {"reach": Reach(OF_AIR, -0.02, 0.1, 0.001, 0.005), "dark": DARK_LEVEL}
DRIFT = {"reach": Reach(OF_AIR_PER_SCAN, -0.02, 0.02, 0.0005, 0.001), "belongs_to": OF_SCAN, "dark": DARK_DRIFT}

EFFECT = Effect(
    name="dark_signal",
    physics="The detector reading without radiation differs from the subtracted one and drifts as the detector warms "
    "up. Its relative deviations s(u, v) between pixels are fitted, but not simulated.",
    equation="reading_i' = reading_i + (d + r t_i) (1 + s(u, v)), reading_air' = reading_air + d (1 + s(u, v))",
    source="J. H. Siewerdsen and D. A. Jaffray, Med. Phys. 26, 1624 (1999)",
    stage="readout",
    signature="line integrals are too low at low transmission, in all columns; a drift grows from view to view",
    settled_by="record dark frames before and after the scan",
    parameters=(
        Parameter("level_units", "readout units", "residual dark signal d", -math.inf, math.inf, 0.0, 500.0, **LEVEL),
        Parameter("drift_units_per_s", "readout units/s", "drift rate r", -math.inf, math.inf, 0.0, 100.0, **DRIFT),
    ),
    apply=apply,
    removed_by=("dark",),
    uneven=True,
)
