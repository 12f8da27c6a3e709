"""Stability and discriminative power of features from the Wilcoxon rank-sum statistic W.

A pair of groups is stable for a feature of a tissue class if W < 1. A feature discriminates a pair of tissue classes in
one group if W > 1 [1]_. The paper does not define W and samples completely. The choices below reproduce its results
on the measured table of CT-Phantom4Radiomics (tests/statistics/test_statistics_wilcoxon.py):

* W is |z|, the standardized rank sum.
* `compare` defines a sample. "roi" (default): the repeats of one ROI; pairs of ROIs of different classes are compared.
  "tissue_class": the pooled repeats of all ROIs of a class. Features that grow with the ROI (Energy,
  non-uniformities, large areas) are the most discriminative ones in the paper. Pooling ROIs of different sizes ranks
  most of them in the last third.

References
----------
.. [1] Flouris et al., Sci. Rep. 12, 2022, Results.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd
import scipy

from ..base.errors import InputError
from ..features.names import family
from ..features.tables import finite_values, require_unique_rows
from .comparability import SHAPES


def ranksum_z(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """|z| of the rank-sum test of two samples for every feature: normal approximation, mid-ranks for ties [1]_.

    Equal to scipy.stats.ranksums, which ranks one feature at a time and takes thirty times as long.

    Parameters
    ----------
    a, b : ndarray, shape (repeats, features)

    Returns
    -------
    ndarray, shape (features,)

    References
    ----------
    .. [1] Wilcoxon, Biometrics 1, 80, 1945.
    """
    n, m = len(a), len(b)
    rank_sum = scipy.stats.rankdata(np.concatenate([a, b]), axis=0)[:n].sum(axis=0)
    return np.abs(rank_sum - n * (n + m + 1) / 2) / np.sqrt(n * m * (n + m + 1) / 12)


TESTS: dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {"ranksum_z": ranksum_z}
COMPARE = ("roi", "tissue_class")


@dataclass(frozen=True)
class Comparisons:
    """Results of all comparisons of a study.

    Attributes
    ----------
    features : tuple of str
    varies : ndarray of bool, shape (features,)
        `varying`.
    groups : tuple of int
    class_of : dict of str to str
        {sample: tissue class}: ROIs or classes, see `compare`.
    sizes : dict of str to int
        {sample: values in the first group}.
    stable : dict of str to ndarray of bool, shape (pairs of groups, features)
        Whether |W| is below the threshold, for every sample.
    differing : dict of tuple of str to ndarray of bool, shape (groups, features)
        Whether |W| is above the threshold, for every pair of samples.
    """

    features: tuple[str, ...]
    varies: np.ndarray
    groups: tuple[int, ...]
    class_of: dict[str, str]
    sizes: dict[str, int]
    stable: dict[str, np.ndarray]
    differing: dict[tuple[str, str], np.ndarray]

    def pairs(self, same_class: bool) -> list[tuple[str, str]]:
        """Return the pairs of samples of the same or of different tissue classes."""
        return [(a, b) for a, b in self.differing if (self.class_of[a] == self.class_of[b]) == same_class]


def comparisons(
    table: pd.DataFrame,
    features: Sequence[str],
    *,
    test: str = "ranksum_z",
    threshold: float = 1.0,
    compare: str = "roi",
    source: str = "features",
) -> Comparisons:
    """Compare all pairs of groups for each ROI, and all pairs of ROIs in each group; arguments as in `scores`."""
    if test not in TESTS:
        raise InputError(f"statistics.test: {test!r} is not known; choose from {', '.join(TESTS)}")
    if compare not in COMPARE:
        raise InputError(f"statistics.compare: {compare!r} is not known; choose from {', '.join(COMPARE)}")
    if not threshold > 0:
        raise InputError(f"statistics.threshold: {threshold} must be positive")
    if "seed" in table:
        require_unique_rows(table, source)
    values = finite_values(table, features, source)
    samples = {key: values[rows] for key, rows in table.groupby(["group", compare]).indices.items()}
    class_of = dict(zip(table[compare], table["tissue_class"], strict=True))  # in order of appearance
    groups = sorted(table["group"].unique())
    if not len(groups):
        raise InputError(f"{source}: has no rows; make the table again")
    for group in groups:
        for unit in class_of:
            if (group, unit) not in samples:
                raise InputError(f"{source}: group {group} has no {compare} {unit}; all groups need the same")
    w = TESTS[test]
    return Comparisons(
        features=tuple(features),
        varies=varying(table, features, source),
        groups=tuple(groups),
        class_of=class_of,
        sizes={unit: len(samples[groups[0], unit]) for unit in class_of},
        stable={
            unit: np.array([w(samples[a, unit], samples[b, unit]) for a, b in combinations(groups, 2)]).reshape(
                -1, len(features)
            )
            < threshold
            for unit in class_of
        },
        differing={
            (a, b): np.array([w(samples[group, a], samples[group, b]) for group in groups]) > threshold
            for a, b in combinations(class_of, 2)
        },
    )


def varying(table: pd.DataFrame, features: Sequence[str], source: str = "features") -> np.ndarray:
    """Return whether the repeats of a group and ROI differ, for every feature; shape features count as not varying.

    Without variation, all ranks are tied or ordered, so W says nothing about noise or protocols: a feature of the mask
    alone would be 100 % stable and 100 % discriminative. With one repeat, all but shape features count as varying.

    Parameters
    ----------
    table : DataFrame
        One row per image and ROI, with columns group, roi and `features`.

    Returns
    -------
    ndarray of bool, shape (features,)
    """
    values = finite_values(table, features, source)
    return repeats_differ([values[rows] for rows in table.groupby(["group", "roi"]).indices.values()], features)


def repeats_differ(samples: Iterable[np.ndarray], features: Sequence[str]) -> np.ndarray:
    """Return the result of `varying` for arrays with repeats on the first axis and features on the last."""
    repeated = [
        (np.ptp(sample, axis=0) > 0).reshape(-1, len(features)).any(axis=0) for sample in samples if len(sample) > 1
    ]
    shape = np.array([family(feature) in SHAPES for feature in features], dtype=bool)
    return ~shape & (np.any(repeated, axis=0) if repeated else True)


def scores(
    table: pd.DataFrame,
    features: Sequence[str],
    *,
    test: str = "ranksum_z",
    threshold: float = 1.0,
    compare: str = "roi",
    source: str = "features",
) -> pd.DataFrame:
    """Stability and discriminative power of every feature.

    Stability: percentage of pairs of groups, over all ROIs (or classes, see `compare`), with W below `threshold`.
    Discrimination: percentage of pairs of ROIs (or classes) of different classes, over all groups, with W above it.
    A percentage without comparisons is NaN: stability of a single group, discrimination of a single class.

    Parameters
    ----------
    table : DataFrame
        One row per image and ROI, with columns group, roi, tissue_class, `features`, and optionally seed.
    test : {"ranksum_z"}, optional
        One of TESTS.
    compare : {"roi", "tissue_class"}, optional
        What one sample is, see the module's docstring.
    source : str, optional
        Start of error messages.

    Returns
    -------
    DataFrame
        One row per feature: feature, family, stability_percent, discrimination_percent, stability_{class} (percent) for
        every class, stability_comparisons, discrimination_comparisons. Percentages are NaN for features that do not
        vary (`varying`).

    Raises
    ------
    InputError
        For an unknown test or `compare`, an empty table, a missing ROI, a repeated seed, or values that are not finite.
    """
    found = comparisons(table, features, test=test, threshold=threshold, compare=compare, source=source)
    all_stable = np.concatenate(list(found.stable.values()))
    none = np.empty((0, len(features)), dtype=bool)
    discriminated = np.concatenate([none, *(found.differing[pair] for pair in found.pairs(same_class=False))])
    by_class = {
        name: np.concatenate([stable for unit, stable in found.stable.items() if found.class_of[unit] == name])
        for name in dict.fromkeys(found.class_of.values())
    }

    def percent(successes: np.ndarray) -> np.ndarray:
        if not len(successes):
            return np.full(len(features), np.nan)
        return np.where(found.varies, 100 * successes.sum(axis=0) / len(successes), np.nan)

    return pd.DataFrame(
        {
            "feature": list(features),
            "family": [family(feature) for feature in features],
            "stability_percent": percent(all_stable),
            "discrimination_percent": percent(discriminated),
            **{f"stability_{name}": percent(results) for name, results in by_class.items()},
            "stability_comparisons": len(all_stable),
            "discrimination_comparisons": len(discriminated),
        }
    )
