"""The page to flip through slices."""

from virtual_phantom.io import files, volumes
from virtual_phantom.phantom import read_masks
from virtual_phantom.report import viewer
from virtual_phantom.study.job import job

with job(snakemake) as log:
    paths, params = snakemake.input, snakemake.params
    phantom = volumes.read_nifti(paths.phantom)
    _, masks = read_masks(paths.rois, phantom.grid)
    reconstructions = {}
    for key in ("fbp", "sirt"):
        repeats, grid = volumes.read_repeats(paths[key])
        single, mean = (volumes.Volume(array, grid) for array in (repeats[0], repeats.mean(axis=0)))
        reconstructions[key] = viewer.Reconstruction(params.titles[key], single, mean, len(repeats))
    page = viewer.viewer_page(phantom, masks, reconstructions, params.subtitle)
    files.write_text(page, snakemake.output[0])
    log.info("%.1f MB", len(page) / 1e6)
