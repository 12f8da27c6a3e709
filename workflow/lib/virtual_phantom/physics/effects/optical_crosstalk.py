"""Optical crosstalk: light shared by neighboring pixels after detection."""

from ..effect import Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Set the shares of neighboring pixels after the quantum noise."""
    state.neighbours = (values["column"], values["row"])


EFFECT = Effect(
    name="optical_crosstalk",
    physics="Scintillator light reaches neighboring pixels, which share the signal and its quantum noise.",
    equation="read = (c, 1 - 2c, c) * Poisson(S) along columns and rows",
    source="M. Wu et al., XCIST, Phys. Med. Biol. 67, 194002 (2022)",
    stage="noise",
    signature="noise of neighboring pixels is correlated and lower; edges are slightly blurred",
    settled_by="make two air scans: their difference shows the correlation of neighboring pixels",
    parameters=(
        Parameter("column", "1", "share c that goes to each neighboring column", 0.0, 0.2, 0.03, 0.03),
        Parameter("row", "1", "share that goes to each neighboring row", 0.0, 0.2, 0.03, 0.03),
    ),
    apply=apply,
)
