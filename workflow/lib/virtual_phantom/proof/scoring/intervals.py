"""Shares with confidence intervals, medians and other quantiles."""

from __future__ import annotations

import math
from collections.abc import Iterable
from statistics import NormalDist

import numpy as np

Z = NormalDist().inv_cdf(0.975)  # of a two-sided interval of 95 %
ROUNDED = 1e-9  # sums of 1/k that differ less from a whole number are whole
DIGITS = 12  # decimals of bounds, so that 0 and 100 % are exact


def share(scores: Iterable[float]) -> dict:
    """Return the mean of scores between 0 and 1, such as flags: {"count", "n", "share", "ci95"}.

    ci95 is Wilson's 95 % score interval [1]_. Scores of 1/k make it wider than necessary, since flags vary the most.
    share and ci95 are None if n is 0.

    References
    ----------
    .. [1] Wilson, J. Am. Stat. Assoc. 22, 209, 1927.
    """
    scores = [float(score) for score in scores]
    return share_of(math.fsum(scores), len(scores))


def share_of(count: float, n: int) -> dict:
    """As `share`, from the sum of the scores and their number."""
    count = round(count) if abs(count - round(count)) < ROUNDED else count
    if not n:
        return {"count": 0, "n": 0, "share": None, "ci95": None}
    center, half = count + Z**2 / 2, Z * math.sqrt(count * (n - count) / n + Z**2 / 4)
    bounds = [min(1.0, max(0.0, round((center + sign * half) / (n + Z**2), DIGITS))) for sign in (-1, 1)]
    return {"count": count, "n": n, "share": count / n, "ci95": bounds}


def median(values: Iterable[float | None]) -> float | None:
    """Return the median of the values that are not None, or None without any."""
    return quantile(values, 0.5)


def quantile(values: Iterable[float | None], share: float) -> float | None:
    """Return a quantile of the values that are not None, with linear interpolation, or None without any."""
    known = [value for value in values if value is not None]
    return float(np.quantile(known, share)) if known else None
