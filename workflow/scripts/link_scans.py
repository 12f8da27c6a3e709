"""Link to public scans in a folder of the user, which are identified by their DICOM attributes."""

from collections.abc import Sequence

from virtual_phantom.recordings.public_scans.fetch import link_scan
from virtual_phantom.recordings.public_scans.files import find_scans
from virtual_phantom.recordings.public_scans.table import PublicScan
from virtual_phantom.study.job import job, log


def main(*, scans: Sequence[PublicScan], folder: str, outputs: Sequence[str]) -> None:
    found = find_scans(folder, scans)
    for scan, link_folder in zip(scans, outputs, strict=True):
        link_scan(scan, found[scan.name], link_folder)
        log.info("%s: %d files in %s", scan.name, scan.files, folder)


if "snakemake" in globals():
    with job(snakemake):
        main(
            scans=snakemake.params.scans,
            folder=snakemake.params.folder,
            outputs=snakemake.output,
        )
