"""Choose the effects that explain a recording, and say it: diagnosis.json, physics.yaml, maps and the report."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from virtual_phantom.base.streams import Branch
from virtual_phantom.diagnosis.assumptions import described
from virtual_phantom.diagnosis.comparison.regions import Scanned
from virtual_phantom.diagnosis.comparison.relevance_thresholds import in_practice
from virtual_phantom.diagnosis.preparation import agreement, ready
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.residuals.residual_tests import ALPHA
from virtual_phantom.diagnosis.run import explain, hold_against
from virtual_phantom.diagnosis.scanned_object import labelled_object, shaped_object
from virtual_phantom.diagnosis.selection.progress import COMPARED, DiagnosisProgress
from virtual_phantom.diagnosis.selection.store import RESIDUAL_MAPS, DiagnosisFiles, write_diagnosis
from virtual_phantom.diagnosis.selection.transfer import Physics, with_declared
from virtual_phantom.diagnosis.setup.recorded import set_up
from virtual_phantom.diagnosis.setup.verdict import NOT_LOOKED, VERDICTS, doubted, verdict, with_location, write_setup
from virtual_phantom.diagnosis.wording import PRACTICAL
from virtual_phantom.recordings.reading import load
from virtual_phantom.report.diagnosis import page, residual_maps
from virtual_phantom.report.setup import setup_page
from virtual_phantom.statistics.proof_record import read, with_coverage
from virtual_phantom.study.costs.forecast import beforehand
from virtual_phantom.study.fit_cache_key import fit_cache
from virtual_phantom.study.job import job, log
from virtual_phantom.study.progress.said import saying


def main(
    *,
    output: DiagnosisFiles,
    setup_file: str | None,
    recording_files: Sequence[str],
    phantom_file: str | None,
    image_file: str | None,
    rois_file: str | None,
    mask_file: str | None,
    labels_file: str | None,
    shapes_file: str | None,
    declared_file: str | None,
    physics_file: str | None,
    record_file: str | None,
    name: str | None,
    log_file: str,
    cache_folder: str | None,
    stated_model: Mapping,
    effect_names: Sequence[str],
    same_material: bool,
    accuracy: Mapping[str, float],
    thresholds: Mapping | None,
    threads: int,
) -> None:
    model = with_declared(stated_model, declared_file)
    asked = DiagnosisRequest.of(model, phantom_file, threads)
    effects = [name for name in effect_names if name not in asked.settings.baseline]
    recording = load(asked.folder)
    doubt = set_up(recording, asked) if doubted(recording, asked) else None
    setup = NOT_LOOKED if doubt is None else doubt.content
    if setup_file:
        write_setup(setup, setup_file)
    if setup["kind"] in VERDICTS:
        content, shown = verdict(doubt, recording, asked), doubt.maps()
        write_diagnosis(output, content, {}, setup_page(content, *shown), dict(zip(RESIDUAL_MAPS, shown, strict=True)))
    else:
        stated, asked = asked.settings.location, asked.located(setup["location"])
        kept, how_far = None, DiagnosisProgress()
        if cache_folder:  # cases of the blind validation have none and report no progress
            how_far = DiagnosisProgress(saying(log_file, name))
            scanned = filter(None, (phantom_file, mask_file, labels_file, shapes_file))
            placed = {**model, "settings": {**model["settings"], "location": dict(asked.settings.location)}}
            kept = fit_cache(cache_folder, placed, [*recording_files, *scanned])
            if physics_file is None and asked.protocol is None:
                shape = recording.geometry.shape
                if line := beforehand(name, model, shape, len(effects), threads, phantom_file):
                    log.info("%s", line)
                    print(line, flush=True)
        _, prepared = ready(asked, recording)
        if physics_file:
            physics = Physics.read(physics_file)
            prepared, found = hold_against(recording.name, prepared, physics, same_material, kept)
        else:
            differ = asked.settings.object_may_differ
            prepared, found = explain(recording.name, prepared, effects, accuracy, threads, kept, how_far, differ)
        if record_file:
            found = replace(found, content=with_coverage(found.content, read(record_file)))
        tried = [] if physics_file else effects
        found.content["modelled"] = described(asked, recording, prepared, tried)
        scanned = None
        if phantom_file:
            scanned = Scanned.read(phantom_file, image_file, rois_file)
        elif mask_file:
            scanned = Scanned.of_mask(mask_file)
        elif labels_file:
            scanned = Scanned.of_labels(labelled_object(asked.settings.object), asked.mu_water_per_mm)
        elif shapes_file:
            shaped = shaped_object(asked.settings.object)
            scanned = Scanned.of_shapes(shaped, recording.geometry, asked.mu_water_per_mm)
        practice = thresholds is not None
        table = agreement(recording, prepared, found.choice, asked, Branch.AGREEMENT, scanned, practice)
        how_far.reached(COMPARED)
        found = replace(found, content=found.content | {"agreement": table})
        if practice:
            found = replace(found, content=in_practice(found.content, thresholds))
        if doubt is not None:
            found = replace(found, content=with_location(found.content, setup, stated))
        fit = found.choice.chosen.fit
        overlay = {"physics": prepared.fitter.model.of_study(fit.physics, fit.nuisance), "noise": {"model": "physical"}}
        if found.content["verdict"] == PRACTICAL:
            overlay = {}
        shown = residual_maps(found, prepared)
        maps = {place.domain: place.map for place in found.before} | dict(zip(RESIDUAL_MAPS, shown, strict=True))
        write_diagnosis(
            output, found.content, overlay, page(found, prepared, ALPHA, shown, scanned and scanned.fine), maps
        )
        content = found.content
    log.info("%s", content["sentence"])
    print(content["sentence"])


if "snakemake" in globals():
    with job(snakemake):
        main(
            output=snakemake.output,
            setup_file=snakemake.output.get("setup"),
            recording_files=snakemake.input.get("files", []),
            phantom_file=snakemake.input.get("phantom"),
            image_file=snakemake.input.get("image"),
            rois_file=snakemake.input.get("rois"),
            mask_file=snakemake.input.get("mask"),
            labels_file=snakemake.input.get("labels"),
            shapes_file=snakemake.input.get("shapes"),
            declared_file=snakemake.input.get("declared"),
            physics_file=snakemake.input.get("physics"),
            record_file=snakemake.input.get("record"),
            name=snakemake.wildcards.get("recording"),
            log_file=snakemake.log[0],
            cache_folder=snakemake.params.get("kept"),
            stated_model=snakemake.params.model,
            effect_names=snakemake.params.effects,
            same_material=snakemake.params.same_material,
            accuracy=snakemake.params.accuracy,
            thresholds=snakemake.params.matters,
            threads=snakemake.threads,
        )
