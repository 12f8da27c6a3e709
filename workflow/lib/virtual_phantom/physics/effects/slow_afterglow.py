"""Second, slower afterglow of the scintillator."""

from ..effect import LOGARITHM, PER_VIEW, Effect, Parameter, Reach
from ..state import State
from .afterglow import lag_of


def apply(state: State, values: dict[str, float]) -> None:
    """Set the slow lag of views."""
    state.slow_lag = lag_of(state, values)


IN_VIEWS = Reach(PER_VIEW, 5.0, 500.0, 20.0, 20.0)
BEFORE = "slow afterglow before the first view, relative to that of its steady signal"

EFFECT = Effect(
    name="slow_afterglow",
    physics="A second part of the scintillator light decays much more slowly than the first.",
    equation="as for afterglow, with its own k' and T': light(t) = (1 - k - k') S(t) + both delayed parts; noise "
    "correlations over its many views are neglected",
    source="J. Hsieh, O. E. Gurmen and K. F. King, IEEE Trans. Med. Imaging 19, 930 (2000), two of its exponentials",
    stage="noise",
    signature="besides a lag of a few views, a shadow or haze that rotates with the object over tens of views",
    settled_by="switch off the beam in the middle of a scan and record the decay",
    parameters=(
        Parameter(
            "share", "1", "share k' of the scintillator light that is delayed for so long", 0.0, 0.5, 0.005, 0.01
        ),
        Parameter("time_constant_ms", "ms", "decay time T', to 1/e", 1.0, 1e6, 100.0, 100.0, None, LOGARITHM, IN_VIEWS),
        Parameter("before", "1", BEFORE, 0.0, 1.0, 1.0, 1.0, None, fraction=True),
    ),
    apply=apply,
    beside="afterglow",
)
