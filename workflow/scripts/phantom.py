"""Build or load the phantom, and write its images, masks and rois.csv to the folder of snakemake.output.image."""

from pathlib import Path

from virtual_phantom.base.geometry import grid_of
from virtual_phantom.base.settings import GridSettings, PhantomSettings, from_mapping
from virtual_phantom.base.streams import Branch, branch
from virtual_phantom.phantom import ct, layout, synthetic, write_phantom
from virtual_phantom.physics.scenes.objects import read_phantom_object
from virtual_phantom.physics.scenes.voxelized import voxelize
from virtual_phantom.study.job import job, log


def main(
    *,
    output: str,
    settings: PhantomSettings,
    sampling: GridSettings,
    study_seed: int,
    mu_water_per_mm: float,
) -> None:
    grid = grid_of(sampling)
    oversampling = sampling.oversampling
    if settings.source == "synthetic":
        seed = branch(study_seed, Branch.PHANTOM)
        phantom = synthetic.build(layout.read_layout(settings.layout), grid, oversampling, seed)
    elif settings.source == "object":
        shaped, rois = read_phantom_object(settings.object)
        phantom = voxelize(shaped, grid, oversampling, mu_water_per_mm, rois)
    else:
        phantom = ct.load_phantom(settings.ct, grid, oversampling)
    write_phantom(phantom, Path(output).parent)
    log.info("%s phantom on %s, %d ROIs", settings.source, phantom.image.grid, len(phantom.rois))


if "snakemake" in globals():
    with job(snakemake):
        main(
            output=snakemake.output.image,
            settings=from_mapping(PhantomSettings, snakemake.params.phantom),
            sampling=from_mapping(GridSettings, snakemake.params.grid),
            study_seed=snakemake.params.seed,
            mu_water_per_mm=snakemake.params.mu_water_per_mm,
        )
