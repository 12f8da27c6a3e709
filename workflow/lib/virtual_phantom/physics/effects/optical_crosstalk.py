"""Optical crosstalk: light shared by neighboring pixels after detection."""

from ..effect import Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Set the shares of neighboring pixels after the quantum noise."""
    state.neighbours, state.tail = (values["column"], values["row"]), values.get("tail", 0.0)


TAIL = "tail q: light that each further pixel on a side receives, relative to the pixel before it"

EFFECT = Effect(
    name="optical_crosstalk",
    physics="Scintillator light reaches neighboring pixels, which share the signal and its quantum noise.",
    equation="read = (1 - 2c) N + sum over n = 1, 2, ... of c (1 - q) q^(n - 1) (N[-n] + N[n]) along columns and rows, "
    "N = Poisson(S)",
    source="M. Wu et al., XCIST, Phys. Med. Biol. 67, 194002 (2022), with q = 0; exponential tails of line spread "
    "functions: H. Fujita et al., IEEE Trans. Med. Imaging 11, 34 (1992)",
    stage="noise",
    signature="noise of neighboring pixels is correlated and lower; edges are slightly blurred",
    settled_by="make two air scans: their difference shows the correlation of neighboring pixels",
    parameters=(
        Parameter("column", "1", "share c that goes to the columns on each side", 0.0, 0.2, 0.03, 0.03),
        Parameter("row", "1", "share that goes to the rows on each side", 0.0, 0.2, 0.03, 0.03),
        Parameter("tail", "1", TAIL, 0.0, 0.5, 0.25, 0.0, None, unstated=0.0),
    ),
    apply=apply,
)
