"""Afterglow of the scintillator."""

import math

from ..effect import LOGARITHM, PER_VIEW, Effect, Parameter, Reach
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Set the lag of views."""
    state.lag = lag_of(state, values)


def lag_of(state: State, values: dict[str, float]) -> tuple[float, float, float]:
    """Return State.lag for these parameters and the views of a scan."""
    geometry = state.geometry
    times = values["time_constant_ms"], geometry.known_interval_ms, geometry.exposure_ms
    return (*of_views(values["share"], *times), values["before"])


def of_views(
    share: float, time_constant_ms: float, view_interval_ms: float, exposure_ms: float | None = None
) -> tuple[float, float]:
    """Convert an afterglow in time to one in views.

    The impulse response is (1 - k) delta(t) + k/T exp(-t/T). The beam is on in the middle of every view interval and
    the detector integrates over the whole interval, so no light is lost.

    Parameters
    ----------
    share, time_constant_ms : float
        k, and T in ms.
    view_interval_ms : float
        Time from view to view, ms.
    exposure_ms : float, optional
        Beam-on time per view, ms; None: the whole interval.

    Returns
    -------
    share : float
        Share of the signal of a view that is read with later views.
    memory : float
        Factor by which the afterglow decays from view to view.
    """
    exposure = view_interval_ms if exposure_ms is None else exposure_ms
    rest = (view_interval_ms - exposure) / 2  # after the exposure
    ratio = exposure / time_constant_ms
    left = -math.expm1(-ratio) / ratio if ratio else 1.0  # mean share of the afterglow at the end of the exposure
    return share * left * math.exp(-rest / time_constant_ms), math.exp(-view_interval_ms / time_constant_ms)


IN_VIEWS = Reach(PER_VIEW, 0.2, 50.0, 0.7, 0.7)
BEFORE = "b: afterglow before the first view, relative to that of its steady signal"

EFFECT = Effect(
    name="afterglow",
    physics="Part of the scintillator light is emitted late and read with the following views.",
    equation="light(t) = (1 - k) S(t) + k/T times the integral of S(t - t') exp(-t'/T) over t'. A view reads the mean "
    "over its interval. b: afterglow before the first view, relative to that of its steady signal",
    source="J. Hsieh, O. E. Gurmen and K. F. King, IEEE Trans. Med. Imaging 19, 930 (2000), one of its exponentials",
    stage="noise",
    signature="edges lag in the direction of rotation, and noise of successive views is correlated",
    settled_by="repeat the scan with the opposite direction of rotation: the lag changes its sign",
    parameters=(
        Parameter("share", "1", "share k of the scintillator light that is delayed", 0.0, 1.0, 0.02, 0.05),
        # From ceramics of body scanners (XCIST's example: 1 and 10 ms) to flat panels, whose ghosts last for minutes
        # (J. H. Siewerdsen and D. A. Jaffray, Med. Phys. 26, 1624, 1999). An afterglow much shorter than the view
        # interval vanishes, and one much longer is constant.
        Parameter("time_constant_ms", "ms", "decay time T, to 1/e", 0.1, 1e5, 10.0, 10.0, None, LOGARITHM, IN_VIEWS),
        Parameter("before", "1", BEFORE, 0.0, 1.0, 1.0, 1.0, None, fraction=True),
    ),
    apply=apply,
)
