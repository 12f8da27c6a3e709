"""Which property of the images of one protocol and noise level explains that their features miss a recording's."""

from virtual_phantom.diagnosis.features.choice import held_out
from virtual_phantom.diagnosis.features.responses import compared, responses
from virtual_phantom.features.settings import of_parameters
from virtual_phantom.io import files
from virtual_phantom.io.volumes import read_nifti
from virtual_phantom.recordings.reference import where
from virtual_phantom.statistics.attribution import BASELINE, attribute
from virtual_phantom.study.job import job

with job(snakemake) as log:
    params, given = snakemake.params, snakemake.input
    recorded = where(files.read_csv(given.recorded), params.where, f"recording {params.recording}")
    table = files.read_csv(given.properties)
    study = of_parameters(params.parameters)
    features, _ = compared(table, recorded, params.dimensions, params.stored_offset_hu, study)
    data = responses(table, recorded, features, read_nifti(given.image).grid, params.rois)
    variants = {BASELINE: data.table(data.baseline)}
    variants |= {one.name: data.table(values) for one, values in held_out(data).items()}
    found = attribute(variants, recorded, data.features, rois=data.rois, margin_sd=params.margin_sd)
    files.write_csv(found.properties, snakemake.output.properties)
    files.write_csv(found.cells, snakemake.output.cells)
    log.info("\n%s", found.properties.query("family == 'all'").to_string(index=False))
