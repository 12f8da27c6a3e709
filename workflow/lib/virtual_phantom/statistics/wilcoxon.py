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

from collections.abc import Callable, Sequence
from itertools import combinations

import numpy as np
import pandas as pd
import scipy

from ..base.errors import InputError
from ..features.names import family
from ..features.tables import finite_values, require_unique_rows


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
        every class, stability_comparisons, discrimination_comparisons.

    Raises
    ------
    InputError
        For an unknown test or `compare`, fewer than two groups or classes, a missing ROI, a repeated seed, or values
        that are not finite.
    """
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
    for kind, names in (("group", groups), ("tissue class", set(class_of.values()))):
        if len(names) < 2:
            raise InputError(f"{source}: {len(names)} {kind}; stability and discrimination need at least two")
    for group in groups:
        for unit in class_of:
            if (group, unit) not in samples:
                raise InputError(f"{source}: group {group} has no {compare} {unit}; all groups need the same")
    w = TESTS[test]
    stable = {
        unit: np.array([w(samples[a, unit], samples[b, unit]) for a, b in combinations(groups, 2)]) < threshold
        for unit in class_of
    }
    pairs = [(a, b) for a, b in combinations(class_of, 2) if class_of[a] != class_of[b]]
    between = [w(samples[group, a], samples[group, b]) for group in groups for a, b in pairs]
    discriminated = np.array(between) > threshold
    all_stable = np.concatenate(list(stable.values()))
    by_class = {
        name: np.concatenate([stable[unit] for unit in class_of if class_of[unit] == name])
        for name in dict.fromkeys(class_of.values())
    }
    return pd.DataFrame(
        {
            "feature": list(features),
            "family": [family(feature) for feature in features],
            "stability_percent": _percent(all_stable),
            "discrimination_percent": _percent(discriminated),
            **{f"stability_{name}": _percent(comparisons) for name, comparisons in by_class.items()},
            "stability_comparisons": len(all_stable),
            "discrimination_comparisons": len(discriminated),
        }
    )


def _percent(successes: np.ndarray) -> np.ndarray:
    return 100 * successes.sum(axis=0) / len(successes)
