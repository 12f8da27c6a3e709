"""Shares with their intervals, medians and other quantiles."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.stats import binomtest


def share(flags: Iterable[bool]) -> dict:
    """How many are true.

    Returns
    -------
    dict
        {"count", "n", "share", "ci95"}; share and ci95, Wilson's 95 % score interval [1]_, are None of none.

    References
    ----------
    .. [1] Wilson, J. Am. Stat. Assoc. 22, 209, 1927.
    """
    flags = [bool(flag) for flag in flags]
    return share_of(sum(flags), len(flags))


def share_of(count: int, n: int) -> dict:
    """As `share`, of so many that are true."""
    if not n:
        return {"count": 0, "n": 0, "share": None, "ci95": None}
    interval = binomtest(count, n).proportion_ci(0.95, method="wilson")
    return {"count": count, "n": n, "share": count / n, "ci95": [float(interval.low), float(interval.high)]}


def median(values: Iterable[float | None]) -> float | None:
    """Of the values that are known; None if there are none."""
    return quantile(values, 0.5)


def quantile(values: Iterable[float | None], share: float) -> float | None:
    """Of the values that are known, linear between neighbours; None if there are none."""
    known = [value for value in values if value is not None]
    return float(np.quantile(known, share)) if known else None
