"""Measure the variance over repeats at every noise level of the protocols of the noise calibration."""

from collections.abc import Mapping, Sequence

import pandas as pd

from virtual_phantom import phantom
from virtual_phantom.io import files, volumes
from virtual_phantom.statistics import noise
from virtual_phantom.study.job import job, log

KEYS = ["protocol", "noise", "noise_level"]


def main(
    *,
    image_files: Sequence[str],
    roi_files: Sequence[str],
    output: str,
    protocols: Sequence[str],
    acquisition_settings: Sequence[Mapping],
) -> None:
    acquisitions = pd.DataFrame(list(acquisition_settings))
    tables, masks = dict(zip(protocols, roi_files, strict=True)), {}
    parts = []
    for (protocol, label, level), rows in acquisitions.groupby(KEYS, sort=False):
        if protocol not in masks:
            grid = volumes.read_nifti(image_files[rows.index[0]]).grid
            masks = {protocol: phantom.read_masks(tables[protocol], grid)[1]}
        images = (volumes.read_nifti(image_files[index]).array for index in rows.index)
        part = noise.repeat_variance(images, masks[protocol], name=f"noise calibration, {protocol}, noise {label}")
        parts.append(part.assign(protocol=protocol, noise=label, noise_level=level))
    table = pd.concat(parts).sort_values(["protocol", "noise_level"], kind="stable")
    table = table[KEYS + [column for column in table if column not in KEYS]]
    files.write_csv(table, output)
    for protocol, pooled in table[table["roi"] == noise.EVERY_ROI].groupby("protocol"):
        fit = noise.linear_fit(pooled["noise_level"], pooled["variance_hu2"])
        log.info("%s: variance = %.6g + %.6g A, R2 = %.4f", protocol, fit.intercept, fit.slope, fit.r_squared)


if "snakemake" in globals():
    with job(snakemake):
        main(
            image_files=snakemake.input.images,
            roi_files=snakemake.input.rois,
            output=snakemake.output[0],
            protocols=snakemake.params.protocols,
            acquisition_settings=snakemake.params.acquisitions,
        )
