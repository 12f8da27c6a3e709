"""Compute stability and discriminative power of the features of a recording over its conditions."""

from collections.abc import Mapping
from dataclasses import replace

from virtual_phantom.base.errors import InputError
from virtual_phantom.features import settings
from virtual_phantom.features.parameters import read_parameters
from virtual_phantom.io import files
from virtual_phantom.recordings.reading import load_recording
from virtual_phantom.recordings.reference import select_rows, stability_scores
from virtual_phantom.statistics import ranking
from virtual_phantom.statistics.repeats import mean_over_features
from virtual_phantom.study.job import job, log


def main(
    *,
    output: str,
    recording_name: str,
    folder: str,
    conditions: Mapping,
    repeats: int,
    statistics: Mapping,
    extraction: Mapping,
) -> None:
    parameters = read_parameters(**extraction)
    recording = load_recording(folder, parameters.features)
    if recording.kind != "features":
        raise InputError(
            f"recording {recording_name}: holds {recording.kind}; analyses.stability.recordings takes "
            "recordings of features only"
        )
    for line in settings.describe_differences(parameters.extraction, recording.extractions, recording.features):
        log.warning("setting: %s", line)
    name = f"recording {recording.name}"
    recording = replace(recording, repeats=select_rows(recording.repeats, conditions, name))
    table = stability_scores(recording, repeats, **statistics)
    files.write_csv(table, output)
    for kind in ranking.KINDS:
        log.info(
            "%s at %d repeats: mean %.1f %%, SD %.1f %%",
            kind,
            table["repeats"].iloc[0],
            *mean_over_features(table, kind),
        )


if "snakemake" in globals():
    with job(snakemake):
        main(
            output=snakemake.output[0],
            recording_name=snakemake.wildcards.recording,
            folder=snakemake.params.folder,
            conditions=snakemake.params.where,
            repeats=snakemake.params.repeats,
            statistics=snakemake.params.statistics,
            extraction=snakemake.params.parameters,
        )
