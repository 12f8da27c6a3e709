"""Compute principal components of simulated and measured features, and the separability of tissue classes."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from virtual_phantom.features import settings, tables
from virtual_phantom.features.hu_offset import convert_to_hu
from virtual_phantom.io import files
from virtual_phantom.recordings.reference import reference_features
from virtual_phantom.statistics import measured, pca
from virtual_phantom.study.job import job, log


def main(
    *,
    features_file: str,
    reference_files: Sequence[str],
    table_file: str,
    separability_file: str,
    selection: Mapping,
    fitted: Mapping,
    measured_settings: Mapping,
    recordings: Sequence[str],
    by: Sequence[str],
    conditions_of: Mapping[str, Sequence[str]],
    extraction: Mapping,
) -> None:
    study = settings.read_extraction(extraction["path"])
    features = tables.read_features(features_file)
    simulated = tables.select(features, **selection)
    if recordings:
        parts = []
        for path, name in zip(reference_files, recordings, strict=True):
            table = files.read_csv(path)
            for line in settings.describe_differences(
                study, settings.distinct_extractions(settings.read_extractions(table, path))
            ):
                log.warning("recording %s: setting: %s", name, line)
            conditions = by or conditions_of[name]
            parts.append(reference_features(table, conditions, named=bool(by)))
        shown = pd.concat(parts, join="inner", ignore_index=True)
    elif not measured_settings["overlay"]:
        shown = None
    elif measured_settings["table"] is None:
        shown = measured.group_means()
    else:
        shown = convert_to_hu(measured.load_full_table(measured_settings["table"]))
    points = pca.project(simulated, shown, **fitted)
    separability = pca.separability(points, Path(table_file).stem)
    files.write_csv(points, table_file)
    files.write_csv(separability, separability_file)
    log.info("\n%s", separability.to_string(index=False))


if "snakemake" in globals():
    with job(snakemake):
        main(
            features_file=snakemake.input.features,
            reference_files=snakemake.input.measured,
            table_file=snakemake.output.table,
            separability_file=snakemake.output.separability,
            selection=snakemake.params.selection,
            fitted=snakemake.params.pca,
            measured_settings=snakemake.params.measured,
            recordings=snakemake.params.recordings,
            by=snakemake.params.by,
            conditions_of=snakemake.params.conditions,
            extraction=snakemake.params.parameters,
        )
