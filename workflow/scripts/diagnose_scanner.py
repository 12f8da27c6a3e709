"""Diagnose the recordings of a scanner together: scanner.json, physics.yaml and the report."""

from virtual_phantom.base.errors import InputError
from virtual_phantom.diagnosis.preparation import prepare_recording
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.scanner.scanner import run_scanner_diagnosis, scanned_in
from virtual_phantom.diagnosis.setup.check import read_setup
from virtual_phantom.diagnosis.verdict_text import SETUP_VERDICTS, console_text
from virtual_phantom.report.scanner import write_scanner_results
from virtual_phantom.study.job import job

with job(snakemake) as log:
    params, given = snakemake.params, snakemake.input
    prepared = {}
    for (name, model), path in zip(params.models.items(), given.setups, strict=True):
        setup = read_setup(path)
        if (kind := setup["kind"]) in SETUP_VERDICTS:
            raise InputError(f"{name}: {SETUP_VERDICTS[kind]}; see its own diagnosis, and correct that first")
        request = DiagnosisRequest.of(model, given.get("phantom"), snakemake.threads).located(setup["location"])
        _, prepared[name] = prepare_recording(request)
    found = run_scanner_diagnosis(
        snakemake.wildcards.scanner,
        prepared,
        params.effects,
        params.accuracy,
        params.protocols,
        {name: scanned_in(model["settings"]) for name, model in params.models.items()},
        params.judged_on,
    )
    write_scanner_results(found, prepared, snakemake.output)
    log.info("%s", console_text(found.content))
    print(console_text(found.content))
