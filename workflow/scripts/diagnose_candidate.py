"""Fit one effect, or the alignment alone, to a recording."""

from virtual_phantom.diagnosis.core.asked import Asked
from virtual_phantom.diagnosis.core.attribute import trial
from virtual_phantom.diagnosis.core.store import read_trial, write_trial
from virtual_phantom.diagnosis.ready import ready
from virtual_phantom.diagnosis.setup.verdict import NOT_FITTED, VERDICTS, read_setup
from virtual_phantom.io.files import write_text
from virtual_phantom.study.job import job

with job(snakemake) as log:
    params, given = snakemake.params, snakemake.input
    effect = params.effect
    if read_setup(given.setup)["kind"] in VERDICTS:
        write_text(NOT_FITTED, snakemake.output[0])
        log.info("%s: not fitted, as the description of the recording is wrong", effect or "alignment")
    else:
        asked = Asked.of(params.model, given.get("phantom"), snakemake.threads)
        _, prepared = ready(asked)
        baseline = read_trial(given.baseline) if effect else None
        found = trial(prepared.fitter, (effect,) if effect else (), baseline, baseline)
        write_trial(found, snakemake.output[0])
        log.info("%s: log score %.1f, p %.3g, %s", effect or "alignment", found.score, found.p, found.fit.physics)
