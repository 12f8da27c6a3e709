"""Stability and discriminative power of the features of a recording, over its conditions."""

from dataclasses import replace

from virtual_phantom.base.errors import InputError
from virtual_phantom.features import settings
from virtual_phantom.features.parameters import read_parameters
from virtual_phantom.io import files
from virtual_phantom.recordings.reading import load_recording
from virtual_phantom.recordings.reference import select_rows, stability_scores
from virtual_phantom.statistics import ranking
from virtual_phantom.statistics.repeats import over_features
from virtual_phantom.study.job import job

with job(snakemake) as log:
    parameters = read_parameters(**snakemake.params.parameters)
    recording = load_recording(snakemake.params.folder, parameters.features)
    if recording.kind != "features":
        raise InputError(
            f"recording {snakemake.wildcards.recording}: holds {recording.kind}; analyses.stability.recordings takes "
            "recordings of features only"
        )
    for line in settings.said(parameters.extraction, recording.extractions, recording.features):
        log.warning("setting: %s", line)
    name = f"recording {recording.name}"
    recording = replace(recording, repeats=select_rows(recording.repeats, snakemake.params.where, name))
    table = stability_scores(recording, snakemake.params.repeats, **snakemake.params.statistics)
    files.write_csv(table, snakemake.output[0])
    for kind in ranking.KINDS:
        log.info(
            "%s at %d repeats: mean %.1f %%, SD %.1f %%", kind, table["repeats"].iloc[0], *over_features(table, kind)
        )
