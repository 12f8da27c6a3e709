"""Variance over repeats at every noise level of one protocol."""

import pandas as pd

from virtual_phantom import files, radiomics, volumes
from virtual_phantom.errors import InputError
from virtual_phantom.job import job
from virtual_phantom.statistics import noise

with job(snakemake) as log:
    params = snakemake.params
    acquisitions = pd.DataFrame(list(params.acquisitions))
    paths = list(snakemake.input.images)
    if len(paths) != len(acquisitions):
        raise InputError(f"noise calibration: {len(paths)} images for {len(acquisitions)} acquisitions")
    first = volumes.read_nifti(paths[0])
    _, masks = radiomics.read_masks(str(snakemake.input.rois), first)
    parts = []
    for (label, level), rows in acquisitions.groupby(["noise", "noise_level"], sort=False):
        images = (volumes.read_nifti(paths[index]).array for index in rows.index)
        part = noise.repeat_variance(images, masks, name=f"noise calibration, {params.protocol}, noise {label}")
        parts.append(part.assign(protocol=params.protocol, noise=label, noise_level=level))
    columns = ["protocol", "noise", "noise_level", "repeats", "roi", "variance_hu2", "standard_error"]
    table = pd.concat(parts).sort_values("noise_level", kind="stable")[columns]
    files.write_csv(table, snakemake.output[0])
    pooled = table[table["roi"] == "all"]
    if len(pooled) > 1:
        fit = noise.linear_fit(pooled["noise_level"], pooled["variance_hu2"])
        log.info("variance = %.6g + %.6g A, R2 = %.4f", fit.intercept, fit.slope, fit.r_squared)
