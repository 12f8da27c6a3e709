"""Choose the effects that explain a recording, and say it: diagnosis.json, physics.yaml, maps and the report."""

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
from virtual_phantom.diagnosis.selection.store import RESIDUAL_MAPS, write_diagnosis
from virtual_phantom.diagnosis.selection.transfer import Physics, with_declared
from virtual_phantom.diagnosis.setup.recorded import set_up
from virtual_phantom.diagnosis.setup.verdict import NOT_LOOKED, VERDICTS, doubted, verdict, with_location, write_setup
from virtual_phantom.diagnosis.wording import PRACTICAL
from virtual_phantom.recordings.reading import load
from virtual_phantom.report.diagnosis import page, residual_maps
from virtual_phantom.report.setup import setup_page
from virtual_phantom.statistics.proof_record import read, with_coverage
from virtual_phantom.study.costs.forecast import forecast_line
from virtual_phantom.study.fit_cache_key import fit_cache
from virtual_phantom.study.job import job
from virtual_phantom.study.progress.job_status import status_writer

with job(snakemake) as log:
    params, given, output = snakemake.params, snakemake.input, snakemake.output
    model = with_declared(params.model, given.get("declared"))
    asked = DiagnosisRequest.of(model, given.get("phantom"), snakemake.threads)
    effects = [name for name in params.effects if name not in asked.settings.baseline]
    recording = load(asked.folder)
    doubt = set_up(recording, asked) if doubted(recording, asked) else None
    setup = NOT_LOOKED if doubt is None else doubt.content
    if "setup" in output.keys():
        write_setup(setup, output.setup)
    if setup["kind"] in VERDICTS:
        content, shown = verdict(doubt, recording, asked), doubt.maps()
        write_diagnosis(output, content, {}, setup_page(content, *shown), dict(zip(RESIDUAL_MAPS, shown, strict=True)))
    else:
        stated, asked = asked.settings.location, asked.located(setup["location"])
        kept, how_far = None, DiagnosisProgress()
        if "kept" in params.keys():  # somebody waits for it, as nobody does for a case of the proof
            name = snakemake.wildcards.recording
            how_far = DiagnosisProgress(status_writer(snakemake.log[0], name))
            scanned = filter(None, (given.get(what) for what in ("phantom", "mask", "labels", "shapes")))
            placed = {**model, "settings": {**model["settings"], "location": dict(asked.settings.location)}}
            kept = fit_cache(params.kept, placed, [*given.files, *scanned])
            if "physics" not in given.keys() and asked.protocol is None:
                shape, phantom = recording.geometry.shape, given.get("phantom")
                if line := forecast_line(name, model, shape, len(effects), snakemake.threads, phantom):
                    log.info("%s", line)
                    print(line, flush=True)
        _, prepared = ready(asked, recording)
        if "physics" in given.keys():
            physics = Physics.read(given.physics)
            prepared, found = hold_against(recording.name, prepared, physics, params.same_material, kept)
        else:
            processes = snakemake.threads
            differ = asked.settings.object_may_differ
            prepared, found = explain(
                recording.name, prepared, effects, params.accuracy, processes, kept, how_far, differ
            )
        if "record" in given.keys():
            found = replace(found, content=with_coverage(found.content, read(given.record)))
        tried = [] if "physics" in given.keys() else effects
        found.content["modelled"] = described(asked, recording, prepared, tried)
        scanned = None
        if "phantom" in given.keys():
            scanned = Scanned.read(given.phantom, given.image, given.rois)
        elif "mask" in given.keys():
            scanned = Scanned.of_mask(given.mask)
        elif "labels" in given.keys():
            scanned = Scanned.of_labels(labelled_object(asked.settings.object), asked.mu_water_per_mm)
        elif "shapes" in given.keys():
            shaped = shaped_object(asked.settings.object)
            scanned = Scanned.of_shapes(shaped, recording.geometry, asked.mu_water_per_mm)
        practice = params.matters is not None
        table = agreement(recording, prepared, found.choice, asked, Branch.AGREEMENT, scanned, practice)
        how_far.reached(COMPARED)
        found = replace(found, content=found.content | {"agreement": table})
        if practice:
            found = replace(found, content=in_practice(found.content, params.matters))
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
