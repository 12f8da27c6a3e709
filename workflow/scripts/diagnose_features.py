"""Diagnose features by image properties: diagnosis.json, physics.yaml, maps and the report."""

from virtual_phantom.diagnosis.features.read import read_responses
from virtual_phantom.diagnosis.features.verdict import diagnose_features, overlay
from virtual_phantom.diagnosis.selection.store import write_diagnosis
from virtual_phantom.diagnosis.verdict_text import console_text
from virtual_phantom.features.names import MEAN
from virtual_phantom.report.diagnosis_of_features import feature_diagnosis_page
from virtual_phantom.study.job import job

with job(snakemake) as log:
    params, given, output = snakemake.params, snakemake.input, snakemake.output
    data, _, not_compared = read_responses(
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
    found = diagnose_features(snakemake.wildcards.comparison, data, not_compared, MEAN)
    write_diagnosis(
        output, found.content, overlay(data, found.content), feature_diagnosis_page(found), found.before.maps
    )
    log.info("%s", console_text(found.content))
    print(console_text(found.content))
