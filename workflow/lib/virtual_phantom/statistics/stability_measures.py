"""Stability of features by several measures with cut-offs: W, ICC, CCC, coefficients of variation and dispersion.

`agreement_measures` has the equations and sources, and config.schema.yaml the reasons for the default cut-offs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from ..base.errors import InputError
from ..features.names import family
from ..features.tables import finite_values, require_unique_rows
from . import agreement_measures
from .wilcoxon import varying

# {measure: key of its cut-off in analyses.stability.cut_offs}
CUT_OFFS = {
    "w_stability_percent": "w_stability_percent",
    "icc_2_1": "icc",
    "icc_3_1": "icc",
    "ccc": "ccc",
    "cv": "cv",
    "qcd": "qcd",
}
SMALL_IS_STABLE = ("cv", "qcd")
UNVARYING = "does not vary"  # result for features whose repeats have the same value, such as shape features


def measure_table(
    table: pd.DataFrame,
    scores: pd.DataFrame | None,
    features: Sequence[str],
    cut_offs: Mapping[str, float],
    source: str = "features",
) -> pd.DataFrame:
    """Compute every measure of every feature.

    With a single group, ICC and CCC compare repeats instead of groups. With a single ROI, both are undefined.

    Parameters
    ----------
    table : DataFrame
        One row per image and ROI, with columns group, roi, seed and `features`.
    scores : DataFrame or None
        Scores of the same images, from `trust.trust_table` (with intervals) or `wilcoxon.scores`. None for a single
        group, which has no W.
    cut_offs : mapping of str to float
        w_stability_percent, icc, ccc (stable if at least), cv, qcd (stable if at most).
    source : str, optional
        Start of error messages.

    Returns
    -------
    DataFrame
        One row per feature and measure: feature, family, measure, value, ci95_low, ci95_high, cut_off, stable (yes, no,
        undefined, or "does not vary" for features that do not vary, see `wilcoxon.varying`). ICC has an interval, and W
        if `scores` has one.

    Raises
    ------
    InputError
        If a group lacks a seed of an ROI.
    """
    x = feature_array(table, features, source)
    columns = ["stability_percent", "ci95_low", "ci95_high"]
    scores = pd.DataFrame({"feature": list(features)}) if scores is None else scores
    w = scores.set_index("feature").reindex(index=list(features), columns=columns).to_numpy(dtype=np.float64).T
    if x.shape[2] < 2:
        x = x.swapaxes(2, 3)
    missing = np.full(len(features), np.nan)
    agreement = consistency = agreement_measures.Estimate(missing, missing, missing)
    concordance = missing
    if x.shape[1] > 1:
        agreement, consistency = agreement_measures.icc_agreement(x), agreement_measures.icc_consistency(x)
        concordance = agreement_measures.concordance(x)
    values = {
        "w_stability_percent": tuple(w),
        "icc_2_1": (agreement.value, agreement.low, agreement.high),
        "icc_3_1": (consistency.value, consistency.low, consistency.high),
        "ccc": (concordance, missing, missing),
        "cv": (agreement_measures.coefficient_of_variation(x), missing, missing),
        "qcd": (agreement_measures.quartile_dispersion(x), missing, missing),
    }
    varies = varying(table, features, source)
    parts = [
        pd.DataFrame(
            {
                "feature": list(features),
                "family": [family(feature) for feature in features],
                "measure": measure,
                "value": value,
                "ci95_low": low,
                "ci95_high": high,
                "cut_off": float(cut_offs[CUT_OFFS[measure]]),
                "stable": np.where(varies, _stable(measure, value, cut_offs[CUT_OFFS[measure]]), UNVARYING),
            }
        )
        for measure, (value, low, high) in values.items()
    ]
    # A stable sort keeps the order of measures within a feature.
    return pd.concat(parts).sort_values("feature", key=pd.Index(features).get_indexer, kind="stable", ignore_index=True)


def stable_by_feature(measured: pd.DataFrame) -> pd.DataFrame:
    """Return a row per feature: feature, family, stable_{measure} (see `measure_table`), stable_by (number of yes)."""
    names = measured[["feature", "family"]].drop_duplicates(ignore_index=True)
    wide = measured.pivot(index="feature", columns="measure", values="stable").reindex(columns=list(CUT_OFFS))
    wide = wide.loc[names["feature"]]
    verdicts = wide.add_prefix("stable_").reset_index(drop=True)
    return pd.concat([names, verdicts], axis=1).assign(stable_by=(wide == "yes").sum(axis=1).to_numpy())


def feature_array(table: pd.DataFrame, features: Sequence[str], source: str = "features") -> np.ndarray:
    """Return the features of a table in an array, with the checks of `measure_table`.

    Returns
    -------
    ndarray of float64, shape (features, rois, groups, seeds)
        ROIs in order of appearance.

    Raises
    ------
    InputError
        As `measure_table`.
    """
    keys = ["roi", "group", "seed"]
    levels = [table["roi"].unique(), np.sort(table["group"].unique()), np.sort(table["seed"].unique())]
    shape = tuple(map(len, levels))
    wanted = pd.MultiIndex.from_product(levels, names=keys)
    rows = pd.MultiIndex.from_frame(table[keys])
    require_unique_rows(table, source)
    if len(missing := wanted.difference(rows)):
        roi, group, seed = missing[0]
        raise InputError(
            f"{source}: no row for ROI {roi}, group {group}, seed {seed}; every group needs all ROIs and seeds"
        )
    values = finite_values(table, features, source)[rows.get_indexer(wanted)]
    return values.T.reshape(len(features), *shape)


def _stable(measure: str, value: np.ndarray, cut_off: float) -> np.ndarray:
    reached = value <= cut_off if measure in SMALL_IS_STABLE else value >= cut_off
    return np.where(np.isnan(value), "undefined", np.where(reached, "yes", "no"))
