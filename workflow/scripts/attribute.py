"""Which property of the images of one protocol and noise level explains that their features miss a recording's."""

from virtual_phantom.diagnosis.features.read import read_responses
from virtual_phantom.diagnosis.features.selection import held_out
from virtual_phantom.io import files
from virtual_phantom.statistics.attribution import BASELINE, attribute
from virtual_phantom.study.job import job

with job(snakemake) as log:
    params, given = snakemake.params, snakemake.input
    data, recorded, _ = read_responses(
        given.properties,
        given.recorded,
        given.image,
        recording=params.recording,
        conditions=params.where,
        dimensions=params.dimensions,
        stored_offset_hu=params.stored_offset_hu,
        parameters=params.parameters["path"],
        rois=params.rois,
    )
    variants = {BASELINE: data.table(data.baseline)}
    variants |= {one.name: data.table(values) for one, values in held_out(data).items()}
    found = attribute(variants, recorded, data.features, rois=data.rois, margin_sd=params.margin_sd)
    files.write_csv(found.properties, snakemake.output.properties)
    files.write_csv(found.cells, snakemake.output.cells)
    log.info("\n%s", found.properties.query("family == 'all'").to_string(index=False))
