"""Afterglow of the scintillator."""

from ..chain import State
from ..effect import Effect, Parameter


def apply(state: State, values: dict[str, float]) -> None:
    state.neighbours = (*state.neighbours[:2], values["share"])


EFFECT = Effect(
    name="afterglow",
    physics="Part of the signal is read with the next view.",
    equation="read_i = (1 - k) S_i + k S_(i-1)",
    source="J. Hsieh, O. E. Gurmen and K. F. King, IEEE Trans. Med. Imaging 19, 930 (2000), first term",
    stage="noise",
    signature="edges lag behind the rotation, and noise of successive views is correlated",
    settled_by="the same scan turning the other way: the lag changes its sign, a turned object does not",
    parameters=(Parameter("share", "1", "share of a view's signal that is read with the next", 0.0, 0.4, 0.02, 0.05),),
    apply=apply,
)
