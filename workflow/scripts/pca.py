"""Principal components of simulated and measured features, and how well tissue classes separate."""

from pathlib import Path

from virtual_phantom import feature_table, files, measured
from virtual_phantom.job import job
from virtual_phantom.statistics import pca

with job(snakemake) as log:
    params, output = snakemake.params, snakemake.output
    features = feature_table.read(str(snakemake.input.features))
    simulated = feature_table.select(features, **params.selection)
    if not params.measured["overlay"]:
        reference = None
    elif params.measured["table"] is None:
        reference = measured.group_means()
    else:
        reference = measured.to_hu(measured.load_full_table(params.measured["table"]))
    points = pca.project(simulated, reference, **params.pca)
    separability = pca.separability(points, Path(output.table).stem)
    files.write_csv(points, output.table)
    files.write_csv(separability, output.separability)
    log.info("\n%s", separability.to_string(index=False))
