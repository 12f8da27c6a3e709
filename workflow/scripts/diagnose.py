"""Diagnose one recording: diagnosis.json, physics.yaml, maps and the report."""

from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.run import run_diagnosis
from virtual_phantom.diagnosis.selection.transfer import Physics, with_declared
from virtual_phantom.diagnosis.setup.check import NOT_CHECKED, write_setup
from virtual_phantom.diagnosis.verdict_text import console_text
from virtual_phantom.report.diagnosis import write_results
from virtual_phantom.statistics.proof_record import read_proof_record
from virtual_phantom.study.job import job
from virtual_phantom.study.start_of_fits import start_of_fits

OBJECTS = ("phantom", "mask", "labels", "shapes")  # inputs that describe the scanned object

with job(snakemake) as log:
    params, given, output = snakemake.params, snakemake.input, snakemake.output
    model = with_declared(params.model, given.get("declared"))
    request = DiagnosisRequest.of(model, given.get("phantom"), snakemake.threads)
    start, physics = None, Physics.read(given.physics) if "physics" in given.keys() else None
    if "kept" in params.keys():  # cases of the blind validation keep no fits
        files = [*given.files, *(given[kind] for kind in OBJECTS if kind in given.keys())]
        tried = [] if physics else [name for name in params.effects if name not in request.settings.baseline]
        start = start_of_fits(snakemake.wildcards.recording, model, params.kept, files, snakemake.log[0], len(tried))
    diagnosis = run_diagnosis(
        request,
        params.effects,
        params.accuracy,
        physics=physics,
        same_material=params.same_material,
        study_rois=(given.image, given.rois) if "phantom" in given.keys() else None,
        thresholds=params.matters,
        coverage=read_proof_record(given.record) if "record" in given.keys() else None,
        start_of_fits=start,
    )
    write_results(diagnosis, output)
    if "setup" in output.keys():
        write_setup(diagnosis.content.get("setup", NOT_CHECKED), output.setup)
    log.info("%s", console_text(diagnosis.content))
    print(console_text(diagnosis.content))
