"""Fixed pattern and noise in the ROIs of every group of the stability analysis."""

from collections.abc import Mapping, Sequence

import pandas as pd

from virtual_phantom import phantom
from virtual_phantom.io import files, volumes
from virtual_phantom.statistics import noise
from virtual_phantom.study.job import job, log


def main(
    *,
    image_files: Mapping[str, Sequence[str]],
    roi_files: Mapping[str, str],
    output: str,
) -> None:
    parts = []
    for protocol, paths in image_files.items():
        masks = phantom.read_masks(roi_files[protocol], volumes.read_nifti(paths[0]).grid)[1]
        images = (volumes.read_nifti(path).array for path in paths)
        part = noise.fixed_pattern(images, masks, name=f"fixed pattern, {protocol}")
        part.insert(0, "protocol", protocol)
        parts.append(part)
    table = pd.concat(parts, ignore_index=True)
    files.write_csv(table, output)
    log.info("\n%s", table.to_string(index=False))


if "snakemake" in globals():
    with job(snakemake):
        main(
            image_files=snakemake.params.image_files,
            roi_files=snakemake.params.roi_files,
            output=snakemake.output[0],
        )
