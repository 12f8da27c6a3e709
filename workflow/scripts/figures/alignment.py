"""Figure of the phantom's outlines on a recording."""

import json

from virtual_phantom.figures import alignment, style
from virtual_phantom.io import volumes
from virtual_phantom.io.files import read_text
from virtual_phantom.phantom import read_masks
from virtual_phantom.study.job import job

with job(snakemake):
    image = volumes.read_nifti(snakemake.input.image)
    table, masks = read_masks(snakemake.input.rois, image.grid)
    found = json.loads(read_text(snakemake.input.alignment))
    figure = alignment.draw(
        image,
        volumes.read_nifti(snakemake.input.phantom),
        found["matrix"],
        masks,
        dict(zip(table["roi"], table["tissue_class"], strict=True)),
    )
    style.save(figure, [snakemake.output.png, snakemake.output.pdf])
