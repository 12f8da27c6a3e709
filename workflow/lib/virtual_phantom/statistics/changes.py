"""Agreement of features between settings that differ in one kind of change, such as dose or slice thickness.

A change compares two lists of values by feature, region and repeat. All measures describe single scans, and changes of
one kind are pooled: variances are averaged over the pairs of settings. With a and b the values in two settings:

* ICC = s / (s + d / 2), where s is the covariance of a and b over regions and d the mean of (a - b)^2. For pairs of k
  settings, this is ICC(2,1) of Shrout and Fleiss [1]_; for repeats of one setting, ICC(1,1).
* CCC: Lin's concordance correlation [2]_, mean over pairs, with divisor n instead of n - 1.
* Repeatability: the repeatability coefficient 1.96 sqrt(2) sqrt(d / 2) [3]_ (between settings: reproducibility
  coefficient) divided by the SD of the means of tissue classes. Below 1, a difference of one SD between tissues exceeds
  the difference that two scans of one region have in 5 % of cases.
* W: share of comparisons with |W| below the threshold, as in the paper, with the interval of Clopper and Pearson.

The other intervals come from the jackknife over regions, with Student's t and n - 1 degrees of freedom [4]_. They are
computed for Fisher's z of ICC and CCC and for the logarithm of the repeatability. With six regions they cover a true
ICC in 94 to 95 % of cases, while percentiles of the bootstrap cover 74 to 80 % (`python -m benchmarks run
change_intervals`).

References
----------
.. [1] Shrout and Fleiss, Psychol. Bull. 86, 420, 1979.
.. [2] Lin, Biometrics 45, 255, 1989.
.. [3] Raunig et al., Stat. Methods Med. Res. 24, 27, 2015.
.. [4] Arvesen and Schmitz, Biometrics 26, 677, 1970: jackknife of transformed variance components.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
import scipy

from ..base.streams import generator, root
from . import RANKSUM_REPEATS
from .agreement_measures import CONFIDENCE, Estimate
from .jackknife import standard_error
from .rank_sum import stable_probability
from .wilcoxon import ranksum_z

REPEATABILITY_CUT_OFF = 1.0  # largest repeatability coefficient of a robust feature, in SDs between tissues
MEASURES = ("icc", "ccc", "repeatability", "w")
EXCHANGES = 720  # orders of the regions in the control: all of six regions
SEED = 4734  # seed of random orders of more regions, the same in every study
ROUNDING = 1e-24  # a variance below this share of the mean square is rounding error (1e-16, squared, with a margin)
NEARLY_ONE = 1 - 1e-12  # largest correlation with a finite Fisher z


@dataclass(frozen=True)
class Change:
    """Values of all features in two settings.

    Attributes
    ----------
    kind : str
        What differs between the settings.
    first, second : str
        Names of the settings.
    a, b : ndarray, shape (features, regions, repeats)
        Values; the numbers of repeats may differ.
    relation : {"paired", "independent", "repeats"}
        Whether repeat r of both settings is the same acquisition; "repeats" if both settings, and so a and b, are the
        same.
    """

    kind: str
    first: str
    second: str
    a: np.ndarray
    b: np.ndarray
    relation: str = "independent"


@dataclass(frozen=True)
class Agreement:
    """Agreement between the settings of one kind of change.

    Attributes
    ----------
    measures : dict of str to Estimate
        By MEASURES. W as a share; `repeatability` is small for robust features.
    by_class : dict of str to dict of str to ndarray
        {measure: {tissue class: values}}: differences of the class alone, relative to the spread of all regions.
    largest : ndarray of int, shape (features,)
        Pair of settings with the largest differences.
    percent, deviations : ndarray, shape (features,)
        Mean change of this pair in percent of the first setting (NaN if values differ in sign), and in SDs between
        regions (NaN if their variance is not positive).
    """

    measures: dict[str, Estimate]
    by_class: dict[str, dict[str, np.ndarray]]
    largest: np.ndarray
    percent: np.ndarray
    deviations: np.ndarray


@dataclass(frozen=True)
class _Moments:
    """Moments of one pair of settings. The jackknife axis has all regions first, then all without each region."""

    covariance: np.ndarray  # between the settings, (features, 1 + regions)
    concordance: np.ndarray  # CCC, (features, 1 + regions)
    squares: np.ndarray  # mean squared difference of single scans, (features, regions)
    means: tuple[np.ndarray, np.ndarray]  # over repeats, (features, regions) each
    power: np.ndarray  # sum of the mean squares of both settings, (features, regions)


def agreement(changes: Sequence[Change], classes: Sequence[str], threshold: float = 1.0) -> Agreement:
    """Compute all measures of changes of one kind.

    Parameters
    ----------
    changes : sequence of Change
        All with the same features and regions.
    classes : sequence of str
        Tissue class of each region.
    threshold : float, optional
        Limit of |W|.
    """
    names = list(dict.fromkeys(classes))
    member = np.array([[one == name for one in classes] for name in names], dtype=np.float64)
    center, moments = _centered_moments(changes)
    shared = np.mean([one.covariance for one in moments], axis=0)
    squares = np.mean([one.squares for one in moments], axis=0)
    error = _mean_over(squares) / 2
    level = np.mean([sum(one.means) / 2 for one in moments], axis=0)
    spread = _spread(level, member)
    tested = [_stable(one, threshold) for one in changes if min(one.a.shape[-1], one.b.shape[-1]) >= RANKSUM_REPEATS]
    stable = np.mean(tested, axis=0) if tested else np.full(level.shape, np.nan)
    concordances = np.mean([one.concordance for one in moments], axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        found = {
            "icc": jackknife_interval(shared / (shared + error), fisher, np.tanh),
            "ccc": jackknife_interval(concordances, fisher, np.tanh),
            "repeatability": jackknife_interval(_coefficient(error) / spread, _logarithm, np.exp),
            "w": _proportion(stable),
        }
        by_class = {measure: {} for measure in MEASURES}
        for name, chosen in zip(names, member, strict=True):
            own = squares @ chosen / chosen.sum() / 2
            by_class["icc"][name] = shared[:, 0] / (shared[:, 0] + own)
            # CCC = 1 - d / (d + 2 covariance), with d of the class in the numerator.
            ratio = (1 - concordances[:, 0]) / error[:, 0]
            by_class["ccc"][name] = np.where(error[:, 0] > 0, 1 - ratio * own, concordances[:, 0])
            by_class["repeatability"][name] = _coefficient(own) / spread[:, 0]
            by_class["w"][name] = stable @ chosen / chosen.sum()
    if all(one.relation == "repeats" for one in changes):  # the value is the probability by chance
        nothing = np.full(len(center), np.nan)
        found["w"] = Estimate(found["w"].value, nothing, nothing)
    largest = np.argmax([one.squares.mean(axis=1) for one in moments], axis=0)
    first, second = (
        np.stack([one.means[place] for one in moments])[largest, np.arange(len(center))] + center[:, None]
        for place in (0, 1)
    )
    shift = (second - first).mean(axis=1)
    one_sign = ((first > 0) & (second > 0)).all(axis=1) | ((first < 0) & (second < 0)).all(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        percent = np.where(one_sign, 100 * shift / np.abs(first.mean(axis=1)), np.nan)
        deviations = shift / np.sqrt(np.where(shared[:, 0] > 0, shared[:, 0], np.nan))
    return Agreement(found, by_class, largest, percent, deviations)


def _centered_moments(changes: Sequence[Change]) -> tuple[np.ndarray, list[_Moments]]:
    """Return the mean of each feature, and the moments of all changes about it."""
    center = np.mean([(one.a.mean(axis=(1, 2)) + one.b.mean(axis=(1, 2))) / 2 for one in changes], axis=0)
    size = np.mean([((one.a**2).mean(axis=(1, 2)) + (one.b**2).mean(axis=(1, 2))) / 2 for one in changes], axis=0)
    return center, [_moments(one, center[:, None, None], size) for one in changes]


def _moments(change: Change, center: np.ndarray, size: np.ndarray) -> _Moments:
    # No measure changes if one number is subtracted from all values; rounding errors are then smaller.
    a, b = change.a - center, change.b - center
    mean_a, mean_b = a.mean(axis=-1), b.mean(axis=-1)
    power = (a**2).mean(axis=-1) + (b**2).mean(axis=-1)
    if change.relation == "paired":
        products = (a * b).mean(axis=-1)
        total = (_left_out(a) * _left_out(b)).mean(axis=-1)
    elif change.relation == "independent":
        products = mean_a * mean_b
        total = _left_out(mean_a) * _left_out(mean_b)
    else:  # all pairs of different repeats
        repeats = a.shape[-1]
        products = (repeats * mean_a**2 - power / 2) / (repeats - 1)
        total = _left_out(mean_a) ** 2 + _left_out(products - mean_a**2)
    squares = ((a - b) ** 2).mean(axis=-1) if change.relation == "paired" else power - 2 * products
    squares[squares <= ROUNDING * size[:, None]] = 0.0
    number = _numbers(squares.shape[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        covariance = (_left_out(products) - total / number) / np.where(number > 1, number - 1, np.nan)
        lin = _mean_over(products) - _mean_over(mean_a) * _mean_over(mean_b) + np.where(number > 1, 0.0, np.nan)
        lin[np.abs(lin) <= ROUNDING * size[:, None]] = 0.0
        covariance[np.abs(covariance) <= ROUNDING * size[:, None]] = 0.0
        concordance = 2 * lin / (_mean_over(squares) + 2 * lin)
    return _Moments(covariance, concordance, squares, (mean_a, mean_b), power)


def _left_out(x: np.ndarray) -> np.ndarray:
    """Sums over regions (axis 1): of all, then of all without each region."""
    total = x.sum(axis=1, keepdims=True)
    return np.concatenate([total, total - x], axis=1)


def _numbers(regions: int) -> np.ndarray:
    return np.array([regions] + [regions - 1] * regions)


def _mean_over(x: np.ndarray) -> np.ndarray:
    """Means over regions (axis 1), as `_left_out`."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return _left_out(x) / _numbers(x.shape[1])


