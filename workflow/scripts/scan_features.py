"""Extract features of one public scan, a row per ROI: of volumes in HU, and of the largest slices of stored values."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from virtual_phantom.features.parameters import read_parameters
from virtual_phantom.io import files
from virtual_phantom.recordings.public_scans.features import scan_features
from virtual_phantom.recordings.public_scans.fetch import check_scan
from virtual_phantom.recordings.public_scans.table import PublicScan
from virtual_phantom.study.job import job, log


def main(
    *,
    scan_folder: str,
    outputs: Sequence[str],
    scan: PublicScan,
    rois: Mapping,
    regions: Sequence[str],
    extraction: Mapping,
) -> None:
    folder = Path(scan_folder)
    check_scan(scan, folder, sizes=False)
    tables = scan_features(scan, folder, rois, regions, read_parameters(**extraction))
    for table, path in zip(tables.values(), outputs, strict=True):
        files.write_csv(table, path)
    log.info("%s: %d ROIs", scan.name, len(table))


if "snakemake" in globals():
    with job(snakemake):
        main(
            scan_folder=snakemake.input.scan,
            outputs=snakemake.output,
            scan=snakemake.params.scan,
            rois=snakemake.params.rois,
            regions=snakemake.params.regions,
            extraction=snakemake.params.parameters,
        )
