"""Figure of the phantom's outlines on a recording."""

import json

from virtual_phantom.figures import alignment, style
from virtual_phantom.io import volumes
from virtual_phantom.io.files import read_text
from virtual_phantom.phantom import read_masks
from virtual_phantom.study.job import job


def main(
    *,
    image_file: str,
    rois: str,
    alignment_file: str,
    phantom: str,
    outputs: list[str],
) -> None:
    image = volumes.read_nifti(image_file)
    table, masks = read_masks(rois, image.grid)
    found = json.loads(read_text(alignment_file))
    figure = alignment.draw(
        image,
        volumes.read_nifti(phantom),
        found["matrix"],
        masks,
        dict(zip(table["roi"], table["tissue_class"], strict=True)),
    )
    style.save(figure, outputs)


if "snakemake" in globals():
    with job(snakemake):
        main(
            image_file=snakemake.input.image,
            rois=snakemake.input.rois,
            alignment_file=snakemake.input.alignment,
            phantom=snakemake.input.phantom,
            outputs=[snakemake.output.png, snakemake.output.pdf],
        )
