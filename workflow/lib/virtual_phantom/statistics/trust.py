"""Which features can be trusted: the stability of each with its interval, what it rests on, and a sentence."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence

import numpy as np
import pandas as pd

from ..base.errors import InputError
from ..features.names import family
from .stability_interval import agreeing, intervals
from .stability_measures import cube
from .wilcoxon import COMPARE

VERDICTS = {"yes": "Stable", "no": "Not stable", "undecided": "Undecided"}


def table(
    features_table: pd.DataFrame,
    features: Sequence[str],
    sharing: Mapping[int, Hashable],
    cut_off: float,
    *,
    threshold: float = 1.0,
    compare: str = "roi",
    source: str = "features",
) -> pd.DataFrame:
    """What can be said of every feature.

    Parameters
    ----------
    features_table : DataFrame
        One row per image and ROI, with columns group, roi, tissue_class, seed and `features`.
    sharing : mapping of int to hashable
        For each group what it has in common with the groups whose noise is the same, repeat by repeat.
    cut_off : float
        Percent of stable comparisons from which on a feature is called stable.
    threshold : float, optional
        A comparison is stable if |W| is below.
    compare : {"roi", "tissue_class"}, optional
        What a sample is, as in `wilcoxon.scores`.
    source : str, optional
        What the message begins with.

    Returns
    -------
    DataFrame
        One row per feature, in percent where a name says so: feature, family, stability_percent, ci95_low, ci95_high
        (95 % interval of the expected stability), stable (yes: the interval lies from the cut-off up; no: below it;
        undecided), cut_off_percent, groups, rois, repeats, comparisons, if_equal_percent (what protocols that do not
        differ give on average), twice_repeats_percent, twice_repeats_low, twice_repeats_high (what is expected of twice
        the repeats), sentence.

    Raises
    ------
    InputError
        For an unknown `compare`, a group that lacks a seed of an ROI, or fewer than two groups or ROIs.
    """
    if compare not in COMPARE:
        raise InputError(f"statistics.compare: {compare!r} is not known; choose from {', '.join(COMPARE)}")
    x = cube(features_table, features, source)
    class_of = dict(zip(features_table["roi"], features_table[compare], strict=True))
    units = [
        [place for place, unit in enumerate(class_of.values()) if unit == one]
        for one in dict.fromkeys(class_of.values())
    ]
    groups = np.sort(features_table["group"].unique())
    found = intervals(x, units, [sharing[group] for group in groups], threshold)
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
            "if_equal_percent": 100 * np.mean([agreeing(repeats * len(unit), threshold) for unit in units]),
            "twice_repeats_percent": 100 * found.twice,
            "twice_repeats_low": 100 * found.twice_low,
            "twice_repeats_high": 100 * found.twice_high,
        }
    )
    return result.assign(sentence=[sentence(row) for _, row in result.iterrows()])


def verdicts(low: np.ndarray, high: np.ndarray, cut_off: float) -> np.ndarray:
    """yes, no or undecided, by where the interval lies; without one undecided.

    Parameters
    ----------
    low, high : ndarray
        Percent.
    cut_off : float
        Percent.
    """
    return np.where(low >= cut_off, "yes", np.where(high < cut_off, "no", "undecided"))


def sentence(row: Mapping) -> str:
    """What a row of `table` says, for a person."""
    if np.isnan(row["ci95_low"]):
        return "Undecided: one repeat a group has no spread. Ask for two repeats or more."
    share = "{} % of {} comparisons between protocols agree (95 % interval {} to {} %)".format(
        *(percent(row["stability_percent"]), row["comparisons"], percent(row["ci95_low"]), percent(row["ci95_high"]))
    )
    later = "{} % ({} to {} %)".format(*(percent(row[f"twice_repeats_{what}"]) for what in ("percent", "low", "high")))
    return f"{VERDICTS[row['stable']]}: {share}. Twice the repeats would give about {later}."


def percent(value: float) -> str:
    """A percentage to one digit below ten, and whole above."""
    return f"{value:.0f}" if value == 0 or value >= 9.95 else f"{value:.1f}"
