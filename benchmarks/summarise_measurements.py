"""Write the library's summaries of the measured feature tables; run it if a source table changes (minutes).

STUDY_TABLE has the features of CT-Phantom4Radiomics (features_2d.csv), DOSE_TABLE those of the dose series on the
SOMATOM Definition Edge (features_3d.csv). The README of the library's resources has sources, licenses and contents.
"""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from virtual_phantom.base.data import RESOURCES
from virtual_phantom.features.extraction import FEATURES
from virtual_phantom.features.hu_offset import convert_to_hu
from virtual_phantom.io.files import replacing
from virtual_phantom.statistics import measured, repeats, wilcoxon

NUMBERS = range(2, 20)  # of repeats; 19 acquisitions of each group are without re-positioning


def summarise(table: pd.DataFrame, keys: list[str], features: tuple[str, ...]) -> pd.DataFrame:
    """Mean, SD (n - 1) and number of rows per combination of keys and feature, as a long table."""
    long = table.melt(id_vars=keys, value_vars=list(features), var_name="feature")
    return (
        long.groupby([*keys, "feature"], sort=True)["value"]
        .agg(["mean", "std", "count"])
        .reset_index()
        .rename(columns={"std": "sd", "count": "n"})
    )


def draw_scores(study: pd.DataFrame) -> pd.DataFrame:
    """Scores from equal repeats as counts of comparisons: a row per draw and kind, a column per feature.

    All groups take the same acquisitions, as the study did.
    """
    rows = []
    for acquisitions in measured.ACQUISITIONS:
        table = study if acquisitions == "all" else study[study["repositioned"] == 0]
        for number in NUMBERS:
            scores = repeats.score_draws(
                table, measured.PHANTOM4RADIOMICS_FEATURES, number, unit="acquisition", shared=True
            )
            for kind in ("stability", "discrimination"):
                comparisons = scores[f"{kind}_comparisons"].iloc[0]
                counts = (scores[f"{kind}_percent"] * comparisons / 100).round().astype(int)
                keys = scores[["repeats", "of", "draw"]].assign(kind=kind, comparisons=comparisons)
                wide = keys.assign(feature=scores["feature"], count=counts).pivot(
                    index=list(keys.columns), columns="feature", values="count"
                )
                wide = wide[list(measured.PHANTOM4RADIOMICS_FEATURES)].reset_index()
                wide.insert(0, "acquisitions", acquisitions)
                rows.append(wide)
    return pd.concat(rows, ignore_index=True)


def write(table: pd.DataFrame, name: str) -> None:
    """Write a table with eight significant digits, far below the spread over scans."""
    with replacing(RESOURCES / name) as temporary:
        table.to_csv(temporary, index=False, lineterminator="\n", float_format="%.8g")


def add_arguments(parser):
    parser.add_argument("study_table", type=Path)
    parser.add_argument("dose_table", type=Path)


def run(options):
    study = measured.load_full_table(options.study_table)
    write(
        summarise(convert_to_hu(study), ["group", "roi"], measured.PHANTOM4RADIOMICS_FEATURES),
        "ct_phantom4radiomics_groups.csv",
    )
    scores = wilcoxon.scores(study, measured.PHANTOM4RADIOMICS_FEATURES, source=str(options.study_table))
    write(scores[["feature", "stability_percent", "discrimination_percent"]], "ct_phantom4radiomics_scores.csv")
    write(draw_scores(study), "ct_phantom4radiomics_draws.csv")
    write(
        summarise(measured.load_full_dose_series(options.dose_table), ["dose_mgy", "reconstruction", "roi"], FEATURES),
        "edge_dose_series_summary.csv",
    )
