"""Average public scans of one object, and write their regions as a label map."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from virtual_phantom.base.geometry import grid_of
from virtual_phantom.base.settings import GridSettings, from_mapping
from virtual_phantom.io import files
from virtual_phantom.io.volumes import Volume, write_nifti
from virtual_phantom.phantom.mean_scan import ScanFiles, average_scans
from virtual_phantom.recordings.public_scans.fetch import check_scan
from virtual_phantom.recordings.public_scans.files import regions_file
from virtual_phantom.recordings.public_scans.table import PublicScan
from virtual_phantom.study.job import job, log


def main(
    *,
    folders: Sequence[str],
    image_file: str,
    labels_file: str,
    table_file: str,
    spectra_file: str,
    public_scans: Sequence[PublicScan],
    region_names: Sequence[str],
    grid: GridSettings,
) -> None:
    scans = []
    for scan, folder in zip(public_scans, map(Path, folders), strict=True):
        check_scan(scan, folder, sizes=False)
        scans.append(ScanFiles(scan.name, folder / "ct", regions_file(folder)))
    mean_scan = average_scans(scans, region_names, grid_of(grid).extent_mm[0])
    write_nifti(mean_scan.image, image_file)
    write_nifti(Volume(mean_scan.labels, mean_scan.image.grid), labels_file)
    table = pd.DataFrame(mean_scan.rows).assign(noise_hu=mean_scan.noise_hu, remaining_noise_hu=mean_scan.remaining_hu)
    files.write_csv(table, table_file)
    files.write_csv(mean_scan.spectra.table(), spectra_file)
    log.info(
        "%d scans on %s; noise %.1f HU in one, %.1f HU in their mean",
        *(len(scans), mean_scan.image.grid, mean_scan.noise_hu, mean_scan.remaining_hu),
    )


if "snakemake" in globals():
    with job(snakemake):
        main(
            folders=snakemake.input.scans,
            image_file=snakemake.output.image,
            labels_file=snakemake.output.regions,
            table_file=snakemake.output.table,
            spectra_file=snakemake.output.spectra,
            public_scans=snakemake.params.scans,
            region_names=snakemake.params.regions,
            grid=from_mapping(GridSettings, snakemake.params.grid),
        )
