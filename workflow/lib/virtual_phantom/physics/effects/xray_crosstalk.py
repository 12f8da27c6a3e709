"""X-ray crosstalk between detector pixels."""

from ..effect import Effect, Parameter
from ..state import State, with_crosstalk


def apply(state: State, values: dict[str, float]) -> None:
    """Share signal and noise among neighboring pixels, also in the air scan."""
    neighbor_shares = (values["column"], values["row"])
    equal_weights = state.noise is state.signal
    state.signal, state.air = with_crosstalk(state.signal, neighbor_shares), with_crosstalk(state.air, neighbor_shares)
    state.noise = state.signal if equal_weights else with_crosstalk(state.noise, neighbor_shares)


EFFECT = Effect(
    name="xray_crosstalk",
    physics="Photons deposit energy in neighboring pixels (fluorescence, Compton scatter in the scintillator).",
    equation="S' = (c, 1 - 2c, c) * S along columns and rows; noise of pixels stays independent",
    source="M. Wu et al., XCIST, Phys. Med. Biol. 67, 194002 (2022)",
    stage="crosstalk",
    signature="residuals of both signs at edges, one or two pixels wide; noise stays white",
    settled_by="scan an edge or wire near the source and near the detector: crosstalk is the same, focal-spot blur is "
    "not",
    parameters=(
        Parameter("column", "1", "share c that goes to each neighboring column", 0.0, 0.2, 0.03, 0.03),
        Parameter("row", "1", "share that goes to each neighboring row", 0.0, 0.2, 0.03, 0.03),
    ),
    apply=apply,
)
