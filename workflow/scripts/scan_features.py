"""Features of one public scan, a row per ROI."""

from pathlib import Path

from virtual_phantom.features.parameters import read_parameters
from virtual_phantom.io import files
from virtual_phantom.recordings.public_scans.features import rows_of
from virtual_phantom.recordings.public_scans.fetch import check
from virtual_phantom.study.job import job

with job(snakemake) as log:
    params, folder = snakemake.params, Path(snakemake.input.scan)
    check(params.scan, folder, sizes=False)
    table = rows_of(params.scan, folder, params.rois, params.regions, read_parameters(params.parameters))
    files.write_csv(table, snakemake.output[0])
    log.info("%s: %d ROIs", params.scan.name, len(table))
