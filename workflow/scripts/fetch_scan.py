"""Fetch one public scan and check it against the list of files."""

from virtual_phantom.recordings.public_scans.fetch import fetch_scan
from virtual_phantom.recordings.public_scans.table import PublicScan
from virtual_phantom.study.job import job, log


def main(
    *,
    folder: str,
    scan: PublicScan,
    listed: str,
    endpoint: str,
    bucket: str,
) -> None:
    fetch_scan(scan, folder, endpoint, bucket)
    log.info("%s", listed)


if "snakemake" in globals():
    with job(snakemake):
        main(
            folder=snakemake.output[0],
            scan=snakemake.params.scan,
            listed=snakemake.params.listed,
            endpoint=snakemake.params.endpoint,
            bucket=snakemake.params.bucket,
        )
