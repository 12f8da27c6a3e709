"""A second, slower glow of the scintillator."""

from ..effect import LOGARITHM, PER_VIEW, Effect, Parameter, Reach
from ..state import State
from .afterglow import lag_of


def apply(state: State, values: dict[str, float]) -> None:
    """Set the slow lag of views."""
    state.slow_lag = lag_of(state, values)


EFFECT = Effect(
    name="slow_afterglow",
    physics="A second part of the signal glows on for much longer than the first.",
    equation="as of the afterglow, with k and T of its own: light(t) = (1 - k - k') S(t) + both glows; its own noise, "
    "of many views, is left out",
    source="J. Hsieh, O. E. Gurmen and K. F. King, IEEE Trans. Med. Imaging 19, 930 (2000), two of its exponentials",
    stage="noise",
    signature="beside a lag of a few views, a shadow or haze that turns with the object over tens of views",
    settled_by="a scan with the beam switched off in the middle: the decay of what is read",
    parameters=(
        Parameter("share", "1", "share of the scintillator's light that glows on for so long", 0.0, 0.5, 0.005, 0.01),
        Parameter(
            "time_constant_ms",
            "ms",
            "time in which this glow falls to 1/e",
            1.0,
            1e6,
            100.0,
            100.0,
            None,
            LOGARITHM,
            Reach(PER_VIEW, 5.0, 500.0, 20.0, 20.0),
        ),
        Parameter("before", "1", "this glow before the first view, over its lasting one", 0.0, 1.0, 1.0, 1.0, None),
    ),
    apply=apply,
    beside="afterglow",
)
