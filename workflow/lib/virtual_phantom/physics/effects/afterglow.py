"""Afterglow of the scintillator."""

import math

from ..effect import LOGARITHM, PER_VIEW, Effect, Parameter, Reach
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Set the lag of views."""
    state.lag = lag_of(state, values)


def lag_of(state: State, values: dict[str, float]) -> tuple[float, float, float]:
    """A glow of these parameters in the views of a scan, as State.lag has it."""
    geometry = state.geometry
    times = values["time_constant_ms"], geometry.known_interval_ms, geometry.exposure_ms
    return (*of_views(values["share"], *times), values["before"])


def of_views(
    share: float, time_constant_ms: float, view_interval_ms: float, exposure_ms: float | None = None
) -> tuple[float, float]:
    """What a glow is in views.

    Of the response (1 - k) delta(t) + k/T exp(-t/T) to a beam that is on in the middle of every interval, while the
    detector integrates over the whole interval: no light is lost.

    Parameters
    ----------
    share, time_constant_ms : float
        k, and T in ms.
    view_interval_ms : float
        From view to view, ms.
    exposure_ms : float, optional
        How long the beam is on, ms; None: throughout.

    Returns
    -------
    share : float
        Of a view's signal, what is read with later ones.
    memory : float
        What each further view leaves.
    """
    exposure = view_interval_ms if exposure_ms is None else exposure_ms
    rest = (view_interval_ms - exposure) / 2  # after the exposure
    ratio = exposure / time_constant_ms
    left = -math.expm1(-ratio) / ratio if ratio else 1.0  # of the glow, on average, at the exposure's end
    return share * left * math.exp(-rest / time_constant_ms), math.exp(-view_interval_ms / time_constant_ms)


EFFECT = Effect(
    name="afterglow",
    physics="Part of the signal glows on and is read with the next views.",
    equation="light(t) = (1 - k) S(t) + k/T times the integral of S(t - t') exp(-t'/T) over t'; a view reads the "
    "mean over its interval; b: glow before the first view, over that of its lasting signal",
    source="J. Hsieh, O. E. Gurmen and K. F. King, IEEE Trans. Med. Imaging 19, 930 (2000), one of its exponentials",
    stage="noise",
    signature="edges lag behind the rotation, and noise of successive views is correlated",
    settled_by="the same scan turning the other way: the lag changes its sign",
    parameters=(
        Parameter("share", "1", "share of the scintillator's light that glows on", 0.0, 1.0, 0.02, 0.05),
        # From ceramics of body scanners (1 and 10 ms are XCIST's example) to flat panels, whose ghosts last for minutes
        # (J. H. Siewerdsen and D. A. Jaffray, Med. Phys. 26, 1624, 1999). Much shorter than a view's interval nothing
        # of a glow is left, much longer it is a constant.
        Parameter(
            "time_constant_ms",
            "ms",
            "time in which the glow falls to 1/e",
            0.1,
            1e5,
            10.0,
            10.0,
            None,
            LOGARITHM,
            Reach(PER_VIEW, 0.2, 50.0, 0.7, 0.7),
        ),
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
