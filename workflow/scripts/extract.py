"""Features of all ROIs of the images of one protocol and noise level, one table per image."""

from virtual_phantom import feature_table, files, phantom, radiomics, volumes
from virtual_phantom.errors import InputError
from virtual_phantom.job import job

with job(snakemake) as log:
    params = snakemake.params
    images, seeds = list(snakemake.input.images), list(params.seeds)
    if not len(images) == len(seeds) == len(snakemake.output):
        raise InputError(f"extract: {len(images)} images, {len(seeds)} seeds and {len(snakemake.output)} outputs")
    masks = None
    for path, seed, output in zip(images, seeds, snakemake.output, strict=True):
        image = volumes.read_nifti(path)
        if masks is None:
            rois, masks = phantom.read_masks(snakemake.input.rois, image.grid)
            classes = dict(zip(rois["roi"], rois["tissue_class"], strict=True))
            grid = image.grid
        if not image.grid.matches(grid):
            raise InputError(f"{path}: is on another grid ({image.grid}) than the ROIs ({grid})")
        acquisition = {
            "protocol": params.protocol,
            "algorithm": params.settings["algorithm"],
            "projections": params.settings["projections"],
            "noise": params.noise,
            "noise_level": params.noise_level,
            "seed": seed,
        }
        table = feature_table.complete(radiomics.extract(image, masks, name=str(path)), classes, acquisition)
        files.write_csv(table, output)
        log.info("%s: %d ROIs", path, len(table))
