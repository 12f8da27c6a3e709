"""Find the phantom in one recording of images; write the fit, the mean image and the ROIs on the recording's grid."""

import json
from dataclasses import asdict
from pathlib import Path

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.settings import PhantomSettings, from_mapping
from virtual_phantom.io import files, volumes
from virtual_phantom.phantom import read_rois, write_rois
from virtual_phantom.recordings import alignment, registration
from virtual_phantom.recordings.reading import load_recording
from virtual_phantom.study.job import job, log


def main(
    *,
    phantom_image: str,
    phantom_rois: str,
    folder: str,
    study: PhantomSettings,
    name: str,
    image_file: str,
    table_file: str,
    alignment_file: str,
) -> None:
    recording = load_recording(folder)
    if recording.kind != "images":
        raise InputError(f"recording {name}: holds {recording.kind}; only images can be aligned")
    alignment.check_same_phantom(recording, study.source, study.ct and study.ct.image)
    phantom = volumes.read_nifti(phantom_image)
    rois = read_rois(phantom_rois, phantom.grid)

    found, image, shifts = alignment.align_recording(recording, phantom)
    own = recording.rois()
    carried = own or alignment.transfer_rois(found, rois, phantom.grid, image, name)
    content = {
        "recording": name,
        "phantom": study.source,
        **asdict(found),
        "undetermined": found.undetermined,
        "covered_rois": {roi.name: alignment.covered_share(found, roi.mask, phantom.grid, image) for roi in rois},
        "rois_from": "recording.yaml" if own else "phantom",
        "repeats": [asdict(shift) for shift in shifts],
    }
    volumes.write_nifti(image, image_file)
    write_rois(carried, image, Path(table_file).parent)
    files.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", alignment_file)
    text = f"{name}: {registration.describe_alignment(found)}"
    log.info("%s", text)
    print(text)


if "snakemake" in globals():
    with job(snakemake):
        main(
            phantom_image=snakemake.input.phantom,
            phantom_rois=snakemake.input.rois,
            folder=snakemake.params.folder,
            study=from_mapping(PhantomSettings, snakemake.params.phantom),
            name=snakemake.wildcards.recording,
            image_file=snakemake.output.image,
            table_file=snakemake.output.table,
            alignment_file=snakemake.output.alignment,
        )
