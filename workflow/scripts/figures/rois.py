"""Figure of the regions of interest."""

from virtual_phantom.figures import rois, style
from virtual_phantom.io import volumes
from virtual_phantom.phantom import read_masks
from virtual_phantom.study.job import job

with job(snakemake):
    phantom = volumes.read_nifti(snakemake.input.image)
    table, masks = read_masks(snakemake.input.rois, phantom.grid)
    figure = rois.draw(phantom, masks, dict(zip(table["roi"], table["tissue_class"], strict=True)))
    style.save(figure, [snakemake.output.png, snakemake.output.pdf])
