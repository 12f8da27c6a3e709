"""Table of stable features: stability with its interval, verdict, sample sizes, and a sentence for each feature."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence

import numpy as np
import pandas as pd

from ..base.errors import InputError
from ..features.names import family
from .comparability import SHAPES
from .rank_sum import stable_probability
from .stability_interval import stability_intervals
from .stability_measures import UNVARYING, feature_array
from .wilcoxon import COMPARE, varying

VERDICTS = {"yes": "Stable", "no": "Not stable", "undecided": "Undecided"}


def trust_table(
    features_table: pd.DataFrame,
    features: Sequence[str],
    sharing: Mapping[int, Hashable],
    cut_off: float,
    *,
    threshold: float = 1.0,
    compare: str = "roi",
    source: str = "features",
) -> pd.DataFrame:
    """Compute the stability of every feature with its interval and verdict.

    Parameters
    ----------
    features_table : DataFrame
        One row per image and ROI, with columns group, roi, tissue_class, seed and `features`.
    sharing : mapping of int to hashable
        Key of each group; groups with equal keys share their noise, repeat by repeat.
    cut_off : float
        Stability (percent) of a stable feature.
    threshold : float, optional
        A comparison is stable if |W| is below this value.
    compare : {"roi", "tissue_class"}, optional
        What one sample is: an ROI, or all ROIs of a tissue class, as in `wilcoxon.scores`.
    source : str, optional
        Start of error messages.

    Returns
    -------
    DataFrame
        One row per feature:

        * feature, family
        * stability_percent, ci95_low, ci95_high: with the 95 % interval of the expected stability
        * stable: yes if the interval is at or above cut_off_percent, no if it is below, else undecided; UNVARYING, with
          NaN as stability and interval, for features that do not vary (`wilcoxon.varying`)
        * cut_off_percent, groups, rois, repeats, comparisons
        * if_equal_percent: expected stability of protocols that do not differ
        * twice_repeats_percent, twice_repeats_low, twice_repeats_high: forecast for twice the repeats
        * sentence: the result in words

    Raises
    ------
    InputError
        For an unknown `compare`, a group that lacks a seed of an ROI, or fewer than two groups.
    """
    if compare not in COMPARE:
        raise InputError(f"statistics.compare: {compare!r} is not known; choose from {', '.join(COMPARE)}")
    x = feature_array(features_table, features, source)
    if x.shape[2] < 2:
        raise InputError(f"{source}: 1 group; stability needs at least two")
    class_of = dict(zip(features_table["roi"], features_table[compare], strict=True))
    unit_of = list(class_of.values())
    units = [[index for index, unit in enumerate(unit_of) if unit == name] for name in dict.fromkeys(unit_of)]
    groups = np.sort(features_table["group"].unique())
    found = stability_intervals(x, units, [sharing[group] for group in groups], threshold)
    _, rois, number, repeats = x.shape
    result = pd.DataFrame(
        {
            "feature": list(features),
            "family": [family(feature) for feature in features],
            "stability_percent": 100 * found.value,
            "ci95_low": 100 * found.low,
            "ci95_high": 100 * found.high,
            "stable": verdicts(100 * found.low, 100 * found.high, cut_off),
            "cut_off_percent": float(cut_off),
            "groups": number,
            "rois": rois,
            "repeats": repeats,
            "comparisons": len(units) * number * (number - 1) // 2,
            "if_equal_percent": 100 * np.mean([stable_probability(repeats * len(unit), threshold) for unit in units]),
            "twice_repeats_percent": 100 * found.twice,
            "twice_repeats_low": 100 * found.twice_low,
            "twice_repeats_high": 100 * found.twice_high,
        }
    )
    unvarying = ~varying(features_table, features, source)
    measured = [name for name in result if name.endswith(("_percent", "_low", "_high"))]
    result.loc[unvarying, [name for name in measured if name not in ("cut_off_percent", "if_equal_percent")]] = np.nan
    result.loc[unvarying, "stable"] = UNVARYING
    return result.assign(sentence=[sentence(row) for _, row in result.iterrows()])


def verdicts(low: np.ndarray, high: np.ndarray, cut_off: float) -> np.ndarray:
    """Compare intervals with the cut-off: yes, no or undecided (also without an interval)."""
    return np.where(low >= cut_off, "yes", np.where(high < cut_off, "no", "undecided"))


def sentence(row: Mapping) -> str:
    """Describe a row of `trust_table` in words."""
    if row.get("stable") == UNVARYING:
        if row["family"] in SHAPES:
            return "Does not vary: shape features depend on the ROI only, not on the images."
        return "Does not vary: all repeats of each protocol have the same value, so W has no meaning."
    if np.isnan(row["ci95_low"]):
        return "Undecided: one repeat per group gives no interval. Use at least two repeats."
    share = "{} % of {} comparisons between protocols agree (95 % interval {} to {} %)".format(
        *(percent(row["stability_percent"]), row["comparisons"], percent(row["ci95_low"]), percent(row["ci95_high"]))
    )
    twice = "{} % ({} to {} %)".format(*(percent(row[f"twice_repeats_{name}"]) for name in ("percent", "low", "high")))
    return f"{VERDICTS[row['stable']]}: {share}. Twice the repeats would give about {twice}."


def percent(value: float) -> str:
    """Format a percentage: one decimal below ten, none above."""
    return f"{value:.0f}" if value == 0 or value >= 9.95 else f"{value:.1f}"
