"""Afterglow of the scintillator."""

from ..chain import State
from ..effect import Effect, Parameter


def apply(state: State, values: dict[str, float]) -> None:
    state.lag = (values["share"], values["memory"], values["before"])


EFFECT = Effect(
    name="afterglow",
    physics="Part of the signal glows on and is read with the next views.",
    equation="read_i = (1 - k) S_i + k G_i, G_(i+1) = d G_i + (1 - d) S_i, G_0 = b S_0",
    source="J. Hsieh, O. E. Gurmen and K. F. King, IEEE Trans. Med. Imaging 19, 930 (2000), one of its exponentials",
    stage="noise",
    signature="edges lag behind the rotation, and noise of successive views is correlated",
    settled_by="the same scan turning the other way: the lag changes its sign, a turned object does not",
    parameters=(
        Parameter("share", "1", "share of a view's signal that is read with later ones", 0.0, 0.4, 0.02, 0.05),
        Parameter("memory", "1", "what of the glow each further view leaves", 0.0, 0.95, 0.0, 0.0, None),
        Parameter(
            "before",
            "1",
            "glow before the first view, over that of its lasting signal",
            0.0,
            1.0,
            1.0,
            1.0,
            None,
        ),
    ),
    apply=apply,
)
