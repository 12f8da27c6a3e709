"""The mean of public scans of one object, and their regions as a label map."""

from pathlib import Path

import pandas as pd

from virtual_phantom.base.geometry import grid_of
from virtual_phantom.io import files
from virtual_phantom.io.volumes import Volume, write_nifti
from virtual_phantom.phantom.mean import ScanFiles, mean_of
from virtual_phantom.recordings.public_scans.fetch import check_scan
from virtual_phantom.recordings.public_scans.files import regions_file
from virtual_phantom.study.job import job

with job(snakemake) as log:
    params, output = snakemake.params, snakemake.output
    scans = []
    for scan, folder in zip(params.scans, map(Path, snakemake.input.scans), strict=True):
        check_scan(scan, folder, sizes=False)
        scans.append(ScanFiles(scan.name, folder / "ct", regions_file(folder)))
    mean = mean_of(scans, params.regions, grid_of(params.grid).extent_mm[0])
    write_nifti(mean.image, output.image)
    write_nifti(Volume(mean.labels, mean.image.grid), output.regions)
    table = pd.DataFrame(mean.rows).assign(noise_hu=mean.noise_hu, remaining_noise_hu=mean.remaining_hu)
    files.write_csv(table, output.table)
    files.write_csv(mean.spectra.table(), output.spectra)
    log.info(
        "%d scans on %s; noise %.1f HU in one, %.1f HU in their mean",
        *(len(scans), mean.image.grid, mean.noise_hu, mean.remaining_hu),
    )
