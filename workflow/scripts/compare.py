"""Features of one protocol and noise level against those of a recording."""

from virtual_phantom.features import tables
from virtual_phantom.io import files
from virtual_phantom.recordings.reference import where
from virtual_phantom.statistics import comparison
from virtual_phantom.study.job import job

with job(snakemake) as log:
    params = snakemake.params
    simulated = tables.read(snakemake.input.features)
    simulated = tables.select(simulated, protocols=[params.protocol], noise=[params.noise], seeds=params.seeds)
    recorded = where(files.read_csv(snakemake.input.recorded), params.where, f"recording {params.recording}")
    features = comparison.common_features(simulated, recorded)
    cells = comparison.compare(simulated, recorded, features, rois=params.rois, margin_sd=params.margin_sd)
    files.write_csv(cells, snakemake.output.cells)
    summary = comparison.summary(cells)
    files.write_csv(summary, snakemake.output.features)
    families = comparison.family_summary(cells)
    files.write_csv(families, snakemake.output.families)
    log.info("\n%s", families.to_string(index=False))
