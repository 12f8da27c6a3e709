"""Test the physics found by a diagnosis on a second scan of the same object by another protocol.

Only the alignment is fitted to the second scan.
"""

import json

from virtual_phantom.base.settings import from_mapping
from virtual_phantom.base.streams import Branch
from virtual_phantom.diagnosis.comparison.regions import ScannedVolume
from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.preparation import compare_images, prepare_recording
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.selection.forward_selection import Choice
from virtual_phantom.diagnosis.selection.transfer import Physics, fit_with_fixed_physics
from virtual_phantom.diagnosis.settings import FitSettings
from virtual_phantom.io.documents import DIAGNOSIS, read_document
from virtual_phantom.io.files import write_text
from virtual_phantom.study.job import job


def main(
    *,
    phantom_file: str | None,
    image_file: str | None,
    rois_file: str | None,
    physics_file: str,
    output: str,
    model: FitSettings,
    threads: int,
) -> None:
    request = DiagnosisRequest.of(model, phantom_file, threads)
    recording, prepared = prepare_recording(request)
    named = read_document(physics_file, DIAGNOSIS)["effects"]
    physics = Physics.read(physics_file, allow_empty=True) if named else None
    baseline = trial(prepared.fitter, ())
    if physics and physics.effects:
        choice = fit_with_fixed_physics(prepared.fitter, baseline, physics, same_material=True)
    else:  # no effect was found: the baseline alone
        choice = Choice(baseline, baseline)
    scanned = ScannedVolume.of(request, recording, (image_file, rois_file) if phantom_file else None)
    table = compare_images(recording, prepared, choice, request, Branch.AGREEMENT_OTHER_PROTOCOL, scanned=scanned)
    write_text(json.dumps(table, indent=1, allow_nan=False) + "\n", output)


if "snakemake" in globals():
    with job(snakemake):
        main(
            phantom_file=snakemake.params.phantom,
            image_file=snakemake.params.image,
            rois_file=snakemake.params.rois,
            physics_file=snakemake.input.physics,
            output=snakemake.output[0],
            model=from_mapping(FitSettings, snakemake.params.model),
            threads=snakemake.threads,
        )
