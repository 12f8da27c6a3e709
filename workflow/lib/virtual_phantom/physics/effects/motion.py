"""Rigid motion of the object during the scan."""

from ..displacement import PATH, moved_mm, parameters
from ..effect import Effect
from ..state import State

# mm/s. Vessels move at 11 mm/s in quiet breathing, the heart wall at 53 mm/s at most (C. J. Ritchie et al.,
# Radiology 185, 37, 1992).
FASTEST = 100.0
FARTHEST_MM = 20.0  # plausible limit over the scan
DIRECTIONS = {axis: f"along {axis}" for axis in "xyz"}


def apply(state: State, values: dict[str, float]) -> None:
    """Move the object from view to view."""
    moved = moved_mm(state.geometry, values, DIRECTIONS)
    state.motion_mm = moved if state.motion_mm is None else state.motion_mm + moved


EFFECT = Effect(
    name="motion",
    physics="The object moves during the scan, at a velocity that may change uniformly.",
    equation=f"position_i = position + {PATH}",
    source="J. Hsieh, Computed Tomography, 3rd ed., SPIE (2015), patient motion",
    stage="motion",
    signature="residuals at edges that grow toward the first and last views, with opposite signs",
    settled_by="repeat the first view at the end of the scan",
    parameters=parameters(DIRECTIONS, FASTEST, FARTHEST_MM, typical_mm=1.0),
    apply=apply,
    of_one_scan=True,
)
