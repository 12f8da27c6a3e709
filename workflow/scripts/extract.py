"""Features of all ROIs of the images of one protocol and noise level, one table per image."""

from virtual_phantom import phantom
from virtual_phantom.base.errors import InputError
from virtual_phantom.features import extraction, tables
from virtual_phantom.features.parameters import read_parameters
from virtual_phantom.io import files, volumes
from virtual_phantom.study.job import job
from virtual_phantom.study.matched_noise import resolve

with job(snakemake) as log:
    params = snakemake.params
    images = list(snakemake.input.images)
    acquisitions = resolve(params.acquisitions, snakemake.input.levels)
    parameters = read_parameters(**params.parameters)
    drawn = None
    for path, one, place, output in zip(images, acquisitions, snakemake.input.rois, snakemake.output, strict=True):
        image = volumes.read_nifti(path)
        if place != drawn:
            rois, masks = phantom.read_masks(place, image.grid)
            classes = dict(zip(rois["roi"], rois["tissue_class"], strict=True))
            grid, drawn = image.grid, place
        if not image.grid.matches(grid):
            raise InputError(f"{path}: is on another grid ({image.grid}) than the ROIs ({grid})")
        acquisition = {
            "protocol": params.protocol,
            "algorithm": params.settings["algorithm"],
            "projections": params.settings["projections"],
            **one,
        }
        found = extraction.extract(image, masks, name=str(path), parameters=parameters)
        table = tables.add_acquisition(found, classes, acquisition)
        files.write_csv(table, output)
        log.info("%s: %d ROIs", path, len(table))
