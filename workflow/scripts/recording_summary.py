"""Read and check one recording, and write its summary as JSON."""

import json
from collections.abc import Mapping, Sequence

from virtual_phantom.features.parameters import read_parameters
from virtual_phantom.io import files
from virtual_phantom.recordings.reading import load_recording
from virtual_phantom.recordings.summary import summarize_recording
from virtual_phantom.study.job import job, log


def main(*, output: str, folder: str, voxel_sizes: Sequence[Sequence[float]], extraction: Mapping) -> None:
    parameters = read_parameters(**extraction)
    recording = load_recording(folder, parameters.features)
    found = summarize_recording(recording, parameters.extraction, voxel_sizes, parameters.section)
    files.write_text(json.dumps(found, indent=2, allow_nan=False) + "\n", output)
    log.info("%s: %s, %s", found["name"], found["kind"], found["text"])


if "snakemake" in globals():
    with job(snakemake):
        main(
            output=snakemake.output[0],
            folder=snakemake.params.folder,
            voxel_sizes=snakemake.params.voxel_sizes,
            extraction=snakemake.params.parameters,
        )
