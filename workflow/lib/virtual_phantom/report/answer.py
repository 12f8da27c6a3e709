"""Results for the first page of a study: stable features, stability by tissue, and comparisons with recordings."""

from __future__ import annotations

import pandas as pd

from ..statistics.comparison_summary import MINIMUM_ROIS, MOST, RANK_RIGHT
from ..statistics.controls import DIFFERENT_CLASSES, SAME_CLASS, WHITE_NOISE, headline
from ..statistics.stability_measures import CUT_OFFS, UNVARYING

MOST_FEATURES = 10  # features listed by name
SEVERAL = 2  # measures by which a listed feature is stable; a single one may be insensitive to the studied changes


def stability_answer(trust: pd.DataFrame, measures: pd.DataFrame | None) -> dict:
    """Summarize which features are stable.

    Parameters
    ----------
    trust : DataFrame
        From `statistics.trust.trust_table`.
    measures : DataFrame or None
        From `statistics.stability_measures.stable_by_feature`.

    Returns
    -------
    dict
        * design: numbers that all features share (a row of `trust`)
        * features: number of features
        * counts: {verdict: number of features}
        * unvarying: number of features that do not vary over repeats
        * best: rows of the most stable features
        * others: {measure other than W: number of stable features}
        * several: {feature: number of measures}, for features that are stable by SEVERAL measures, most measures first
    """
    order = trust[trust["stable"] != UNVARYING].sort_values(
        ["ci95_low", "stability_percent", "feature"], ascending=[False, False, True]
    )
    others, several = {}, {}
    if measures is not None:
        names = [name for name in CUT_OFFS if name != "w_stability_percent"]
        others = {name: int((measures[f"stable_{name}"] == "yes").sum()) for name in names}
        most = measures.sort_values(["stable_by", "feature"], ascending=[False, True])
        several = {row.feature: int(row.stable_by) for row in most.itertuples() if row.stable_by >= SEVERAL}
    return {
        "design": trust.iloc[0].to_dict(),
        "features": len(trust),
        "counts": {name: int((trust["stable"] == name).sum()) for name in ("yes", "no", "undecided")},
        "unvarying": int((trust["stable"] == UNVARYING).sum()),
        "best": order.head(MOST_FEATURES).to_dict("records"),
        "others": others,
        "several": several,
    }


def repeatability_answer(measures: pd.DataFrame) -> dict:
    """Summarize how many features repeat well, for a study of one protocol.

    Parameters
    ----------
    measures : DataFrame
        From `statistics.stability_measures.stable_by_feature`.

    Returns
    -------
    dict
        * features: number of features
        * counts: {measure other than W that is defined for a feature: number of stable features}
    """
    columns = {name: measures[f"stable_{name}"] for name in CUT_OFFS if name != "w_stability_percent"}
    defined = {name: column for name, column in columns.items() if column.isin(["yes", "no"]).any()}
    counts = {name: int((column == "yes").sum()) for name, column in defined.items()}
    return {"features": len(measures), "counts": counts}


def controls_answer(controls: pd.DataFrame) -> dict:
    """Summarize the mean scores and their controls.

    Parameters
    ----------
    controls : DataFrame
        From `statistics.controls.controls`.

    Returns
    -------
    dict
        * stability, discrimination: mean scores with their controls, in words
        * pairs: {control: pairs of ROIs in each group}
        * features, repeats: numbers of features and of values per sample
        * noise: whether there is a control with white noise
        * impossible: why pairs of one class are not compared, or None
        * discriminates: whether pairs of different classes are compared
    """
    rows = controls[controls["score"] == "discrimination"].set_index("control")
    same = rows.loc[SAME_CLASS]
    return headline(controls) | {
        "pairs": {name: int(rows.loc[name, "pairs"]) for name in (DIFFERENT_CLASSES, SAME_CLASS)},
        "features": int(same["features"]),
        "repeats": int(same["repeats"]),
        "noise": (controls["control"] == WHITE_NOISE).any(),
        "impossible": same["meaning"] if pd.isna(same["percent"]) else None,
        "discriminates": pd.notna(rows.loc[DIFFERENT_CLASSES, "percent"]),
    }


