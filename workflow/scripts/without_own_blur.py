"""Remove the scanner's blur from the mean of scans, and write its effect on the regions."""

from collections.abc import Sequence

import pandas as pd

from virtual_phantom.base.settings import GridSettings, from_mapping
from virtual_phantom.io import files
from virtual_phantom.io.volumes import read_nifti, write_nifti
from virtual_phantom.phantom.deconvolution import (
    SD_OF_FWHM,
    SD_OF_HALF,
    PowerSpectra,
    add_voxel_blur,
    deconvolve,
    keep_air,
)
from virtual_phantom.statistics.surface_resolution import edge_mtf_half
from virtual_phantom.study.job import job, log


def main(
    *,
    image_file: str,
    regions_file: str,
    spectra_file: str,
    sharp_file: str,
    table_file: str,
    slice_mm: float,
    grid: GridSettings,
    region_names: Sequence[str],
) -> None:
    mean = read_nifti(image_file)
    regions = read_nifti(regions_file).array.round().astype(int)
    half = edge_mtf_half(mean)
    in_plane, along = SD_OF_HALF / half, SD_OF_FWHM * slice_mm
    spectra = PowerSpectra.from_table(files.read_csv(spectra_file, numbers=["noise"]))
    fine = [step / grid.oversampling for step in grid.spacing_mm]
    blur = add_voxel_blur((along, in_plane, in_plane), mean.grid.spacing, fine)
    sharp = keep_air(deconvolve(mean, blur, spectra), mean)
    write_nifti(sharp, sharp_file)
    rows = [("mtf_half_per_mm", "", half, edge_mtf_half(sharp))]
    rows += [("blur_in_plane_mm", "", in_plane, SD_OF_HALF / rows[0][3]), ("blur_along_z_mm", "", along, None)]
    for number, name in enumerate(region_names, start=1):
        inside = regions == number
        for what, of in (("mean_hu", "mean"), ("sd_hu", "std")):
            rows.append((what, name, *(float(getattr(volume.array[inside], of)()) for volume in (mean, sharp))))
    table = pd.DataFrame(rows, columns=["what", "region", "of_the_mean", "without_own_blur"])
    files.write_csv(table, table_file)
    log.info("own blur %.2f mm in the plane, %.2f mm along z (SD of a Gaussian)", in_plane, along)


if "snakemake" in globals():
    with job(snakemake):
        main(
            image_file=snakemake.input.image,
            regions_file=snakemake.input.regions,
            spectra_file=snakemake.input.spectra,
            sharp_file=snakemake.output.image,
            table_file=snakemake.output.table,
            slice_mm=snakemake.params.slice_mm,
            grid=from_mapping(GridSettings, snakemake.params.grid),
            region_names=snakemake.params.regions,
        )
