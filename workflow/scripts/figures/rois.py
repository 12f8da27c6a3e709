"""Figure of the regions of interest."""

from virtual_phantom.figures import rois, style
from virtual_phantom.io import volumes
from virtual_phantom.phantom import read_masks
from virtual_phantom.study.job import job


def main(*, image: str, rois_file: str, outputs: list[str]) -> None:
    phantom = volumes.read_nifti(image)
    table, masks = read_masks(rois_file, phantom.grid)
    figure = rois.draw(phantom, masks, dict(zip(table["roi"], table["tissue_class"], strict=True)))
    style.save(figure, outputs)


if "snakemake" in globals():
    with job(snakemake):
        main(
            image=snakemake.input.image,
            rois_file=snakemake.input.rois,
            outputs=[snakemake.output.png, snakemake.output.pdf],
        )
