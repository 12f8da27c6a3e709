"""An interval for the stability by W: a share of few pairs that have groups in common, so that no normal theory holds.

What is asked for is the expected stability: the mean, over fresh noise, of the share of comparisons with |W| below the
threshold, for these protocols, these ROIs and this number of repeats. The observed share estimates it without bias.

Each feature gets a family of studies that differ in one number, the scale of the differences between protocols. A
study of the family has normal values with the SD that every group and ROI was seen to have, and with the correlation of
groups that share their noise. Its means are those seen, their distances from the ROI's mean over groups times the
scale. At scale 0 protocols do not differ, and the expected stability is the largest; it falls as the scale grows. The
interval holds the expected stability of those scales at which the observed one is not too far out in either tail: a
test that is inverted [1]_, with half of the weight of what is just observed [2]_. Its coverage is in
docs/explanation/statistics.md.

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

TAIL = 0.025  # of the distribution on either side: intervals of 95 %
# Of a study at each scale: a tail of 2.5 % is known to 0.9 %. Of twice the repeats half as many: a forecast needs less.
SIMULATIONS = 300
SEED = 4733  # of the stream of simulated noise, the same in every study and for every feature
LARGEST_SCALE = 6.0  # of the differences seen: hardly any two protocols agree there
NEAR = 0.005  # share of expected stability between two scales that are near enough for a straight line
MOST_HALVINGS = 24  # of the range of scales: enough for differences of a million SDs
# Repeats for which the distribution of a rank sum is counted out; of more the normal law is right to 0.2 %.
EXACT_UP_TO = 50
ROUNDING = 1e-9  # of shares
LEAST_STEP = 1e-6  # SDs between values of a feature that is taken to be discrete


@dataclass(frozen=True)
class StabilityInterval:
    """Expected stability of features, as shares. Arrays have one number for each feature.

    Attributes
    ----------
    value : ndarray
        The observed stability.
    low, high : ndarray
        95 % interval of the expected one. It contains the observed one. NaN where groups have one repeat.
    twice, twice_low, twice_high : ndarray
        With twice as many repeats: the expected stability, and the interval that would be found around it.
    """

    value: np.ndarray
    low: np.ndarray
    high: np.ndarray
    twice: np.ndarray
    twice_low: np.ndarray
    twice_high: np.ndarray


def intervals(
    x: np.ndarray, units: Sequence[Sequence[int]], sharing: Sequence[Hashable], threshold: float = 1.0
) -> StabilityInterval:
    """The stability of every feature with its interval.

    Parameters
    ----------
    x : ndarray, shape (features, rois, groups, repeats)
        As `stability_measures.cube` gives it. A repeat has the same number in all groups.
    units : sequence of sequence of int
        ROIs whose repeats make one sample together: each by itself, or those of a class (statistics.compare).
    sharing : sequence, length groups
        Groups with the same entry have their noise in common, repeat by repeat; that of others is independent.
    threshold : float, optional
        A pair of groups is stable if |W| is below.
    """
    repeats = x.shape[-1]
    once = _Design.of(x.shape[1:-1], repeats, units, threshold, SIMULATIONS)
    twice = _Design.of(x.shape[1:-1], 2 * repeats, units, threshold, SIMULATIONS // 2)
    shared = np.array([[one == other for other in sharing] for one in sharing])
    if repeats < 2:
        nothing = [np.full(len(x), np.nan)] * (len(fields(StabilityInterval)) - 1)
        return StabilityInterval(once.stability(x), *nothing)
    return StabilityInterval(*np.array([_interval(one, shared, once, twice) for one in x]).T)


def agreeing(repeats: int, threshold: float = 1.0) -> float:
    """Probability of |W| < `threshold` for two samples of `repeats` of the same continuous distribution.

    Exact up to EXACT_UP_TO: ways to choose half of the ranks, counted by their sum. Beyond, the normal law with the
    correction for continuity.

    Parameters
    ----------
    repeats : int
        Of each sample.
    """
    most = repeats * repeats
    below = np.abs(np.arange(most + 1) - most / 2) < threshold * _spread(repeats)
    if repeats > EXACT_UP_TO:
        return float(2 * scipy.stats.norm.cdf(below.sum() / 2 / _spread(repeats)) - 1)
    ways = np.zeros((repeats + 1, repeats * (2 * repeats - 1) + 1))  # by how many ranks are chosen, and by their sum
    ways[0, 0] = 1.0
    for rank in range(2 * repeats):
        ways[1:, rank:] += ways[:-1, : ways.shape[1] - rank].copy()
    sums = ways[-1, repeats * (repeats - 1) // 2 :][: most + 1]
    return float(sums[below].sum() / sums.sum())


def _spread(repeats: int) -> float:
    """SD of the rank sum of one of two samples of the same distribution."""
    return float(np.sqrt(repeats * repeats * (2 * repeats + 1) / 12))


@dataclass(frozen=True)
class _Design:
    """What is compared, and the noise of its simulations.

    units      ROIs of each sample
    limits     of each unit: |2 U - n^2| of the rank-sum test below which a pair is stable
    noise      independent normal numbers [simulation, roi, group, repeat]
    if_equal   expected stability where protocols do not differ and share no noise
    """

    units: list[list[int]]
    limits: list[float]
    noise: np.ndarray
    if_equal: float

    @classmethod
    def of(
        cls, shape: tuple[int, int], repeats: int, units: Sequence[Sequence[int]], threshold: float, simulations: int
    ) -> _Design:
        """The design of so many ROIs and groups."""
        sizes = [repeats * len(unit) for unit in units]
        return cls(
            [list(unit) for unit in units],
            [2 * threshold * _spread(size) for size in sizes],
            generator(root(SEED)).standard_normal((simulations, *shape, repeats)),
            float(np.mean([agreeing(size, threshold) for size in sizes])),
        )

    def stability(self, x: np.ndarray) -> np.ndarray:
        """Share of the comparisons that are stable, of studies x[study, roi, group, repeat]."""
        studies, _, groups, _ = x.shape
        count = np.zeros(studies)
        for unit, limit in zip(self.units, self.limits, strict=True):
            samples = np.ascontiguousarray(x[:, unit].swapaxes(1, 2)).reshape(studies, groups, -1)
            count += _stable_pairs(samples, limit)
        return count / (len(self.units) * groups * (groups - 1) / 2)


@compiled(nogil=True, error_model="numpy")  # no fastmath: the same operations on every processor
def _stable_pairs(samples, limit):
    """Pairs of groups of samples[study, group, repeat] with |2 U - n^2| < limit, ties counted as halves."""
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


class _Family:
    """Studies of one feature that differ in the scale of the differences between protocols.

    x        the feature [roi, group, repeat]
    shared   bool [group, group]: whether two groups have their noise in common
    design   of the simulations
    """

    def __init__(self, x: np.ndarray, shared: np.ndarray, design: _Design):
        mean, sd = x.mean(axis=-1), x.std(axis=-1, ddof=1)
        self.design = design
        self.centre = mean.mean(axis=-1, keepdims=True)
        self.away = mean - self.centre
        # Above scale 1 groups that seem to agree move apart too, in their order: chance may have hidden a difference of
        # about a standard error. Without it few comparisons that all agree would never be refused.
        order = mean.argsort(axis=-1).argsort(axis=-1)
        self.hidden = scipy.stats.norm.ppf((order + 0.5) / mean.shape[-1]) * sd / np.sqrt(x.shape[-1])
        root = _root_of_correlation(x, sd, shared)
        self.noise = sd[..., None] * np.einsum("gh,srhn->srgn", root, design.noise)
        self.step = _step(x, sd)
        self.simulated: dict[float, np.ndarray] = {}

    def stability(self, scale: float) -> np.ndarray:
        """Of every simulated study."""
        if scale not in self.simulated:
            means = self.centre + scale * self.away + max(0.0, scale - 1) * self.hidden
            values = means[..., None] + self.noise
            values = np.round(values / self.step) * self.step if self.step else values
            self.simulated[scale] = self.design.stability(values)
        return self.simulated[scale]

    def expected(self, scale: float) -> float:
        """The expected stability."""
        mean = float(self.stability(scale).mean())
        # SDs of few repeats make groups that are equal seem less so.
        return max(mean, self.design.if_equal) if scale == 0 else mean

    def above(self, scale: float, observed: float) -> float:
        """Probability of more than is observed, and half of that of as much."""
        more = self.stability(scale) - observed
        return float(np.mean(more > ROUNDING) + np.mean(np.abs(more) <= ROUNDING) / 2)

    def scales_about(self, falling: Callable[[float], float], value: float) -> tuple[float, float, float]:
        """Two scales that are near each other and have a falling function's value between them; how far in between."""
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
        """The expected stability where a falling function of the scale has a value."""
        low, high, part = self.scales_about(falling, value)
        return self.expected(low) + part * (self.expected(high) - self.expected(low))

    def interval(self, observed: float) -> tuple[float, float]:
        """Expected stability of the scales that the observed one does not refuse."""
        above = partial(self.above, observed=observed)
        low = self.expected_at(above, TAIL) if observed > 0 else 0.0
        return min(low, observed), max(self.expected_at(above, 1 - TAIL), observed)

    def scale_of(self, observed: float) -> float:
        """The scale at which this is expected, or the nearest."""
        low, high, part = self.scales_about(self.expected, observed)
        return low + part * (high - low)


