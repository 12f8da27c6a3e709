"""Figure of the regions of interest."""

from virtual_phantom import volumes
from virtual_phantom.figures import rois, style
from virtual_phantom.job import job
from virtual_phantom.phantom import read_masks

with job(snakemake):
    phantom = volumes.read_nifti(snakemake.input.image)
    table, masks = read_masks(snakemake.input.rois, phantom.grid)
    figure = rois.draw(phantom, masks, dict(zip(table["roi"], table["tissue_class"], strict=True)))
    style.save(figure, [snakemake.output.png, snakemake.output.pdf])
