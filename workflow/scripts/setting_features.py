"""Extract the images of one protocol and noise level with one setting that differs from the study's, into one table."""

from collections.abc import Mapping, Sequence

import pandas as pd

from virtual_phantom import phantom
from virtual_phantom.features import extraction
from virtual_phantom.features.parameters import read_parameters, vary
from virtual_phantom.features.variations import Variation
from virtual_phantom.io import files
from virtual_phantom.study.job import job, log


def main(
    *,
    image_files: Sequence[str],
    roi_files: Sequence[str],
    output: str,
    seeds: Sequence[int],
    extraction_settings: Mapping,
    variation: Mapping,
    boxed: bool,
) -> None:
    parameters = vary(read_parameters(**extraction_settings), Variation(**variation))
    tables = []
    every_image = phantom.images_with_rois(image_files, roi_files)
    for path, (image, masks, classes), seed in zip(image_files, every_image, seeds, strict=True):
        found = extraction.extract(image, masks, name=str(path), parameters=parameters, boxed=boxed)
        found.insert(0, "seed", seed)
        found.insert(2, "tissue_class", found["roi"].map(classes))
        tables.append(found)
    files.write_csv(pd.concat(tables, ignore_index=True), output)
    log.info("%s: %d images", Variation(**variation).name, len(tables))


if "snakemake" in globals():
    with job(snakemake):
        main(
            image_files=snakemake.input.images,
            roi_files=snakemake.input.rois,
            output=snakemake.output[0],
            seeds=snakemake.params.seeds,
            extraction_settings=snakemake.params.parameters,
            variation=snakemake.params.variation,
            boxed=snakemake.params.boxed,
        )
