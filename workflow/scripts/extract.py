"""Extract the features of all ROIs of images, one table per image."""

from collections.abc import Mapping, Sequence

from virtual_phantom import phantom
from virtual_phantom.features import extraction, tables
from virtual_phantom.features.parameters import read_parameters
from virtual_phantom.io import files
from virtual_phantom.study.job import job, log
from virtual_phantom.study.matched_noise import resolve


def main(
    *,
    image_files: Sequence[str],
    levels: Sequence[str],
    roi_files: Sequence[str],
    outputs: Sequence[str],
    acquisitions: Sequence[Mapping],
    extraction_settings: Mapping,
    boxed: Sequence[bool],
) -> None:
    parameters = read_parameters(**extraction_settings)
    every_image = phantom.images_with_rois(image_files, roi_files)
    for path, (image, masks, classes), acquired, output, in_boxes in zip(
        image_files, every_image, resolve(acquisitions, levels), outputs, boxed, strict=True
    ):
        found = extraction.extract(image, masks, name=str(path), parameters=parameters, boxed=in_boxes)
        table = tables.add_acquisition(found, classes, acquired)
        files.write_csv(table, output)
        log.info("%s: %d ROIs", path, len(table))


if "snakemake" in globals():
    with job(snakemake):
        main(
            image_files=snakemake.input.images,
            levels=snakemake.input.levels,
            roi_files=snakemake.input.rois,
            outputs=snakemake.output,
            acquisitions=snakemake.params.images,
            extraction_settings=snakemake.params.parameters,
            boxed=snakemake.params.boxed,
        )
