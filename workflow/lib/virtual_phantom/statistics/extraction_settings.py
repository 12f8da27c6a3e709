"""Robustness and discriminative power of features with different extraction settings of the same images.

Robustness is the ICC(2,1) of single scans between conditions (protocols and noise levels), with ROIs as subjects. A
study of one condition has the ICC between repeats instead, and a study of one ROI the stability by W. Discriminative
power is from `wilcoxon.scores`. Changes of the ICC have an interval on the scale of Fisher's z, from the jackknife
over ROIs of `changes`. Differences of the ICC itself, whose error depends on its value, are detected less often.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from ..base.errors import InputError
from ..features.names import family, features_of
from ..features.variations import OWN
from . import agreement_measures, wilcoxon
from .changes import fisher, jackknife_interval
from .stability_measures import feature_array

BETWEEN_CONDITIONS, BETWEEN_REPEATS, BY_RANKS = "ICC(2,1)", "ICC(2,1) between repeats", "W stability"
ROUNDING = 1e-9  # rounding error of a measure
RESULTS = ("robustness", "ci95_low", "ci95_high", "change", "change_z", "change_z_low", "change_z_high") + (
    "discrimination_percent",
    "discrimination_change",
)


def settings_table(tables: Mapping[str, pd.DataFrame], **options) -> pd.DataFrame:
    """Compute robustness and discriminative power of every feature with every setting.

    Parameters
    ----------
    tables : mapping of str to DataFrame
        {setting: features}, the study's own setting (`OWN`) among them: one row per image and ROI, with columns group
        (the condition), roi, tissue_class, seed and features. Features that are not in all tables are ignored. A
        feature that a setting leaves undefined (NaN) in some ROI, such as one with too few voxels after resampling, has
        no results with this setting.
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
        * change: robustness minus that with the study's setting
        * change_z, change_z_low, change_z_high: change of Fisher's z of the ICC with its 95 % interval (ICC only)
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
    undefined = {name: table[features].isna().any().to_numpy() & (name != OWN) for name, table in tables.items()}
    # Zeros are no result: all results of these features are set to NaN below.
    tables = {
        name: table.fillna(dict.fromkeys(np.array(features)[undefined[name]], 0.0)) for name, table in tables.items()
    }
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
    own_icc = _without_each(x[OWN]) if rois > 1 else None
    parts = []
    for name, values in x.items():
        missing = np.full(len(features), np.nan)
        low = high = missing
        z = agreement_measures.Estimate(missing, missing, missing)
        robustness = scores[name]["stability_percent"].to_numpy()
        before = scores[OWN]["stability_percent"].to_numpy()
        if rois > 1:
            icc, before = agreement_measures.icc_agreement(values), own_icc[:, 0]
            robustness, low, high = icc.value, icc.low, icc.high
            z = jackknife_interval(fisher(_without_each(values)) - fisher(own_icc))
        power = scores[name]["discrimination_percent"]
        rows = pd.DataFrame(
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
                "change_z": z.value,
                "change_z_low": z.low,
                "change_z_high": z.high,
                "discrimination_percent": power,
                "discrimination_change": power - scores[OWN]["discrimination_percent"],
                "rois": rois,
                "conditions": conditions,
                "repeats": repeats,
            }
        )
        rows.loc[undefined[name], list(RESULTS)] = np.nan
        parts.append(rows)
    table = pd.concat(parts, ignore_index=True)
    table = table.sort_values("feature", key=pd.Index(features).get_indexer, kind="stable", ignore_index=True)
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
        * robustness_study, robustness, change, change_z, change_z_low, change_z_high
        * more_robust: yes if the interval of change_z is above 0, no if the study's setting is the best, else
          undecided
        * discrimination_study_percent, discrimination_percent, discrimination_change
    """
    best = table[table["most_robust"] == "yes"]
    own = table[table["setting"] == OWN].set_index("feature")
    found = best[["feature", "family", "setting", "robust_by"]].reset_index(drop=True)
    found["robustness_study"] = own["robustness"].loc[best["feature"]].to_numpy()
    for name in ("robustness", "change", "change_z", "change_z_low", "change_z_high"):
        found[name] = best[name].to_numpy()
    certain = np.where(found["change_z_low"] > 0, "yes", "undecided")
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


def wide_table(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table from `long_table` with one row per setting, image and ROI; features defined with all settings."""
    settings, groups = table["setting"].nunique(), table.groupby("feature", sort=False)
    features = [n for n, rows in groups if rows["setting"].nunique() == settings and rows["value"].notna().all()]
    keys = ["setting", "protocol", "noise", "seed", "roi", "tissue_class"]
    wide = table.pivot(index=keys, columns="feature", values="value")[features].reset_index()
    rois = pd.Index(table["roi"].unique())
    return wide.sort_values("roi", key=rois.get_indexer, kind="stable", ignore_index=True)


def _without_each(x: np.ndarray) -> np.ndarray:
    """ICC(2,1) of every feature: of all ROIs, then without each ROI if two remain; shape (features, 1 + ROIs)."""
    rois = x.shape[1]
    others = [np.delete(x, roi, axis=1) for roi in range(rois)] if rois > 2 else []
    return np.stack([agreement_measures.icc_agreement_value(values) for values in (x, *others)], axis=1)
