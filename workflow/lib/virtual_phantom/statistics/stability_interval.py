"""Confidence interval of the stability, by inverting a parametric bootstrap test.

Stability is the share of pairs of groups with |W| below the threshold. The pairs are few and have groups in common, so
normal theory does not apply. The interval is for the expected stability: the mean over new noise, for the same
protocols, ROIs and number of repeats. The observed share is an unbiased estimate of it.

For each feature, studies are simulated that differ in one parameter: the scale of the differences between protocols.
Values are normal with the observed SD of every group and ROI, and with the observed correlation of groups that share
their noise. Means are the observed ones, with deviations from the ROI's mean over groups multiplied by the scale. At
scale 0 protocols do not differ and the expected stability is largest; it falls as the scale grows.

The interval contains the expected stability of all scales that a test does not reject (test inversion [1]_), where
values equal to the observed one count half (mid-P [2]_). The documentation of the statistics reports its coverage.

References
----------
.. [1] Carpenter, J. R. Stat. Soc. B 61, 159, 1999: test inversion bootstrap confidence intervals.
.. [2] Lancaster, J. Am. Stat. Assoc. 56, 223, 1961: mid-P.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, fields
from functools import partial

import numpy as np
import scipy

from ..base.compiled import compiled
from ..base.streams import generator, root
from .rank_sum import rank_sum_sd, stable_probability

TAIL = 0.025  # tail probability on either side of a 95 % interval
# Simulated studies at each scale: the error of a 2.5 % tail is 0.9 %. Forecasts for twice the repeats use half as many.
SIMULATIONS = 300
SEED = 4733  # seed of the simulated noise, the same in every study and for every feature
LARGEST_SCALE = 6.0  # scale at which hardly any two protocols agree
NEAR = 0.005  # difference in expected stability below which two scales are interpolated linearly
MOST_HALVINGS = 24  # halvings of the range of scales, enough for differences of a million SDs
ROUNDING = 1e-9  # rounding error of shares
LEAST_STEP = 1e-6  # smallest step, in SDs, of a feature that is treated as discrete


@dataclass(frozen=True)
class StabilityInterval:
    """Stability of every feature, as shares.

    Attributes
    ----------
    low, high : ndarray
        95 % interval of the expected stability, which contains the observed one. NaN for one repeat per group.
    twice, twice_low, twice_high : ndarray
        Forecast for twice the repeats: expected stability, and the interval around it.
    """

    value: np.ndarray
    low: np.ndarray
    high: np.ndarray
    twice: np.ndarray
    twice_low: np.ndarray
    twice_high: np.ndarray


def stability_intervals(
    x: np.ndarray, units: Sequence[Sequence[int]], sharing: Sequence[Hashable], threshold: float = 1.0
) -> StabilityInterval:
    """Compute the stability of every feature with its interval.

    Parameters
    ----------
    x : ndarray, shape (features, rois, groups, repeats)
        From `stability_measures.feature_array`. A repeat has the same index in all groups.
    units : sequence of sequence of int
        ROIs whose repeats form one sample: single ROIs, or all ROIs of a tissue class (statistics.compare).
    sharing : sequence, length groups
        Groups with equal entries share their noise, repeat by repeat. Noise of other groups is independent.
    threshold : float, optional
        A pair of groups is stable if |W| is below this value.
    """
    repeats = x.shape[-1]
    once = _Design.of(x.shape[1:-1], repeats, units, threshold, SIMULATIONS)
    twice = _Design.of(x.shape[1:-1], 2 * repeats, units, threshold, SIMULATIONS // 2)
    shared = np.array([[first == second for second in sharing] for first in sharing])
    if repeats < 2:
        missing = [np.full(len(x), np.nan)] * (len(fields(StabilityInterval)) - 1)
        return StabilityInterval(once.stability(x), *missing)
    return StabilityInterval(*np.array([_interval(feature, shared, once, twice) for feature in x]).T)


@dataclass(frozen=True)
class _Design:
    """Design of a study and the noise of its simulations.

    Attributes
    ----------
    units : list of list of int
        ROIs of each sample.
    limits : list of float
        For each unit, |2 U - n^2| of the rank-sum test below which a pair is stable.
    if_equal : float
        Expected stability of protocols that do not differ and share no noise.
    """

    units: list[list[int]]
    limits: list[float]
    noise: np.ndarray
    if_equal: float

    @classmethod
    def of(
        cls, shape: tuple[int, int], repeats: int, units: Sequence[Sequence[int]], threshold: float, simulations: int
    ) -> _Design:
        """Return the design for a shape (rois, groups)."""
        sizes = [repeats * len(unit) for unit in units]
        return cls(
            [list(unit) for unit in units],
            [2 * threshold * rank_sum_sd(size, size) for size in sizes],
            generator(root(SEED)).standard_normal((simulations, *shape, repeats)),
            float(np.mean([stable_probability(size, threshold) for size in sizes])),
        )

    def stability(self, x: np.ndarray) -> np.ndarray:
        """Share of stable comparisons for every study in x[study, roi, group, repeat]."""
        studies, _, groups, _ = x.shape
        count = np.zeros(studies)
        for unit, limit in zip(self.units, self.limits, strict=True):
            samples = np.ascontiguousarray(x[:, unit].swapaxes(1, 2)).reshape(studies, groups, -1)
            count += _stable_pairs(samples, limit)
        return count / (len(self.units) * groups * (groups - 1) / 2)


@compiled(nogil=True, error_model="numpy")  # without fastmath, so that all processors give the same result
def _stable_pairs(samples, limit):
    """Number of pairs of groups of samples[study, group, repeat] with |2 U - n^2| < limit; ties count half."""
    studies, groups, n = samples.shape
    count = np.zeros(studies)
    for study in range(studies):
        for a in range(groups):
            for b in range(a):
                more = 0
                for i in range(n):
                    value = samples[study, a, i]
                    for j in range(n):
                        other = samples[study, b, j]
                        more += np.int32(other < value) - np.int32(other > value)
                if abs(more) < limit:
                    count[study] += 1
    return count


class _ScaledStudies:
    """Simulated studies of one feature at different scales of the differences between protocols.

    Parameters
    ----------
    x : ndarray, shape (rois, groups, repeats)
    shared : ndarray of bool, shape (groups, groups)
        Whether two groups share their noise.
    """

    def __init__(self, x: np.ndarray, shared: np.ndarray, design: _Design):
        mean, sd = x.mean(axis=-1), x.std(axis=-1, ddof=1)
        self.design = design
        self.center = mean.mean(axis=-1, keepdims=True)
        self.deviation = mean - self.center
        # Chance may have hidden differences of about one standard error. Scales above 1 add them in the observed order
        # of the groups; otherwise a study whose few comparisons all agree would not be rejected at any scale.
        order = mean.argsort(axis=-1).argsort(axis=-1)
        self.hidden = scipy.stats.norm.ppf((order + 0.5) / mean.shape[-1]) * sd / np.sqrt(x.shape[-1])
        root = _root_of_correlation(x, sd, shared)
        self.noise = sd[..., None] * np.einsum("gh,srhn->srgn", root, design.noise)
        self.step = _step(x, sd)
        self.simulated: dict[float, np.ndarray] = {}

    def stability(self, scale: float) -> np.ndarray:
        """Stability of every simulated study."""
        if scale not in self.simulated:
            means = self.center + scale * self.deviation + max(0.0, scale - 1) * self.hidden
            values = means[..., None] + self.noise
            values = np.round(values / self.step) * self.step if self.step else values
            self.simulated[scale] = self.design.stability(values)
        return self.simulated[scale]

    def expected(self, scale: float) -> float:
        """Expected stability at a scale."""
        mean = float(self.stability(scale).mean())
        # Errors of SDs from few repeats make equal groups appear different.
        return max(mean, self.design.if_equal) if scale == 0 else mean

    def above(self, scale: float, observed: float) -> float:
        """Mid-P probability of a stability above the observed one: P(above) + P(equal) / 2."""
        excess = self.stability(scale) - observed
        return float(np.mean(excess > ROUNDING) + np.mean(np.abs(excess) <= ROUNDING) / 2)

    def bracket(self, falling: Callable[[float], float], value: float) -> tuple[float, float, float]:
        """Two near scales between which a decreasing function takes a value, and its relative position there."""
        low, high = 0.0, LARGEST_SCALE
        if falling(low) <= value:
            return low, low, 0.0
        if falling(high) >= value:
            return high, high, 0.0
        for halving in range(MOST_HALVINGS):
            if halving and self.expected(low) - self.expected(high) < NEAR:
                break
            middle = 1.0 if not halving else np.sqrt(low * high) if low else high / 4
            low, high = (middle, high) if falling(middle) > value else (low, middle)
        return low, high, (falling(low) - value) / (falling(low) - falling(high))

    def expected_at(self, falling: Callable[[float], float], value: float) -> float:
        """Expected stability at the scale where a decreasing function takes a value."""
        low, high, part = self.bracket(falling, value)
        return self.expected(low) + part * (self.expected(high) - self.expected(low))

    def interval(self, observed: float) -> tuple[float, float]:
        """Range of the expected stability over the scales that the test does not reject."""
        above = partial(self.above, observed=observed)
        low = self.expected_at(above, TAIL) if observed > 0 else 0.0
        return min(low, observed), max(self.expected_at(above, 1 - TAIL), observed)

    def scale_of(self, observed: float) -> float:
        """Scale at which the observed stability is expected, or the nearest one."""
        low, high, part = self.bracket(self.expected, observed)
        return low + part * (high - low)


def _interval(x: np.ndarray, shared: np.ndarray, once: _Design, twice: _Design) -> tuple[float, ...]:
    """Fields of StabilityInterval for one feature x[roi, group, repeat]."""
    observed = float(once.stability(x[None])[0])
    now, later = _ScaledStudies(x, shared, once), _ScaledStudies(x, shared, twice)
    expected = later.expected(now.scale_of(observed))
    return observed, *now.interval(observed), expected, *later.interval(expected)


def _root_of_correlation(x: np.ndarray, sd: np.ndarray, shared: np.ndarray) -> np.ndarray:
    """Symmetric square root of the correlation matrix of the groups of x[roi, group, repeat], over repeats.

    Coefficients are means over ROIs, and 0 between groups that share no noise.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        z = np.nan_to_num((x - x.mean(axis=-1, keepdims=True)) / sd[..., None])  # 0 where a feature is constant
    correlation = np.einsum("rgn,rhn->gh", z, z) / (x.shape[0] * (x.shape[-1] - 1))
    correlation = np.where(shared, correlation, 0.0)
    np.fill_diagonal(correlation, 1.0)
    values, vectors = np.linalg.eigh(correlation)
    return (vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T


def _step(x: np.ndarray, sd: np.ndarray) -> float:
    """Return the step of a discrete feature, whose values are multiples of a step such as 1 HU; 0 if continuous."""
    steps = np.diff(np.unique(x))
    if not steps.size or steps.min() < LEAST_STEP * np.median(sd):
        return 0.0
    multiples = x / steps.min()
    return float(steps.min()) if np.allclose(multiples, np.round(multiples), rtol=0, atol=1e-6) else 0.0
