"""Find the phantom in one recording of images; write the fit, the mean image and the ROIs on the recording's grid."""

import json
from dataclasses import asdict
from pathlib import Path

from virtual_phantom.base.errors import InputError
from virtual_phantom.io import files, volumes
from virtual_phantom.phantom import read_rois, save_rois
from virtual_phantom.recordings import alignment, registration
from virtual_phantom.recordings.reading import load_recording
from virtual_phantom.study.job import job

with job(snakemake) as log:
    name, study = snakemake.wildcards.recording, snakemake.params.phantom
    recording = load_recording(snakemake.params.folder)
    if recording.kind != "images":
        raise InputError(f"recording {name}: holds {recording.kind}; only images can be aligned")
    alignment.check_same_phantom(recording, study["source"], study.get("ct", {}).get("image"))
    phantom = volumes.read_nifti(snakemake.input.phantom)
    rois = read_rois(snakemake.input.rois, phantom.grid)

    found, image, shifts = alignment.align_recording(recording, phantom)
    own = recording.rois()
    carried = own or alignment.transfer_rois(found, rois, phantom.grid, image, name)
    content = {
        "recording": name,
        "phantom": study["source"],
        **asdict(found),
        "undetermined": found.undetermined,
        "covered_rois": {roi.name: alignment.covered_share(found, roi.mask, phantom.grid, image) for roi in rois},
        "rois_from": "recording.yaml" if own else "phantom",
        "repeats": [asdict(shift) for shift in shifts],
    }
    volumes.write_nifti(image, snakemake.output.image)
    save_rois(carried, image, Path(snakemake.output.table).parent)
    files.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", snakemake.output.alignment)
    text = f"{name}: {registration.describe_alignment(found)}"
    log.info("%s", text)
    print(text)
