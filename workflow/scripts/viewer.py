"""Write the viewer of slices."""

from collections.abc import Mapping, Sequence

from virtual_phantom.io import files, volumes
from virtual_phantom.phantom import read_masks
from virtual_phantom.report import viewer
from virtual_phantom.study.job import job, log


def main(
    *,
    phantom_file: str,
    rois_file: str,
    image_files: Mapping[str, Sequence[str]],
    output: str,
    titles: Mapping[str, str],
    subtitle: str,
) -> None:
    phantom = volumes.read_nifti(phantom_file)
    _, masks = read_masks(rois_file, phantom.grid)
    reconstructions = {}
    for key in ("fbp", "sirt"):
        repeats, grid = volumes.read_repeats(image_files[key])
        first, mean = (volumes.Volume(array, grid) for array in (repeats[0], repeats.mean(axis=0)))
        reconstructions[key] = viewer.Reconstruction(titles[key], first, mean, len(repeats))
    viewer_page = viewer.viewer_page(phantom, masks, reconstructions, subtitle)
    files.write_text(viewer_page, output)
    log.info("%.1f MB", len(viewer_page) / 1e6)


if "snakemake" in globals():
    with job(snakemake):
        main(
            phantom_file=snakemake.input.phantom,
            rois_file=snakemake.input.rois,
            image_files={"fbp": snakemake.input.fbp, "sirt": snakemake.input.sirt},
            output=snakemake.output[0],
            titles=snakemake.params.titles,
            subtitle=snakemake.params.subtitle,
        )
