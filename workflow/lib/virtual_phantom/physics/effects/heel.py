"""Heel effect of the anode."""

from ..chain import State
from ..effect import Effect, Parameter


def apply(state: State, values: dict[str, float]) -> None:
    position = state.geometry.row_positions_mm()
    reach = abs(position).max() or 1.0
    state.fluence = state.fluence * (1 + values["slope"] * position / reach)[None, :, None]


EFFECT = Effect(
    name="heel",
    physics="The anode absorbs part of its own beam: fluence falls towards its side, along the rows.",
    equation="fluence(v) = 1 + h v / v_max",
    source="J. Beutel, H. L. Kundel and R. L. Van Metter, Handbook of Medical Imaging 1, SPIE (2000), chapter 1",
    stage="fluence",
    signature="white field and noise change steadily from row to row; the mean of the line integrals stays",
    settled_by="the white field",
    parameters=(Parameter("slope", "1", "relative change from the middle to the edge row", -0.6, 0.6, 0.1, 0.2),),
    apply=apply,
)
