"""X-ray crosstalk between detector pixels."""

from ..effect import Effect, Parameter
from ..state import State, with_crosstalk


def apply(state: State, values: dict[str, float]) -> None:
    """Share signal and noise among neighboring pixels, also in the air scan."""
    crosstalk = (values["column"], values["row"]), values.get("tail", 0.0)
    equal_weights = state.noise is state.signal
    state.signal, state.air = with_crosstalk(state.signal, *crosstalk), with_crosstalk(state.air, *crosstalk)
    state.noise = state.signal if equal_weights else with_crosstalk(state.noise, *crosstalk)


TAIL = "tail q: signal that each further pixel on a side receives, relative to the pixel before it"

EFFECT = Effect(
    name="xray_crosstalk",
    physics="Photons deposit energy in neighboring pixels (fluorescence, Compton scatter in the scintillator).",
    equation="S' = (1 - 2c) S + sum over n = 1, 2, ... of c (1 - q) q^(n - 1) (S[-n] + S[n]) along columns and rows; "
    "noise of pixels stays independent",
    source="M. Wu et al., XCIST, Phys. Med. Biol. 67, 194002 (2022), with q = 0; exponential tails of line spread "
    "functions: H. Fujita et al., IEEE Trans. Med. Imaging 11, 34 (1992)",
    stage="crosstalk",
    signature="residuals of both signs at edges, a few pixels wide; noise stays white",
    settled_by="scan an edge or wire near the source and near the detector: crosstalk is the same, focal-spot blur is "
    "not",
    parameters=(
        Parameter("column", "1", "share c that goes to the columns on each side", 0.0, 0.2, 0.03, 0.03),
        Parameter("row", "1", "share that goes to the rows on each side", 0.0, 0.2, 0.03, 0.03),
        Parameter("tail", "1", TAIL, 0.0, 0.5, 0.25, 0.0, None, unstated=0.0),
    ),
    apply=apply,
)
