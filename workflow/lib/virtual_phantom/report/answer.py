"""What the first page of a study answers: which features are stable, in which tissue, and what a comparison found."""

from __future__ import annotations

import pandas as pd

from ..statistics.comparison_summary import MINIMUM_ROIS, MOST, RANK_RIGHT
from ..statistics.stability_measures import CUT_OFFS

MOST_FEATURES = 10  # that are named
SEVERAL = 2  # measures that a feature is stable by to be named: one alone may forgive just what a study is about


def answer(trust: pd.DataFrame, measures: pd.DataFrame | None) -> dict:
    """Which features to trust.

    Parameters
    ----------
    trust : DataFrame
        Of `statistics.trust.table`.
    measures : DataFrame or None
        Of `statistics.stability_measures.by_feature`: beside W.

    Returns
    -------
    dict
        rests_on (a row, for the numbers that all share), features (how many), counts (of each verdict), best (rows of
        the most stable ones), others (a measure beside W: how many features are stable by it), several (features that
        are stable by SEVERAL measures or more: by how many, the most first).
    """
    order = trust.sort_values(["ci95_low", "stability_percent", "feature"], ascending=[False, False, True])
    others, several = {}, {}
    if measures is not None:
        names = [name for name in CUT_OFFS if name != "w_stability_percent"]
        others = {name: int((measures[f"stable_{name}"] == "yes").sum()) for name in names}
        most = measures.sort_values(["stable_by", "feature"], ascending=[False, True])
        several = {row.feature: int(row.stable_by) for row in most.itertuples() if row.stable_by >= SEVERAL}
    return {
        "rests_on": trust.iloc[0].to_dict(),
        "features": len(trust),
        "counts": {name: int((trust["stable"] == name).sum()) for name in ("yes", "no", "undecided")},
        "best": order.head(MOST_FEATURES).to_dict("records"),
        "others": others,
        "several": several,
    }


def tissues(
    trust: pd.DataFrame, stability: pd.DataFrame | None, features: pd.DataFrame | None, compare: str
) -> dict[str, dict]:
    """The stability within each tissue class.

    Parameters
    ----------
    trust : DataFrame
        Of `statistics.trust.table`.
    stability : DataFrame or None
        Of `statistics.wilcoxon.scores`.
    features : DataFrame or None
        Of all images, with columns roi and tissue_class.
    compare : {"roi", "tissue_class"}
        What a sample is.

    Returns
    -------
    dict of str to dict
        {tissue class: comparisons (how many it rests on), percent ({feature: of them that agree})}. Empty without both
        tables, and for one class, of which the pooled stability says it all.
    """
    if stability is None or features is None:
        return {}
    groups = int(trust["groups"].iloc[0])
    pairs = groups * (groups - 1) // 2
    found = {
        str(name): {
            "comparisons": pairs * (part["roi"].nunique() if compare == "roi" else 1),
            "percent": dict(zip(stability["feature"], stability[f"stability_{name}"], strict=True)),
        }
        for name, part in features.groupby("tissue_class", sort=False)
        if f"stability_{name}" in stability
    }
    return found if len(found) > 1 else {}


def agreement(summary: pd.DataFrame, cells: pd.DataFrame) -> str:
    """What a comparison with a recording found, and what it means to agree, in sentences.

    Parameters
    ----------
    summary, cells : DataFrame
        Of `statistics.comparison_summary.summary` and `compare`.
    """
    barred, why = _barred(summary, cells)
    every, summary = len(summary), summary[~barred]
    rois, margin, factor = cells["roi"].nunique(), cells["margin_sd"].iloc[0], cells["sd_factor"].iloc[0]
    if summary.empty:
        return f"None of {every} features can be compared.{why}"
    mean, sd = (summary[name].astype(bool) for name in ("mean_right", "sd_right"))
    counts = {"mean and SD": mean & sd, "the mean only": mean & ~sd, "the SD only": sd & ~mean}
    parts = [f"{int(which.sum())} in {words}" for words, which in counts.items() if which.any()]
    neither = int((~mean & ~sd).sum())
    found = " none agrees in mean or SD"
    if parts:
        found = ", " + ", ".join(parts + [f"{neither} in neither"] * bool(neither)).replace(" in", " agree in", 1)
    where = f", each in at least {100 * MOST:.0f} % of the {rois} ROIs" if rois > 1 else ""
    which = " that can be compared" if barred.any() else ""
    text = (
        f"Of {len(summary)} features{which}{found}. A mean agrees where it lies within {margin:g} repeat SD of the "
        f"recorded one, an SD where it is from 1/{factor:g} to {factor:g} times the recorded one{where}."
    )
    if rois >= MINIMUM_ROIS:
        order = int(summary["rank_right"].astype(bool).sum())
        text += (
            f" {order} {'puts' if order == 1 else 'put'} the ROIs in the recorded order (Kendall's tau at least "
            f"{RANK_RIGHT:g})."
        )
    return text + why


def _barred(summary: pd.DataFrame, cells: pd.DataFrame) -> tuple[pd.Series, str]:
    """Which features must not be compared, and how many they are by reason, in sentences."""
    none = pd.Series(False, index=summary.index)
    reasons = {
        "were extracted with other settings (*)": _said(summary, "other_settings", none),
        "grow with the ROI, whose voxels are others here (†)": _said(summary, "other_sizes", none),
    }
    if "sd_recorded" in cells:  # without a repeat SD no mean is near or far
        still = cells[cells["sd_recorded"] == 0].groupby("feature")["roi"].nunique()
        reasons["are the same in all that was recorded"] = summary["feature"].map(still).eq(cells["roi"].nunique())
    text = "".join(
        f" {which.sum()} cannot be compared, as they {why}." for why, which in reasons.items() if which.any()
    )
    return pd.concat(reasons, axis=1).any(axis=1), text


def _said(summary: pd.DataFrame, column: str, none: pd.Series) -> pd.Series:
    return summary[column].fillna("") != "" if column in summary else none
