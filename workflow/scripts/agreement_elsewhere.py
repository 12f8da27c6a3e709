"""Compare a diagnosed model with a scan by another protocol, for which only the alignment is fitted."""

import json

from virtual_phantom.base.streams import Branch
from virtual_phantom.diagnosis.comparison.regions import ScannedVolume
from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.preparation import compare_images, prepare_recording
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.selection.forward_selection import choose
from virtual_phantom.diagnosis.selection.transfer import Physics, verified
from virtual_phantom.io.files import write_text
from virtual_phantom.study.job import job

with job(snakemake) as log:
    params, given = snakemake.params, snakemake.input
    request = DiagnosisRequest.of(params.model, given.phantom, snakemake.threads)
    recording, prepared = prepare_recording(request)
    physics = Physics.read(given.physics, needed=False)
    baseline = trial(prepared.fitter, ())
    if physics.effects:
        choice = verified(prepared.fitter, baseline, physics, same_material=True)
    else:
        choice = choose(prepared.fitter, baseline, ())
    scanned = ScannedVolume.of(request, recording, (given.image, given.rois))
    table = compare_images(recording, prepared, choice, request, Branch.AGREEMENT_ELSEWHERE, scanned)
    write_text(json.dumps(table, indent=1, allow_nan=False) + "\n", snakemake.output[0])
