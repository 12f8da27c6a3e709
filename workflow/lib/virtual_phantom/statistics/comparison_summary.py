"""Summarize a comparison of simulated and recorded features: rank order, shares of ROIs, verdicts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import scipy

from ..base.errors import InputError
from ..base.names import enumerated
from ..features.names import EVERY_FAMILY, family
from .comparison import ALPHA, ROUNDING

MINIMUM_ROIS = 3  # two ROIs are in the right order with probability one half
# Kendall's tau of six ROIs with 2 of 15 pairs swapped is 0.73; random orders reach it in 2.8 % of cases.
RANK_RIGHT = 0.7
MOST = 0.8  # share of ROIs within the margin: one of six may be outside


def ranks(table: pd.DataFrame) -> pd.DataFrame:
    """Compare the order of ROIs by each simulated feature with the recorded order.

    Parameters
    ----------
    table : DataFrame
        From `compare`.

    Returns
    -------
    DataFrame
        One row per feature: feature, family, rois, kendall_tau (tau-b), kendall_p (two-sided, exact without ties),
        spearman, computed from means over repeats. All pairs of ROIs count equally, including pairs that the recording
        hardly distinguishes. Missing if the means of either table are equal in all ROIs.

    Raises
    ------
    InputError
        For fewer than three ROIs.
    """
    if (count := table["roi"].nunique()) < MINIMUM_ROIS:
        raise InputError(f"comparison: {count} ROIs; an order of ROIs needs at least {MINIMUM_ROIS}")
    rows = []
    for feature, part in table.groupby("feature", sort=False):
        pair = part["mean_simulated"].to_numpy(), part["mean_recorded"].to_numpy()
        row = {"feature": feature, "family": family(feature), "rois": len(part)}
        if any(np.ptp(means) <= ROUNDING * np.abs(means).max() for means in pair):
            rows.append(row | {"kendall_tau": np.nan, "kendall_p": np.nan, "spearman": np.nan})
            continue
        tau = scipy.stats.kendalltau(*pair)
        rows.append(
            row
            | {
                "kendall_tau": float(tau.statistic),
                "kendall_p": float(tau.pvalue),
                "spearman": float(scipy.stats.spearmanr(*pair).statistic),
            }
        )
    return pd.DataFrame(rows)


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Summarize `compare` for each feature over its ROIs.

    The verdict uses point estimates. The columns share_equivalent and share_sd_equivalent give the shares for which
    equivalence was shown.

    Parameters
    ----------
    table : DataFrame
        From `compare`.

    Returns
    -------
    DataFrame
        One row per feature, with shares of its ROIs:

        * feature, family, rois, median_abs_shift_sd, median_sd_ratio
        * share_within_margin, share_sd_within: within the margin, whether or not that is certain
        * share_equivalent, share_sd_equivalent: shown to be within the margin
        * share_mean_differs, share_sd_differs: q under 0.05
        * kendall_tau, spearman: missing for fewer than three ROIs
        * mean_right, sd_right: at least MOST of the ROIs are within the margin
        * rank_right: tau of at least RANK_RIGHT
        * verdict: "mean, SD and rank right" to "none right"
    """
    cells = _cells(table)
    result = _shares(cells.groupby(["feature", "family"], sort=False)).reset_index()
    result.insert(2, "rois", cells.groupby("feature", sort=False)["roi"].nunique().to_numpy())
    if table["roi"].nunique() >= MINIMUM_ROIS:
        order = ranks(table).set_index("feature")[["kendall_tau", "spearman"]]
        result = result.join(order, on="feature")
    else:
        result = result.assign(kendall_tau=np.nan, spearman=np.nan)
    result["mean_right"] = result["share_within_margin"] >= MOST
    result["sd_right"] = result["share_sd_within"] >= MOST
    result["rank_right"] = result["kendall_tau"] >= RANK_RIGHT
    right = result[["mean_right", "sd_right", "rank_right"]].to_numpy()
    result["verdict"] = [_verdict(row) for row in right]
    return result


def family_summary(table: pd.DataFrame) -> pd.DataFrame:
    """Summarize `compare` for each family and, in the last row, for all features.

    Medians and shares are over all features and ROIs of the family.

    Parameters
    ----------
    table : DataFrame
        From `compare`.

    Returns
    -------
    DataFrame
        One row per family: family, features, the columns of `summary` from median_abs_shift_sd to share_sd_differs,
        median_kendall_tau, and of its features share_mean_right, share_sd_right, share_rank_right and share_all_right.
    """
    cells, each = _cells(table), summary(table)
    rows = []
    for name in (*EVERY_FAMILY.values(), "all"):
        part = cells if name == "all" else cells[cells["family"] == name]
        own = each if name == "all" else each[each["family"] == name]
        if own.empty:
            continue
        right = own[["mean_right", "sd_right", "rank_right"]]
        rows.append(
            {"family": name, "features": len(own)}
            | _shares(part.assign(all=0).groupby("all")).iloc[0].to_dict()
            | {"median_kendall_tau": own["kendall_tau"].median()}
            | {f"share_{column}": right[column].mean() for column in right}
            | {"share_all_right": right.all(axis=1).mean()}
        )
    return pd.DataFrame(rows)


def _cells(table: pd.DataFrame) -> pd.DataFrame:
    """Return one row per ROI and feature with the quantities that are counted. Two constants have a ratio of 1."""
    ratio = table["sd_ratio"].where((table["sd_simulated"] > 0) | (table["sd_recorded"] > 0), 1.0)
    shift = table["shift_sd"].abs()
    return pd.DataFrame(
        {
            "feature": table["feature"],
            "family": table["family"],
            "roi": table["roi"],
            "shift": shift,
            "within": shift <= table["margin_sd"],
            "equivalent": table["mean_equivalent"],
            "differs": table["q_mean"] < ALPHA,
            "ratio": ratio,
            "sd_within": ratio.between(1 / table["sd_factor"], table["sd_factor"]),
            "sd_equivalent": table["sd_equivalent"],
            "sd_differs": table["q_sd"] < ALPHA,
        }
    )


def _shares(groups) -> pd.DataFrame:
    return groups.agg(
        median_abs_shift_sd=("shift", "median"),
        share_within_margin=("within", "mean"),
        share_equivalent=("equivalent", "mean"),
        share_mean_differs=("differs", "mean"),
        median_sd_ratio=("ratio", "median"),
        share_sd_within=("sd_within", "mean"),
        share_sd_equivalent=("sd_equivalent", "mean"),
        share_sd_differs=("sd_differs", "mean"),
    )


def _verdict(right: Sequence[bool]) -> str:
    names = [name for name, good in zip(("mean", "SD", "rank"), right, strict=True) if good]
    return f"{enumerated(names) or 'none'} right"
