"""Which property of the images of one protocol and noise level explains that their features miss a recording's."""

from virtual_phantom import phantom
from virtual_phantom.diagnosis.features.simulated_variants import property_variants
from virtual_phantom.features import extraction
from virtual_phantom.io import files, volumes
from virtual_phantom.recordings.reference import where
from virtual_phantom.statistics.attribution import attribute
from virtual_phantom.statistics.comparison import common_features, common_rois
from virtual_phantom.study.job import job

with job(snakemake) as log:
    params = snakemake.params
    recorded = where(files.read_csv(snakemake.input.recorded), params.where, f"recording {params.recording}")
    images, grid = volumes.read_repeats(snakemake.input.images)
    rois, masks = phantom.read_masks(snakemake.input.rois, grid)
    masks = {roi: masks[roi] for roi in common_rois(rois, recorded, params.rois)}
    tables = {}
    for name, changed, own_grid, own_masks in property_variants(images, grid, masks, recorded, params.voxel_mm):
        tables[name] = extraction.extract_repeats(changed, own_grid, own_masks, name)
        log.info("%s: %d rows", name, len(tables[name]))
    features = common_features(next(iter(tables.values())), recorded)
    found = attribute(tables, recorded, features, rois=list(masks), margin_sd=params.margin_sd)
    files.write_csv(found.properties, snakemake.output.properties)
    files.write_csv(found.cells, snakemake.output.cells)
    log.info("\n%s", found.properties.query("family == 'all'").to_string(index=False))