def _coefficient(variance: np.ndarray) -> np.ndarray:
    """Repeatability coefficient: 95 % of the differences of two scans are smaller."""
    return scipy.stats.norm.ppf((1 + CONFIDENCE) / 2) * np.sqrt(2 * variance)


def _spread(level: np.ndarray, member: np.ndarray) -> np.ndarray:
    """SD of the means of tissue classes, shape (features, 1 + regions); NaN with fewer than two classes.

    Parameters
    ----------
    level : ndarray, shape (features, regions)
    member : ndarray, shape (classes, regions)
        1 for the regions of a class, otherwise 0.
    """
    regions = level.shape[1]
    found = []
    for weights in np.vstack([np.ones(regions), 1 - np.eye(regions)]):
        chosen = (member * weights)[(member * weights).any(axis=1)]
        if len(chosen) < 2:
            found.append(np.full(len(level), np.nan))
        else:
            found.append((level @ (chosen / chosen.sum(axis=1, keepdims=True)).T).std(axis=1, ddof=1))
    return np.stack(found, axis=1)


def _stable(change: Change, threshold: float) -> np.ndarray:
    """Whether |W| is below the threshold, 1 or 0, shape (features, regions).

    For repeats of one setting, the probability by chance.
    """
    if change.relation == "repeats":
        return np.full(change.a.shape[:2], stable_probability(change.a.shape[-1], threshold))
    z = ranksum_z(np.moveaxis(change.a, -1, 0), np.moveaxis(change.b, -1, 0))
    return (z < threshold).astype(np.float64)


