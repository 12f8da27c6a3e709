"""Robustness and discriminative power of features with different extraction settings of the same images.

Robustness is the ICC(2,1) of single scans between conditions (protocols and noise levels), with ROIs as subjects. A
study of one condition has the ICC between repeats instead, and a study of one ROI the stability by W. Discriminative
power is that of `wilcoxon.scores`. A change of the ICC has an interval from a bootstrap over ROIs [1]_, which keeps the
pairs of settings.

References
----------
.. [1] Efron and Tibshirani, An Introduction to the Bootstrap, 1993.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from ..base.errors import InputError
from ..base.streams import generator
from ..features.names import family, features_of
from ..features.variations import OWN
from . import agreement_measures, wilcoxon
from .stability_measures import feature_array

BETWEEN_CONDITIONS, BETWEEN_REPEATS, BY_RANKS = "ICC(2,1)", "ICC(2,1) between repeats", "W stability"
DRAWS = 1000  # resampled sets of ROIs: the error of a 2.5 % quantile is 0.5 %
SEED = 4734  # seed of the resampled ROIs, the same in every study
TAIL = 0.025  # tail probability on either side of a 95 % interval
ROUNDING = 1e-9  # rounding error of a measure


def settings_table(tables: Mapping[str, pd.DataFrame], **options) -> pd.DataFrame:
    """Compute robustness and discriminative power of every feature with every setting.

    Parameters
    ----------
    tables : mapping of str to DataFrame
        {setting: features}, the study's own setting (`OWN`) among them: one row per image and ROI, with columns group
        (the condition), roi, tissue_class, seed and features. Features that are not in all tables are ignored.
    **options
        Options of `wilcoxon.scores`.

    Returns
    -------
    DataFrame
        One row per feature and setting:

        * feature, family, setting
        * has_effect: whether any value of the feature differs from that with the study's setting
        * robust_by: the measure of robustness, see the module's docstring
        * robustness, ci95_low, ci95_high: its value, with the interval of the ICC
        * change, change_low, change_high: robustness minus that with the study's setting, with its interval (ICC only)
        * discrimination_percent, discrimination_change (percentage points); NaN for a single tissue class
        * most_robust: yes for the setting with the largest robustness, of equal ones the study's or the first
        * rois, conditions, repeats: sample sizes

    Raises
    ------
    InputError
        If there is one ROI and one condition, tables differ in their rows, or as `wilcoxon.scores`.
    """
    own = tables[OWN]
    features = [name for name in features_of(own) if all(name in table for table in tables.values())]
    x = {name: feature_array(table, features, f"setting {name}") for name, table in tables.items()}
    _, rois, conditions, repeats = x[OWN].shape
    for name, values in x.items():
        if values.shape != x[OWN].shape:
            raise InputError(f"setting {name}: has other ROIs or images than the study's features; extract again")
    if rois < 2 and conditions < 2:
        raise InputError("analyses.extraction: one ROI in one condition has no robustness; add a protocol or an ROI")
    if rois < 2:
        robust_by = BY_RANKS
    elif conditions < 2:
        robust_by = BETWEEN_REPEATS
        x = {name: values.swapaxes(-1, -2) for name, values in x.items()}
    else:
        robust_by = BETWEEN_CONDITIONS
    scores = {name: wilcoxon.scores(table, features, **options) for name, table in tables.items()}
    draws = {name: _resampled(values) for name, values in x.items()} if rois > 1 else {}
    parts = []
    for name, values in x.items():
        missing = np.full(len(features), np.nan)
        change_low = change_high = low = high = missing
        robustness = scores[name]["stability_percent"].to_numpy()
        before = scores[OWN]["stability_percent"].to_numpy()
        if rois > 1:
            icc, before = agreement_measures.icc_agreement(values), agreement_measures.icc_agreement(x[OWN]).value
            robustness, low, high = icc.value, icc.low, icc.high
            change_low, change_high = _quantiles(draws[name] - draws[OWN])
        power = scores[name]["discrimination_percent"]
        parts.append(
            pd.DataFrame(
                {
                    "feature": features,
                    "family": [family(feature) for feature in features],
                    "setting": name,
                    "has_effect": np.any(values != x[OWN], axis=(1, 2, 3)),
                    "robust_by": robust_by,
                    "robustness": robustness,
                    "ci95_low": low,
                    "ci95_high": high,
                    "change": robustness - before,
                    "change_low": change_low,
                    "change_high": change_high,
                    "discrimination_percent": power,
                    "discrimination_change": power - scores[OWN]["discrimination_percent"],
                    "rois": rois,
                    "conditions": conditions,
                    "repeats": repeats,
                }
            )
        )
    table = pd.concat(parts, ignore_index=True)
    order = {feature: index for index, feature in enumerate(features)}
    table = table.sort_values("feature", key=lambda names: names.map(order), kind="stable", ignore_index=True)
    best = np.zeros(len(table), dtype=bool)
    for _, rows in table.groupby("feature", sort=False):
        if rows["robustness"].notna().any():
            near = rows["robustness"] >= rows["robustness"].max() - ROUNDING
            own_first = rows[near].sort_values("setting", key=lambda names: names != OWN, kind="stable")
            best[own_first.index[0]] = True
    table.insert(table.columns.get_loc("rois"), "most_robust", np.where(best, "yes", "no"))
    table["has_effect"] = np.where(table["has_effect"], "yes", "no")
    return table


def choice_table(table: pd.DataFrame) -> pd.DataFrame:
    """Return the most robust setting of each feature.

    Parameters
    ----------
    table : DataFrame
        From `settings_table`.

    Returns
    -------
    DataFrame
        One row per feature with a robustness:

        * feature, family, setting, robust_by
        * robustness_study, robustness, change, change_low, change_high
        * more_robust: yes if the interval of the change is above 0, no if the study's setting is the best, else
          undecided
        * discrimination_study_percent, discrimination_percent, discrimination_change
    """
    best = table[table["most_robust"] == "yes"]
    own = table[table["setting"] == OWN].set_index("feature")
    found = best[["feature", "family", "setting", "robust_by"]].reset_index(drop=True)
    found["robustness_study"] = own["robustness"].loc[best["feature"]].to_numpy()
    for name in ("robustness", "change", "change_low", "change_high"):
        found[name] = best[name].to_numpy()
    certain = np.where(found["change_low"] > 0, "yes", "undecided")
    found["more_robust"] = np.where(found["setting"] == OWN, "no", certain)
    found["discrimination_study_percent"] = own["discrimination_percent"].loc[best["feature"]].to_numpy()
    for name in ("discrimination_percent", "discrimination_change"):
        found[name] = best[name].to_numpy()
    return found


def long_table(tables: Mapping[str, pd.DataFrame], factors: Mapping[str, Mapping]) -> pd.DataFrame:
    """Return the features of all settings with one row per setting, image, ROI and feature.

    Parameters
    ----------
    tables : mapping of str to DataFrame
        As for `settings_table`, with columns protocol and noise.
    factors : mapping of str to mapping
        {setting: its factor and value}; none for the study's own.

    Returns
    -------
    DataFrame
        Columns setting, factor, setting_value, protocol, noise, seed, roi, tissue_class, feature, value.
    """
    keys = ["protocol", "noise", "seed", "roi", "tissue_class"]
    parts = []
    for name, table in tables.items():
        rows = table.melt(keys, features_of(table), "feature", "value")
        known = factors.get(name, {"factor": "", "value": ""})
        rows.insert(0, "setting", name)
        rows.insert(1, "factor", known["factor"])
        rows.insert(2, "setting_value", str(known["value"]))
        parts.append(rows)
    return pd.concat(parts, ignore_index=True)


def _resampled(x: np.ndarray) -> np.ndarray:
    """ICC(2,1) of every feature for DRAWS sets of ROIs drawn with replacement, the same for all settings."""
    rng = generator(SEED)
    chosen = rng.integers(x.shape[1], size=(DRAWS, x.shape[1]))
    return np.array([agreement_measures.icc_agreement_value(x[:, rois]) for rois in chosen])


def _quantiles(draws: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Limits of the 95 % interval of every column; NaN for a column without finite values."""
    finite = np.isfinite(draws)
    draws = np.where(finite | ~finite.any(axis=0), draws, np.nan)
    with np.errstate(invalid="ignore"):
        some = finite.any(axis=0)
        low, high = np.full(draws.shape[1], np.nan), np.full(draws.shape[1], np.nan)
        low[some], high[some] = np.nanquantile(draws[:, some], [TAIL, 1 - TAIL], axis=0)
    return low, high