def _interval(x: np.ndarray, shared: np.ndarray, once: _Design, twice: _Design) -> tuple[float, ...]:
    """The fields of StabilityInterval for one feature x[roi, group, repeat]."""
    observed = float(once.stability(x[None])[0])
    now, later = _Family(x, shared, once), _Family(x, shared, twice)
    expected = later.expected(now.scale_of(observed))
    return observed, *now.interval(observed), expected, *later.interval(expected)


def _root_of_correlation(x: np.ndarray, sd: np.ndarray, shared: np.ndarray) -> np.ndarray:
    """What makes independent numbers of groups as correlated as x[roi, group, repeat]: a matrix [group, group].

    Groups that share no noise stay independent. Coefficients are means over ROIs, whose noise is taken to be
    independent.

    Returns
    -------
    ndarray, shape (groups, groups)
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        z = np.nan_to_num((x - x.mean(axis=-1, keepdims=True)) / sd[..., None])  # 0 where nothing varies
    correlation = np.einsum("rgn,rhn->gh", z, z) / (x.shape[0] * (x.shape[-1] - 1))
    correlation = np.where(shared, correlation, 0.0)
    np.fill_diagonal(correlation, 1.0)
    values, vectors = np.linalg.eigh(correlation)
    return (vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T


def _step(x: np.ndarray, sd: np.ndarray) -> float:
    """The step of a feature whose values are all multiples of it, as whole HU; 0 of continuous ones."""
    steps = np.diff(np.unique(x))
    if not steps.size or steps.min() < LEAST_STEP * np.median(sd):
        return 0.0
    places = x / steps.min()
    return float(steps.min()) if np.allclose(places, np.round(places), rtol=0, atol=1e-6) else 0.0
