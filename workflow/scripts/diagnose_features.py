"""Which property of the images explains features: diagnosis.json, physics.yaml, maps and the report."""

from virtual_phantom.diagnosis.core.store import write_diagnosis
from virtual_phantom.diagnosis.features.responses import compared, responses
from virtual_phantom.diagnosis.features.verdict import diagnose_features, overlay
from virtual_phantom.features.names import MEAN
from virtual_phantom.features.settings import of_parameters
from virtual_phantom.io import files
from virtual_phantom.io.volumes import read_nifti
from virtual_phantom.recordings.reference import where
from virtual_phantom.report.diagnosis_of_features import page
from virtual_phantom.study.job import job

with job(snakemake) as log:
    params, given, output = snakemake.params, snakemake.input, snakemake.output
    recorded = where(files.read_csv(given.recorded), params.where, f"recording {params.recording}")
    table = files.read_csv(given.properties)
    study = of_parameters(params.parameters)
    features, not_compared = compared(table, recorded, params.dimensions, params.stored_offset_hu, study)
    data = responses(table, recorded, features, read_nifti(given.image).grid, params.rois)
    found = diagnose_features(snakemake.wildcards.comparison, data, not_compared, MEAN)
    write_diagnosis(output, found.content, overlay(data, found.content), page(found), found.before.maps)
    log.info("%s", found.content["sentence"])
    print(found.content["sentence"])
