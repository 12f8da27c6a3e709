"""Read and check one recording, and write what was found as JSON."""

import json

from virtual_phantom.features.parameters import read_parameters
from virtual_phantom.io import files
from virtual_phantom.recordings.reading import load_recording
from virtual_phantom.recordings.summary import summarize_recording
from virtual_phantom.study.job import job

with job(snakemake) as log:
    parameters = read_parameters(**snakemake.params.parameters)
    recording = load_recording(snakemake.params.folder, parameters.features)
    found = summarize_recording(recording, parameters.extraction, snakemake.params.voxel_mm)
    files.write_text(json.dumps(found, indent=2, allow_nan=False) + "\n", snakemake.output[0])
    log.info("%s: %s, %s", found["name"], found["kind"], found["text"])
