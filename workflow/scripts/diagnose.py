"""Diagnose one recording: diagnosis.json, physics.yaml, maps and the report."""

from collections.abc import Mapping, Sequence

from virtual_phantom.base.settings import from_mapping
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.result_files import DiagnosisFiles
from virtual_phantom.diagnosis.run import run_diagnosis
from virtual_phantom.diagnosis.selection.transfer import Physics, with_declared
from virtual_phantom.diagnosis.settings import OBJECT_INPUTS, FitSettings
from virtual_phantom.diagnosis.setup.check import NOT_CHECKED, write_setup
from virtual_phantom.diagnosis.verdict_text import console_text
from virtual_phantom.report.diagnosis import write_results
from virtual_phantom.statistics.proof_record import read_proof_record
from virtual_phantom.study.job import job, log
from virtual_phantom.study.start_of_fits import start_of_fits


def main(
    *,
    output: DiagnosisFiles,
    setup_file: str | None,
    recording_files: Sequence[str],
    phantom_file: str | None,
    image_file: str | None,
    rois_file: str | None,
    object_files: Sequence[str],
    declared_file: str | None,
    physics_file: str | None,
    record_file: str | None,
    name: str | None,
    log_file: str,
    cache_folder: str | None,
    stated_model: FitSettings,
    effect_names: Sequence[str],
    same_material: bool,
    accuracy: Mapping[str, float],
    thresholds: Mapping | None,
    threads: int,
) -> None:
    model = with_declared(stated_model, declared_file)
    request = DiagnosisRequest.of(model, phantom_file, threads)
    start, physics = None, Physics.read(physics_file) if physics_file else None
    if cache_folder:  # cases of the blind validation have none and report no progress
        files = [*recording_files, *object_files]
        tried = [] if physics else [effect for effect in effect_names if effect not in request.settings.baseline]
        start = start_of_fits(name, model, cache_folder, files, log_file, len(tried))
    diagnosis = run_diagnosis(
        request,
        effect_names,
        accuracy,
        physics=physics,
        same_material=same_material,
        study_rois=(image_file, rois_file) if phantom_file else None,
        thresholds=thresholds,
        coverage=read_proof_record(record_file) if record_file else None,
        start_of_fits=start,
    )
    write_results(diagnosis, output)
    if setup_file:
        write_setup(diagnosis.content.get("setup", NOT_CHECKED), setup_file)
    log.info("%s", console_text(diagnosis.content))
    print(console_text(diagnosis.content))


# The object of a case of the blind validation is part of a folder, whose files are parameters.
if "snakemake" in globals():
    with job(snakemake):
        main(
            output=snakemake.output,
            setup_file=snakemake.output.get("setup"),
            recording_files=snakemake.input.get("files", []),
            phantom_file=snakemake.input.get("phantom") or snakemake.params.get("phantom"),
            image_file=snakemake.input.get("image") or snakemake.params.get("image"),
            rois_file=snakemake.input.get("rois") or snakemake.params.get("rois"),
            object_files=list(filter(None, map(snakemake.input.get, ("phantom", *OBJECT_INPUTS)))),
            declared_file=snakemake.input.get("declared"),
            physics_file=snakemake.input.get("physics"),
            record_file=snakemake.input.get("record"),
            name=snakemake.wildcards.get("recording"),
            log_file=snakemake.log[0],
            cache_folder=snakemake.params.get("cache_folder"),
            stated_model=from_mapping(FitSettings, snakemake.params.model),
            effect_names=snakemake.params.effects,
            same_material=snakemake.params.same_material,
            accuracy=snakemake.params.accuracy,
            thresholds=snakemake.params.matters,
            threads=snakemake.threads,
        )
