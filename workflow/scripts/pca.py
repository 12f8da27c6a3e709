"""Principal components of simulated and measured features, and how well tissue classes separate."""

from pathlib import Path

import pandas as pd

from virtual_phantom.features import settings, tables
from virtual_phantom.features.stored import to_hu
from virtual_phantom.io import files
from virtual_phantom.recordings.reference import reference_features
from virtual_phantom.statistics import measured, pca
from virtual_phantom.study.job import job

with job(snakemake) as log:
    params, output = snakemake.params, snakemake.output
    study = settings.of_parameters(params.parameters["path"])
    features = tables.read(str(snakemake.input.features))
    simulated = tables.select(features, **params.selection)
    if params.recordings:
        parts = []
        for path, name in zip(snakemake.input.measured, params.recordings, strict=True):
            table = files.read_csv(path)
            for line in settings.said(study, settings.distinct(settings.of_table(table, path))):
                log.warning("recording %s: setting: %s", name, line)
            conditions = params.by or params.conditions[name]
            parts.append(reference_features(table, conditions, "condition", named=bool(params.by)))
        shown = pd.concat(parts, join="inner", ignore_index=True)
    elif not params.measured["overlay"]:
        shown = None
    elif params.measured["table"] is None:
        shown = measured.group_means()
    else:
        shown = to_hu(measured.load_full_table(params.measured["table"]))
    points = pca.project(simulated, shown, **params.pca)
    separability = pca.separability(points, Path(output.table).stem)
    files.write_csv(points, output.table)
    files.write_csv(separability, output.separability)
    log.info("\n%s", separability.to_string(index=False))
