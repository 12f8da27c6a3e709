"""The mean of scans before its own scanner blurred it, and what that changes."""

import pandas as pd

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
from virtual_phantom.study.job import job

with job(snakemake) as log:
    params, output = snakemake.params, snakemake.output
    mean = read_nifti(snakemake.input.image)
    regions = read_nifti(snakemake.input.regions).array.round().astype(int)
    half = edge_mtf_half(mean)
    in_plane, along = SD_OF_HALF / half, SD_OF_FWHM * params.slice_mm
    spectra = PowerSpectra.from_table(files.read_csv(snakemake.input.spectra, numbers=["noise"]))
    fine = [step / params.grid["oversampling"] for step in params.grid["spacing_mm"]]
    blur = add_voxel_blur((along, in_plane, in_plane), mean.grid.spacing, fine)
    sharp = keep_air(deconvolve(mean, blur, spectra), mean)
    write_nifti(sharp, output.image)
    rows = [("mtf_half_per_mm", "", half, edge_mtf_half(sharp))]
    rows += [("blur_in_plane_mm", "", in_plane, SD_OF_HALF / rows[0][3]), ("blur_along_z_mm", "", along, None)]
    for number, name in enumerate(params.regions, start=1):
        inside = regions == number
        for what, of in (("mean_hu", "mean"), ("sd_hu", "std")):
            rows.append((what, name, *(float(getattr(one.array[inside], of)()) for one in (mean, sharp))))
    table = pd.DataFrame(rows, columns=["what", "region", "of_the_mean", "without_own_blur"])
    files.write_csv(table, output.table)
    log.info("own blur %.2f mm in the plane, %.2f mm along z (SD of a Gaussian)", in_plane, along)
