"""Optical crosstalk: light shared by neighbouring pixels after detection."""

from ..effect import Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Set what neighbours share after the quantum noise."""
    state.neighbours = (values["column"], values["row"])


EFFECT = Effect(
    name="optical_crosstalk",
    physics="Light of the scintillator reaches the neighbouring pixel: signal and its quantum noise are shared.",
    equation="read = (c, 1 - 2c, c) * Poisson(S) along columns and rows",
    source="M. Wu et al., XCIST, Phys. Med. Biol. 67, 194002 (2022)",
    stage="noise",
    signature="noise of neighbouring pixels is correlated and smaller; edges are blurred a little",
    settled_by="two air scans: the correlation of their difference between neighbours",
    parameters=(
        Parameter("column", "1", "share that goes to either neighbouring column", 0.0, 0.2, 0.03, 0.03),
        Parameter("row", "1", "share that goes to either neighbouring row", 0.0, 0.2, 0.03, 0.03),
    ),
    apply=apply,
)
