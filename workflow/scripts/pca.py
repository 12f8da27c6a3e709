"""Compute principal components of simulated and measured features, and the separability of tissue classes."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from virtual_phantom.base.settings import from_mapping
from virtual_phantom.config.settings import Components
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
    components: Components,
    seeds: int,
    measured_settings: Mapping,
    conditions_of: Mapping[str, Sequence[str]],
    extraction: Mapping,
) -> None:
    study = settings.read_extraction(extraction["path"])
    features = tables.read_features(features_file)
    simulated = tables.select(features, protocols=components.protocols, noise=components.noise, seeds=seeds)
    if components.recordings:
        parts = []
        for path, name in zip(reference_files, components.recordings, strict=True):
            table = files.read_csv(path)
            for line in settings.describe_differences(
                study, settings.distinct_extractions(settings.read_extractions(table, path))
            ):
                log.warning("recording %s: setting: %s", name, line)
            conditions = components.by or conditions_of[name]
            parts.append(reference_features(table, conditions, named=bool(components.by)))
        shown = pd.concat(parts, join="inner", ignore_index=True)
    elif not measured_settings["overlay"]:
        shown = None
    elif measured_settings["table"] is None:
        shown = measured.group_means()
    else:
        shown = convert_to_hu(measured.load_full_table(measured_settings["table"]))
    points = pca.project(simulated, shown, fit_on=components.fit_on, standardise=components.standardise)
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
            components=from_mapping(Components, snakemake.params.settings),
            seeds=snakemake.params.seeds,
            measured_settings=snakemake.params.measured,
            conditions_of=snakemake.params.conditions,
            extraction=snakemake.params.parameters,
        )
