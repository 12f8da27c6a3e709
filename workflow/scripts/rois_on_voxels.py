"""Write ROIs of a re-positioned phantom, or on the voxels of a scanner, to the folder of snakemake.output.table."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.pose import IN_PLACE
from virtual_phantom.base.settings import PhantomSettings, from_mapping
from virtual_phantom.base.streams import Branch, branch
from virtual_phantom.base.units import HU_AIR
from virtual_phantom.io.simpleitk import itk_image, itk_resample
from virtual_phantom.io.volumes import Volume, read_nifti
from virtual_phantom.phantom import ct, layout, synthetic, write_rois
from virtual_phantom.phantom.repositioning import moved_to_border, random_pose, world_to_object
from virtual_phantom.reconstruction.boxes import voxels_over
from virtual_phantom.study.job import job, log


def main(
    *,
    fine_file: str,
    image_file: str,
    output: str,
    settings: PhantomSettings,
    study_seed: int,
    pose_settings: Mapping | None,
    spacing_mm: Sequence[float] | None,
) -> None:
    fine, grid = read_nifti(fine_file), read_nifti(image_file).grid
    if spacing_mm is not None:
        grid = voxels_over(grid, spacing_mm)

    def drawn(pose):
        if settings.source == "synthetic":
            seed = branch(study_seed, Branch.PHANTOM)
            return synthetic.rois(layout.read_layout(settings.layout), grid, seed, pose)
        return ct.rois(settings.ct, grid, pose)

    pose = random_pose(**pose_settings) if pose_settings else IN_PLACE
    rois = drawn(pose)
    if pose_settings and (lost := moved_to_border([roi.mask for roi in rois], [roi.mask for roi in drawn(IN_PLACE)])):
        raise InputError(
            f"repeats: ROI {rois[lost[0]].name} leaves the grid where the phantom is re-positioned by {pose}; enlarge "
            "grid.shape, or make repeats.shift_mm smaller"
        )
    # Interpolated at the voxel centers, which is sufficient for the mean within each ROI.
    there = itk_resample(itk_image(fine.array, fine.grid), grid, world_to_object(pose, grid.centre_mm), HU_AIR)
    write_rois(rois, Volume(there, grid), Path(output).parent)
    log.info("%d ROIs on %s, %s", len(rois), grid, pose)


if "snakemake" in globals():
    with job(snakemake):
        main(
            fine_file=snakemake.input.fine,
            image_file=snakemake.input.image,
            output=snakemake.output.table,
            settings=from_mapping(PhantomSettings, snakemake.params.phantom),
            study_seed=snakemake.params.seed,
            pose_settings=snakemake.params.pose,
            spacing_mm=snakemake.params.spacing_mm,
        )
