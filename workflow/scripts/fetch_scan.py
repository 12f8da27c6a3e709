"""One public scan, fetched and held against the list."""

from virtual_phantom.recordings.public_scans.fetch import fetch_scan
from virtual_phantom.study.job import job

with job(snakemake) as log:
    params = snakemake.params
    fetch_scan(params.scan, snakemake.output[0], params.endpoint, params.bucket)
    log.info("%s", params.listed)
