"""Shares with their intervals, and medians."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.stats import binomtest


def share(flags: Iterable[bool]) -> dict:
    """How many are true: {"count", "n", "share", "ci95"}; share and interval None of none.

    ci95   Wilson's score interval (J. Am. Stat. Assoc. 22, 209, 1927), 95 %
    """
    flags = [bool(flag) for flag in flags]
    count, n = sum(flags), len(flags)
    if not n:
        return {"count": 0, "n": 0, "share": None, "ci95": None}
    interval = binomtest(count, n).proportion_ci(0.95, method="wilson")
    return {"count": count, "n": n, "share": count / n, "ci95": [float(interval.low), float(interval.high)]}


def median(values: Iterable[float | None]) -> float | None:
    """Of the values that are known; None if there are none."""
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else None
