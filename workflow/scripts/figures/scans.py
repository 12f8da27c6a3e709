"""Figure of axial views: input, FBP, SIRT, in the slice that shows most ROIs."""

from virtual_phantom.figures import axial, scans, style
from virtual_phantom.io import volumes
from virtual_phantom.phantom import read_masks
from virtual_phantom.study.job import job

with job(snakemake):
    paths, titles = snakemake.input, snakemake.params.titles
    phantom = volumes.read_nifti(paths.phantom)
    _, masks = read_masks(paths.rois, phantom.grid)
    reconstructions = {titles[name]: volumes.read_nifti(paths[name]) for name in ("fbp", "sirt")}
    figure = scans.draw(phantom, reconstructions, axial.choose_slices(masks)[0], snakemake.params.noise)
    style.save(figure, [snakemake.output.png, snakemake.output.pdf])
