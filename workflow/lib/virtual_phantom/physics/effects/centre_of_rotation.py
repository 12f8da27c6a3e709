"""Center of rotation off the central ray."""

from ..effect import Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Move the object along the detector columns."""
    moved = values["shift_mm"] * state.geometry.column_direction
    state.motion_mm = moved if state.motion_mm is None else state.motion_mm + moved


EFFECT = Effect(
    name="centre_of_rotation",
    physics="The axis of rotation does not lie on the central ray.",
    equation="object displaced by s along the detector columns in every view",
    source="S. G. Azevedo et al., IEEE Trans. Nucl. Sci. 37, 1525 (1990)",
    stage="motion",
    signature="as for a detector offset, but larger for parts near the source",
    settled_by="scan a ball near the axis and one far from it over a full turn",
    parameters=(Parameter("shift_mm", "mm", "distance s of the axis from the central ray", -5.0, 5.0, 0.0, 0.25),),
    apply=apply,
)
