"""Scans that lie in a folder of somebody's own, told by their tags, as links."""

from virtual_phantom.recordings.public_scans.fetch import link_scan
from virtual_phantom.recordings.public_scans.files import find_scans
from virtual_phantom.study.job import job

with job(snakemake) as log:
    scans = snakemake.params.scans
    found = find_scans(snakemake.params.folder, scans)
    for scan, folder in zip(scans, snakemake.output, strict=True):
        link_scan(scan, found[scan.name], folder)
        log.info("%s: %d files in %s", scan.name, scan.files, snakemake.params.folder)
