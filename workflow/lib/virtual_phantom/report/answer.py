"""Results for the first page of a study: robust features, controls, extraction settings, and comparisons."""

from __future__ import annotations

import pandas as pd

from ..features.variations import OWN
from ..statistics import EXTRACTION, REPEATS
from ..statistics.comparison_summary import MINIMUM_ROIS, MOST, RANK_RIGHT
from ..statistics.controls import DIFFERENT_CLASSES, SAME_CLASS, WHITE_NOISE, headline
from ..statistics.robustness import (
    AVOID,
    ONE_PROTOCOL,
    ROBUST,
    SIZE,
    UNDECIDED,
    USES,
    acquisition_changes,
    between_protocols,
)
from ..statistics.stability_measures import UNVARYING

TITLES = {
    ROBUST: "Robust for every change",
    ONE_PROTOCOL: "Use within one protocol only",
    UNDECIDED: "Undecided: study more regions",
    AVOID: "Avoid: not robust for some change",
    SIZE: "Grow with the size of the region, not counted",
    UNVARYING: "Do not vary between the images, not counted",
}
MOST_FEATURES = 10  # features listed by name for extraction settings


def robustness_answer(trust: pd.DataFrame) -> dict:
    """Summarize which features are robust for which changes.

    Parameters
    ----------
    trust : DataFrame
        From `statistics.robustness.robustness_table`.

    Returns
    -------
    dict
        * changes: kinds of change that count for `use`
        * extraction: whether there are rows of extraction settings, which do not count
        * considered: number of features that vary and do not grow with the size of the region
        * uses: {use: [(feature, reason)]}, most robust first
        * robust_for: {change: considered features that are robust for it, most robust first}, without random repeats
        * repeats: control, number of considered features that are robust for random repeats; None if not studied
        * exchanged: control, largest mean percentage over features of exchanges of regions that reach the cut-off
        * cut_off, rois: of the ICC, and number of regions
        * stable: number of features that are stable between protocols by W, for a single region; None for one protocol
    """
    extraction = EXTRACTION in set(trust["change"])
    trust = acquisition_changes(trust)
    features = trust.drop_duplicates("feature")
    lowest = features["feature"].map(trust.groupby("feature")["icc"].min())
    features = features.assign(lowest=lowest).sort_values("lowest", ascending=False, kind="stable")
    uses = {use: features[features["use"] == use] for use in USES}
    considered = trust[~trust["use"].isin([SIZE, UNVARYING])]
    between = between_protocols(considered)
    repeats = considered.loc[considered["change"] == REPEATS, "robust"]
    robust = considered[considered["robust"] == "yes"].sort_values("icc_low", ascending=False, kind="stable")
    return {
        "changes": list(dict.fromkeys(trust["change"])),
        "extraction": extraction,
        "considered": considered["feature"].nunique(),
        "uses": {
            use: list(zip(rows["feature"], rows["reason"], strict=True)) for use, rows in uses.items() if len(rows)
        },
        "robust_for": {
            change: list(robust.loc[robust["change"] == change, "feature"])
            for change in dict.fromkeys(trust["change"])
            if change != REPEATS
        },
        "repeats": int((repeats == "yes").sum()) if len(repeats) else None,
        "exchanged": considered.groupby("change")["exchanged_percent"].mean().max(),
        "cut_off": float(trust["icc_cut_off"].iloc[0]),
        "rois": int(trust["rois"].iloc[0]),
        "stable": int((between["stable"] == "yes").sum()) if len(between) else None,
    }


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


def extraction_answer(settings: pd.DataFrame, choice: pd.DataFrame) -> dict:
    """Summarize which extraction setting makes features most robust, and what it costs.

    Parameters
    ----------
    settings, choice : DataFrame
        From `statistics.extraction_settings.settings_table` and `choice_table`.

    Returns
    -------
    dict
        * robust_by: measure of robustness; rois, conditions, repeats: sample sizes
        * discriminates: whether discriminative power is known
        * settings: a row for each setting, the study's first: setting, best (features that it makes most robust),
          more, less (features whose robustness it changes with an interval above or below zero), robustness (median),
          discrimination (mean)
        * features: rows of `choice` with an interval above zero, largest change first
    """
    rows = []
    for name, part in settings.groupby("setting", sort=False):
        rows.append(
            {
                "setting": name,
                "best": int((part["most_robust"] == "yes").sum()),
                "more": int((part["change_z_low"] > 0).sum()),
                "less": int((part["change_z_high"] < 0).sum()),
                "robustness": part["robustness"].median(),
                "discrimination": part["discrimination_percent"].mean(),
            }
        )
    rows.sort(key=lambda row: row["setting"] != OWN)
    certain = choice[choice["more_robust"] == "yes"].sort_values("change", ascending=False)
    return {
        **settings.iloc[0][["robust_by", "rois", "conditions", "repeats"]].to_dict(),
        "intervals": bool(settings["change_z_low"].notna().any()),
        "discriminates": bool(settings["discrimination_percent"].notna().any()),
        "settings": rows,
        "certain": len(certain),
        "features": certain.head(MOST_FEATURES).to_dict("records"),
    }


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
