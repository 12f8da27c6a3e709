"""Which property of the images explains features: diagnosis.json, physics.yaml, maps and the report."""

from virtual_phantom.diagnosis.features.read import read_responses
from virtual_phantom.diagnosis.features.verdict import diagnose_features, overlay
from virtual_phantom.diagnosis.selection.store import write_diagnosis
from virtual_phantom.features.names import MEAN
from virtual_phantom.report.diagnosis_of_features import page
from virtual_phantom.study.job import job

with job(snakemake) as log:
    params, given, output = snakemake.params, snakemake.input, snakemake.output
    data, not_compared = read_responses(
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
    found = diagnose_features(snakemake.wildcards.comparison, data, not_compared, MEAN, params.margin_sd)
    write_diagnosis(output, found.content, overlay(data, found.content), page(found), found.before.maps)
    log.info("%s", found.content["sentence"])
    print(found.content["sentence"])
