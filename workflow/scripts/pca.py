"""Principal components of simulated and measured features, and how well tissue classes separate."""

from pathlib import Path

import pandas as pd

from virtual_phantom import feature_table, files, measured
from virtual_phantom.job import job
from virtual_phantom.recordings.reference import reference
from virtual_phantom.statistics import pca

with job(snakemake) as log:
    params, output = snakemake.params, snakemake.output
    features = feature_table.read(str(snakemake.input.features))
    simulated = feature_table.select(features, **params.selection)
    if params.recordings:
        tables = zip(snakemake.input.measured, params.recordings, strict=True)
        parts = [reference(files.read_csv(path), params.conditions[name], "condition") for path, name in tables]
        shown = pd.concat(parts, join="inner", ignore_index=True)
    elif not params.measured["overlay"]:
        shown = None
    elif params.measured["table"] is None:
        shown = measured.group_means()
    else:
        shown = measured.to_hu(measured.load_full_table(params.measured["table"]))
    points = pca.project(simulated, shown, **params.pca)
    separability = pca.separability(points, Path(output.table).stem)
    files.write_csv(points, output.table)
    files.write_csv(separability, output.separability)
    log.info("\n%s", separability.to_string(index=False))
