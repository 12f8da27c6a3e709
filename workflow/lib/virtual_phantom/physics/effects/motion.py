"""Rigid motion of the object during the scan."""

from ..effect import PER_SCAN, Effect, Parameter, Reach
from ..slowing import POSITION, SLOWING, constant_velocity_times
from ..state import State

# mm/s. Vessels move at 11 mm/s in quiet breathing, the heart wall at 53 mm/s at most (C. J. Ritchie et al.,
# Radiology 185, 37, 1992).
FASTEST = 100.0
FARTHEST_MM = 20.0  # plausible limit over the scan


def _reach(typical_mm: float) -> Reach:
    return Reach(PER_SCAN, -FARTHEST_MM, FARTHEST_MM, 0.0, typical_mm)


def apply(state: State, values: dict[str, float]) -> None:
    """Move the object from view to view."""
    # Relative to the middle of the scan, so that the mean position does not change.
    time = constant_velocity_times(state.geometry.times_s, values["slowing"])
    moved = time[:, None] * [values[f"{axis}_mm_per_s"] for axis in "xyz"]
    state.motion_mm = moved if state.motion_mm is None else state.motion_mm + moved


EFFECT = Effect(
    name="motion",
    physics="The object moves during the scan along a line, at a velocity that may change uniformly.",
    equation=f"position_i = position + {POSITION}",
    source="J. Hsieh, Computed Tomography, 3rd ed., SPIE (2015), patient motion",
    stage="motion",
    signature="residuals at edges that grow toward the first and last views, with opposite signs",
    settled_by="repeat the first view at the end of the scan",
    parameters=(
        Parameter("x_mm_per_s", "mm/s", "velocity along x", -FASTEST, FASTEST, 0.0, 1.0, reach=_reach(1.0)),
        Parameter("y_mm_per_s", "mm/s", "velocity along y", -FASTEST, FASTEST, 0.0, 0.0, reach=_reach(0.0)),
        Parameter("z_mm_per_s", "mm/s", "velocity along z", -FASTEST, FASTEST, 0.0, 0.0, reach=_reach(0.0)),
        SLOWING,
    ),
    apply=apply,
    of_one_scan=True,
)
