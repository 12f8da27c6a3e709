"""Choose the effects that explain a recording, and say it: diagnosis.json, physics.yaml, maps and the report."""

from dataclasses import replace

from virtual_phantom.base.streams import Branch
from virtual_phantom.diagnosis.core.attribute import choose, trial, trials
from virtual_phantom.diagnosis.core.locate import ALPHA
from virtual_phantom.diagnosis.core.store import RESIDUAL_MAPS, read_trial, write_diagnosis
from virtual_phantom.diagnosis.core.verdict import diagnose
from virtual_phantom.diagnosis.core.verified import Physics, stated, verified
from virtual_phantom.diagnosis.images.compared_regions import Scanned
from virtual_phantom.diagnosis.projections.prepared import with_noise_of
from virtual_phantom.diagnosis.projections.reconstructed import agreement_of_recording
from virtual_phantom.diagnosis.projections.setting import ready
from virtual_phantom.report.diagnosis import page, residual_maps
from virtual_phantom.statistics.proof_record import read, with_coverage
from virtual_phantom.study.job import job

with job(snakemake) as log:
    params, given, output = snakemake.params, snakemake.input, snakemake.output
    recording, prepared = ready(**params.model, phantom=given.get("phantom"), threads=snakemake.threads)
    effects = params.effects
    if "baseline" in given.keys():
        baseline = read_trial(given.baseline)
        singles = {name: read_trial(path) for name, path in zip(effects, given.candidates, strict=True)}
    else:
        baseline = trial(prepared.fitter, ())
        tasks = [((name,), baseline, baseline) for name in effects]
        singles = dict(zip(effects, trials(prepared.fitter, tasks, snakemake.threads), strict=True))
    if "physics" in given.keys():
        physics = Physics.read(given.physics)
        choice = verified(prepared.fitter, baseline, physics, params.same_material)
        correlated = with_noise_of(prepared, choice.chosen.fit)
        if correlated is not prepared:
            prepared, baseline = correlated, trial(correlated.fitter, ())
            choice = verified(prepared.fitter, baseline, physics, params.same_material)
        found = diagnose(recording.name, prepared, choice)
        found = replace(found, content=stated(found.content, physics))
    else:
        choice = choose(prepared.fitter, baseline, singles, snakemake.threads, params.accuracy)
        correlated = with_noise_of(prepared, choice.chosen.fit)
        if correlated is not prepared:  # all models by the new likelihood, so that they compare
            prepared, baseline = correlated, trial(correlated.fitter, ())
            tasks = [((name,), baseline, baseline) for name in effects]
            singles = dict(zip(effects, trials(prepared.fitter, tasks, snakemake.threads), strict=True))
            choice = choose(prepared.fitter, baseline, singles, snakemake.threads, params.accuracy)
        found = diagnose(recording.name, prepared, choice)
    if "record" in given.keys():
        found = replace(found, content=with_coverage(found.content, read(given.record)))
    scanned = None
    if "phantom" in given.keys():
        scanned = Scanned.read(given.phantom, given.image, given.rois)
    elif "mask" in given.keys():
        scanned = Scanned.of_mask(given.mask)
    table = agreement_of_recording(
        recording, prepared, found.choice, params.model, Branch.AGREEMENT, scanned, snakemake.threads
    )
    found.content["agreement"] = table
    fit = found.choice.chosen.fit
    overlay = {"physics": prepared.fitter.model.of_study(fit.physics, fit.nuisance), "noise": {"model": "physical"}}
    shown = residual_maps(found, prepared)
    maps = {place.domain: place.map for place in found.before} | dict(zip(RESIDUAL_MAPS, shown, strict=True))
    write_diagnosis(output, found.content, overlay, page(found, prepared, ALPHA, shown), maps)
    log.info("%s", found.content["sentence"])
    print(found.content["sentence"])
