"""Result of the comparison of extraction settings, for the first page of a study."""

from __future__ import annotations

import pandas as pd

from ..features.variations import OWN

MOST_FEATURES = 10  # features listed by name


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
