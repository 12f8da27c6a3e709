"""ROIs on the voxels of a scanner: their masks and rois.csv beside snakemake.output.table."""

from pathlib import Path

from virtual_phantom.base.streams import Branch, branch
from virtual_phantom.base.units import HU_AIR
from virtual_phantom.io.volumes import Volume, read_nifti
from virtual_phantom.phantom import ct, layout, save_rois, synthetic
from virtual_phantom.reconstruction.boxes import voxels_over
from virtual_phantom.study.job import job

with job(snakemake) as log:
    settings = snakemake.params.phantom
    fine = read_nifti(snakemake.input.fine)
    grid = voxels_over(fine.grid, snakemake.params.spacing_mm)
    if settings["source"] == "synthetic":
        seed = branch(snakemake.params.seed, Branch.PHANTOM)
        rois = synthetic.rois(layout.read_layout(settings["layout"]), grid, seed)
    else:
        rois = ct.rois(settings["ct"], grid)
    image = Volume(ct.resample(fine, grid, outside=HU_AIR), grid)
    save_rois(rois, image, Path(snakemake.output.table).parent)
    log.info("%d ROIs on %s", len(rois), grid)
