"""ROIs on the voxels of a scanner, or of a re-positioned phantom: masks and rois.csv beside snakemake.output.table."""

from pathlib import Path

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.pose import IN_PLACE
from virtual_phantom.base.streams import Branch, branch
from virtual_phantom.base.units import HU_AIR
from virtual_phantom.io.simpleitk import itk_image, itk_resample
from virtual_phantom.io.volumes import Volume, read_nifti
from virtual_phantom.phantom import ct, layout, synthetic, write_rois
from virtual_phantom.phantom.repositioning import moved_to_border, random_pose, world_to_object
from virtual_phantom.reconstruction.boxes import voxels_over
from virtual_phantom.study.job import job

with job(snakemake) as log:
    params = snakemake.params
    settings = params.phantom
    fine, grid = read_nifti(snakemake.input.fine), read_nifti(snakemake.input.image).grid
    if params.spacing_mm is not None:
        grid = voxels_over(grid, params.spacing_mm)

    def drawn(pose):
        if settings["source"] == "synthetic":
            seed = branch(params.seed, Branch.PHANTOM)
            return synthetic.rois(layout.read_layout(settings["layout"]), grid, seed, pose)
        return ct.rois(settings["ct"], grid, pose)

    pose = random_pose(**params.pose) if params.pose else IN_PLACE
    rois = drawn(pose)
    if params.pose and (lost := moved_to_border([roi.mask for roi in rois], [roi.mask for roi in drawn(IN_PLACE)])):
        raise InputError(
            f"repeats: ROI {rois[lost[0]].name} leaves the grid where the phantom is re-positioned by {pose}; enlarge "
            "grid.shape, or make repeats.shift_mm smaller"
        )
    # Interpolated at the voxels' centres: for the mean within each ROI, no more.
    there = itk_resample(itk_image(fine.array, fine.grid), grid, world_to_object(pose, grid.centre_mm), HU_AIR)
    write_rois(rois, Volume(there, grid), Path(snakemake.output.table).parent)
    log.info("%d ROIs on %s, %s", len(rois), grid, pose)
