"""Extract the features of all ROIs of images, one table per image."""

from collections.abc import Mapping, Sequence

from virtual_phantom import phantom
from virtual_phantom.base.errors import InputError
from virtual_phantom.features import extraction, tables
from virtual_phantom.features.parameters import read_parameters
from virtual_phantom.io import files, volumes
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
) -> None:
    parameters = read_parameters(**extraction_settings)
    drawn = None
    for path, acquired, place, output in zip(
        image_files, resolve(acquisitions, levels), roi_files, outputs, strict=True
    ):
        image = volumes.read_nifti(path)
        if place != drawn:
            rois, masks = phantom.read_masks(place, image.grid)
            classes = dict(zip(rois["roi"], rois["tissue_class"], strict=True))
            grid, drawn = image.grid, place
        if not image.grid.matches(grid):
            raise InputError(f"{path}: is on another grid ({image.grid}) than the ROIs ({grid})")
        found = extraction.extract(image, masks, name=str(path), parameters=parameters)
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
        )
