"""Probabilities of the rank-sum statistic of two samples from the same continuous distribution.

Exact for samples of up to EXACT_UP_TO values: the choices of ranks are counted by their sum [1]_.

References
----------
.. [1] Mann and Whitney, Ann. Math. Stat. 18, 50, 1947.
"""

from __future__ import annotations

import numpy as np
import scipy

# Size of the larger sample up to which the distribution is exact; beyond, the normal approximation is accurate to
# 0.2 %.
EXACT_UP_TO = 50


def rank_sum_sd(n: int, m: int) -> float:
    """SD of the rank sum of the first of two samples of n and m values."""
    return float(np.sqrt(n * m * (n + m + 1) / 12))


def stable_probability(repeats: int, threshold: float = 1.0) -> float:
    """Probability of |W| < `threshold` for two samples of `repeats` values."""
    return _central_probability(
        repeats, repeats, _distances(repeats, repeats) < threshold * rank_sum_sd(repeats, repeats)
    )


def differing_probability(n: int, m: int, threshold: float = 1.0) -> float:
    """Probability of |W| > `threshold` for two samples of n and m values.

    |W| can be equal to the threshold, so this is not always one minus `stable_probability`.
    """
    return 1 - _central_probability(n, m, _distances(n, m) <= threshold * rank_sum_sd(n, m))


def _distances(n: int, m: int) -> np.ndarray:
    """|rank sum - its mean| for all rank sums of a sample of n values."""
    return np.abs(np.arange(n * m + 1) - n * m / 2)


def _central_probability(n: int, m: int, chosen: np.ndarray) -> float:
    """Probability of a central range of rank sums; the normal approximation has a continuity correction."""
    if max(n, m) > EXACT_UP_TO:
        return float(2 * scipy.stats.norm.cdf(chosen.sum() / 2 / rank_sum_sd(n, m)) - 1)
    least = n * (n - 1) // 2
    ways = np.zeros((n + 1, least + n * m + 1))  # [number of chosen ranks, their sum]
    ways[0, 0] = 1.0
    for rank in range(n + m):
        ways[1:, rank:] += ways[:-1, : ways.shape[1] - rank].copy()
    sums = ways[-1, least:]
    return float(sums[chosen].sum() / sums.sum())
