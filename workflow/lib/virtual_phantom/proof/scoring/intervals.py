"""Shares with confidence intervals, medians and other quantiles."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.stats import binomtest


def share(flags: Iterable[bool]) -> dict:
    """Return the share of true flags: {"count", "n", "share", "ci95"}.

    ci95 is Wilson's 95 % score interval [1]_. share and ci95 are None if n is 0.

    References
    ----------
    .. [1] Wilson, J. Am. Stat. Assoc. 22, 209, 1927.
    """
    flags = [bool(flag) for flag in flags]
    return share_of(sum(flags), len(flags))


def share_of(count: int, n: int) -> dict:
    """As `share`, from counts."""
    if not n:
        return {"count": 0, "n": 0, "share": None, "ci95": None}
    interval = binomtest(count, n).proportion_ci(0.95, method="wilson")
    return {"count": count, "n": n, "share": count / n, "ci95": [float(interval.low), float(interval.high)]}


def median(values: Iterable[float | None]) -> float | None:
    """Return the median of the values that are not None, or None without any."""
    return quantile(values, 0.5)


def quantile(values: Iterable[float | None], share: float) -> float | None:
    """Return a quantile of the values that are not None, with linear interpolation, or None without any."""
    known = [value for value in values if value is not None]
    return float(np.quantile(known, share)) if known else None
