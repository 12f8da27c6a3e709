"""Features of one public scan, a row per ROI: of volumes in HU, and of largest sections in stored values."""

from pathlib import Path

from virtual_phantom.features.parameters import read_parameters
from virtual_phantom.io import files
from virtual_phantom.recordings.public_scans.features import scan_features
from virtual_phantom.recordings.public_scans.fetch import check_scan
from virtual_phantom.study.job import job

with job(snakemake) as log:
    params, folder = snakemake.params, Path(snakemake.input.scan)
    check_scan(params.scan, folder, sizes=False)
    tables = scan_features(params.scan, folder, params.rois, params.regions, read_parameters(**params.parameters))
    for table, path in zip(tables.values(), snakemake.output, strict=True):
        files.write_csv(table, path)
    log.info("%s: %d ROIs", params.scan.name, len(table))