def _proportion(stable: np.ndarray) -> Estimate:
    """Share of stable comparisons with its interval of Clopper and Pearson [1]_.

    Comparisons in one region depend on each other, so that the interval counts each region once. A jackknife would have
    no width if all comparisons agree.

    References
    ----------
    .. [1] Clopper and Pearson, Biometrika 26, 404, 1934.
    """
    regions, value = stable.shape[1], stable.mean(axis=1)
    number, tail = regions * value, (1 - CONFIDENCE) / 2
    beta = scipy.stats.beta
    low = np.where(value > 0, beta.ppf(tail, number, regions - number + 1), value)
    high = np.where(value < 1, beta.ppf(1 - tail, number + 1, regions - number), value)
    return Estimate(value, low, high)


def fisher(x: np.ndarray) -> np.ndarray:
    """Return Fisher's z of correlations; finite for -1 and 1."""
    return np.arctanh(np.clip(x, -NEARLY_ONE, NEARLY_ONE))


def _logarithm(x: np.ndarray) -> np.ndarray:
    return np.log(np.maximum(x, 1 - NEARLY_ONE))


def jackknife_interval(
    x: np.ndarray,
    forward: Callable[[np.ndarray], np.ndarray] = np.asarray,
    backward: Callable[[np.ndarray], np.ndarray] = np.asarray,
) -> Estimate:
    """Compute jackknife intervals over regions.

    Parameters
    ----------
    x : ndarray, shape (features, 1 + regions)
        Values from all regions, then without each region.
    forward, backward : callable, optional
        Transformation of the values to the scale of the interval, and its inverse.
    """
    value, left_out = forward(x)[:, 0], forward(x)[:, 1:]
    regions = left_out.shape[1]
    if regions < 3:  # no degree of freedom, or no variance without one region
        nothing = np.full(len(x), np.nan)
        return Estimate(x[:, 0], nothing, nothing)
    half = scipy.stats.t.ppf((1 + CONFIDENCE) / 2, regions - 1) * standard_error(left_out)
    return Estimate(x[:, 0], backward(value - half), backward(value + half))


def _orders(regions: int) -> np.ndarray:
    """Orders of the regions other than their own: all if there are at most EXCHANGES, otherwise random ones."""
    if scipy.special.factorial(regions) <= EXCHANGES:
        return np.array(list(permutations(range(regions)))[1:], dtype=int).reshape(-1, regions)
    rng = generator(root(SEED))
    return np.array([rng.permutation(regions) for _ in range(EXCHANGES)])


def exchanged_icc(changes: Sequence[Change]) -> np.ndarray:
    """Return the ICC after exchanges of the regions of the second setting, a control: shape (features, exchanges)."""
    _, moments = _centered_moments(changes)
    regions = moments[0].squares.shape[1]
    orders = _orders(regions)
    shared, error = 0.0, 0.0
    for one in moments:
        a, b = one.means
        products = (a[:, :, None] * b[:, None, :])[:, np.arange(regions), orders].sum(axis=-1)
        total = a.sum(axis=1) * b.sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            shared = shared + (products - total[:, None] / regions) / (regions - 1)
        error = error + (one.power.sum(axis=1)[:, None] - 2 * products) / regions / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        return shared / (shared + error)
