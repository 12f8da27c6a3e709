"""Write the features of one recording in HU, from its tables or extracted from its images; a row per image and ROI."""

from collections.abc import Mapping

import pandas as pd

from virtual_phantom import phantom
from virtual_phantom.base.errors import InputError
from virtual_phantom.features import extraction
from virtual_phantom.features.parameters import read_parameters
from virtual_phantom.io import files
from virtual_phantom.recordings.reading import load_recording
from virtual_phantom.recordings.reference import in_hu
from virtual_phantom.study.job import job, log


def main(
    *,
    rois_file: str | None,
    output: str,
    name: str,
    folder: str,
    extraction_settings: Mapping,
) -> None:
    parameters = read_parameters(**extraction_settings)
    recording = load_recording(folder, parameters.features)
    if recording.kind == "features":
        table = in_hu(recording)
    elif recording.kind == "images":
        rois, masks = phantom.read_masks(rois_file, recording.grid)
        classes = dict(zip(rois["roi"], rois["tissue_class"], strict=True))
        tables = []
        for path, image in zip(recording.repeats.paths, recording.repeats, strict=True):
            features = extraction.extract(image, masks, name=str(path), parameters=parameters)
            tables.append(features.assign(image=recording.document.relative(path)))
        table = pd.concat(tables, ignore_index=True)
        table = table.assign(tissue_class=table["roi"].map(classes))
    else:
        raise InputError(f"recording {name}: {recording.kind} have no features; use a recording of images or features")
    files.write_csv(table, output)
    log.info("%d rows of %d images", len(table), table["image"].nunique())


if "snakemake" in globals():
    with job(snakemake):
        main(
            rois_file=snakemake.input.get("rois"),
            output=snakemake.output[0],
            name=snakemake.wildcards.recording,
            folder=snakemake.params.folder,
            extraction_settings=snakemake.params.parameters,
        )