def stability_by_tissue(
    trust: pd.DataFrame, stability: pd.DataFrame | None, features: pd.DataFrame | None, compare: str
) -> dict[str, dict]:
    """Return the stability within each tissue class.

    Parameters
    ----------
    trust : DataFrame
        From `statistics.trust.trust_table`.
    stability : DataFrame or None
        From `statistics.wilcoxon.scores`.
    features : DataFrame or None
        Features of all images, with columns roi and tissue_class.
    compare : {"roi", "tissue_class"}
        What one sample of a comparison is: an ROI, or all ROIs of a tissue class.

    Returns
    -------
    dict of str to dict
        {tissue class: {comparisons: number, percent: {feature: stable share}}}. Empty for a single class, whose values
        are the pooled ones, or if a table is missing.
    """
    if stability is None or features is None:
        return {}
    groups = int(trust["groups"].iloc[0])
    pairs = groups * (groups - 1) // 2
    classes = {
        str(name): {
            "comparisons": pairs * (part["roi"].nunique() if compare == "roi" else 1),
            "percent": dict(zip(stability["feature"], stability[f"stability_{name}"], strict=True)),
        }
        for name, part in features.groupby("tissue_class", sort=False)
        if f"stability_{name}" in stability
    }
    return classes if len(classes) > 1 else {}


def agreement_text(summary: pd.DataFrame, cells: pd.DataFrame) -> str:
    """Describe the agreement of a study with a recording in sentences.

    Parameters
    ----------
    summary, cells : DataFrame
        From `statistics.comparison_summary.summary` and `statistics.comparison.compare`.
    """
    excluded, reasons = _excluded(summary, cells)
    total, summary = len(summary), summary[~excluded]
    rois, margin, factor = cells["roi"].nunique(), cells["margin_sd"].iloc[0], cells["sd_factor"].iloc[0]
    if summary.empty:
        return f"None of the {total} features can be compared.{reasons}"
    mean, sd = (summary[name].astype(bool) for name in ("mean_right", "sd_right"))
    groups = {"mean and SD": mean & sd, "mean only": mean & ~sd, "SD only": sd & ~mean, "neither": ~mean & ~sd}
    counts = ", ".join(f"{name} {int(group.sum())}" for name, group in groups.items())
    comparable = "comparable features" if excluded.any() else "features"
    text = (
        f"Agreement of the {len(summary)} {comparable}: {counts}. The mean agrees if it is within {margin:g} repeat SD "
        f"of the recorded mean. The SD agrees if the ratio of the SDs is between 1/{factor:g} and {factor:g}."
    )
    if rois > 1:
        text += f" A feature needs to agree in at least {100 * MOST:.0f} % of the {rois} ROIs."
    if rois >= MINIMUM_ROIS:
        order = int(summary["rank_right"].astype(bool).sum())
        text += f" Features with the recorded order of ROIs (Kendall's tau at least {RANK_RIGHT:g}): {order}."
    return text + reasons


def _excluded(summary: pd.DataFrame, cells: pd.DataFrame) -> tuple[pd.Series, str]:
    """Return which features cannot be compared, and sentences with their number for each reason."""
    columns = {
        "other_settings": "extracted with other settings (*)",
        "other_sizes": "they grow with the ROI, and its size differs (†)",
    }
    reasons = {text: summary[name].fillna("") != "" for name, text in columns.items() if name in summary}
    if "sd_recorded" in cells:  # without a repeat SD there is no unit for the difference of means
        constant = cells[cells["sd_recorded"] == 0].groupby("feature")["roi"].nunique()
        reasons["constant in the recording"] = summary["feature"].map(constant).eq(cells["roi"].nunique())
    text = "".join(f" Not comparable: {which.sum()} ({why})." for why, which in reasons.items() if which.any())
    excluded = pd.concat(reasons, axis=1).any(axis=1) if reasons else pd.Series(False, index=summary.index)
    return excluded, text
