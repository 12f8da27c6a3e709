"""Write this folder's summaries of the measured feature tables. Run by hand when a source table changes:

    PYTHONPATH=workflow/lib python resources/summarise_measurements.py STUDY_TABLE DOSE_TABLE

STUDY_TABLE   features of CT-Phantom4Radiomics (`features_2d.csv`)
DOSE_TABLE    features of the dose series on the SOMATOM Definition Edge (`features_3d.csv`)
Sources, licences and what each written file holds: README.md beside this script.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import pandas as pd

from virtual_phantom import measured
from virtual_phantom.files import replacing
from virtual_phantom.radiomics import FEATURES
from virtual_phantom.statistics import wilcoxon

HERE = Path(__file__).resolve().parent


def summarise(table: pd.DataFrame, keys: list[str], features: tuple[str, ...]) -> pd.DataFrame:
    """Mean, SD (n - 1) and number of rows per combination of keys and feature, as a long table."""
    long = table.melt(id_vars=keys, value_vars=list(features), var_name="feature")
    return (
        long.groupby([*keys, "feature"], sort=True)["value"]
        .agg(["mean", "std", "count"])
        .reset_index()
        .rename(columns={"std": "sd", "count": "n"})
    )


def write(table: pd.DataFrame, name: str) -> None:
    """Eight significant digits: far below the spread over scans, and half the size."""
    with replacing(HERE / name) as temporary:
        table.to_csv(temporary, index=False, lineterminator="\n", float_format="%.8g")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study_table", type=Path)
    parser.add_argument("dose_table", type=Path)
    arguments = parser.parse_args()
    study = measured.load_full_table(arguments.study_table)
    write(
        summarise(measured.to_hu(study), ["group", "roi"], measured.STUDY_FEATURES),
        "ct_phantom4radiomics_groups.csv",
    )
    scores = wilcoxon.scores(study, measured.STUDY_FEATURES, source=str(arguments.study_table))
    write(scores[["feature", "stability_percent", "discrimination_percent"]], "ct_phantom4radiomics_scores.csv")
    write(
        summarise(
            measured.load_full_dose_series(arguments.dose_table), ["dose_mgy", "reconstruction", "roi"], FEATURES
        ),
        "edge_dose_series_summary.csv",
    )


if __name__ == "__main__":
    main()
