"""Figure of axial views: input, FBP, SIRT, in the slice that shows most ROIs."""

from collections.abc import Mapping

from virtual_phantom.figures import axial, scans, style
from virtual_phantom.io import volumes
from virtual_phantom.phantom import read_masks
from virtual_phantom.study.job import job


def main(
    *,
    phantom_file: str,
    rois_file: str,
    image_files: Mapping[str, str],
    outputs: list[str],
    titles: Mapping[str, str],
    noise: Mapping,
) -> None:
    phantom = volumes.read_nifti(phantom_file)
    _, masks = read_masks(rois_file, phantom.grid)
    reconstructions = {titles[name]: volumes.read_nifti(image_files[name]) for name in ("fbp", "sirt")}
    figure = scans.draw(phantom, reconstructions, axial.choose_slices(masks)[0], noise)
    style.save(figure, outputs)


if "snakemake" in globals():
    with job(snakemake):
        main(
            phantom_file=snakemake.input.phantom,
            rois_file=snakemake.input.rois,
            image_files={"fbp": snakemake.input.fbp, "sirt": snakemake.input.sirt},
            outputs=[snakemake.output.png, snakemake.output.pdf],
            titles=snakemake.params.titles,
            noise=snakemake.params.noise,
        )
