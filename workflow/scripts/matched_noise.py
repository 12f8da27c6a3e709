"""Compare the variance in images of the matched noise levels with the variance in their recordings."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from virtual_phantom.base.errors import InputError
from virtual_phantom.features import tables
from virtual_phantom.features.names import VARIANCE
from virtual_phantom.io import files
from virtual_phantom.study import matched_noise
from virtual_phantom.study.job import job, log


def main(*, features_file: str, levels: Sequence[str], output: str) -> None:
    features = tables.read_features(features_file)
    if VARIANCE not in features:
        raise InputError(
            f"{features_file}: has no {VARIANCE}, which is needed to match noise levels; extract firstorder "
            "features of the original image"
        )
    rows = []
    for path in levels:
        level, name = matched_noise.read_level(path), Path(path).stem
        chosen = features[
            (features["noise"] == name)
            & (features["protocol"] == level["protocol"])
            & features["roi"].isin(level["rois"])
        ]
        repeats = chosen.groupby("seed")[VARIANCE].mean()
        rows.append(
            {
                "noise": name,
                "recording": level["recording"],
                "where": ", ".join(f"{key} {value}" for key, value in level["where"].items()),
                "protocol": level["protocol"],
                "rois": ", ".join(level["rois"]),
                "A": level["A"],
                "A_standard_error": level["A_standard_error"],
                "extrapolated": level["extrapolated"],
                "recorded_variance_hu2": level["variance_hu2"],
                "simulated_variance_hu2": repeats.mean(),
                "standard_error": repeats.std(ddof=1) / np.sqrt(len(repeats)),
                "ratio": repeats.mean() / level["variance_hu2"],
            }
        )
    table = pd.DataFrame(rows)
    files.write_csv(table, output)
    log.info("\n%s", table.to_string(index=False))


if "snakemake" in globals():
    with job(snakemake):
        main(
            features_file=snakemake.input.features,
            levels=snakemake.input.levels,
            output=snakemake.output[0],
        )
