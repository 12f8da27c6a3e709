"""Which physics the recordings of a scanner share: scanner.json, physics.yaml and the report."""

import yaml

from virtual_phantom.base.errors import InputError
from virtual_phantom.diagnosis.preparation import ready
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.scanner.scanner import explain_scanner, scanned_in
from virtual_phantom.diagnosis.setup.verdict import VERDICTS, read_setup
from virtual_phantom.io.documents import SCANNER, write_document
from virtual_phantom.io.files import write_text
from virtual_phantom.report.scanner import page
from virtual_phantom.study.job import job

with job(snakemake) as log:
    params, given, output = snakemake.params, snakemake.input, snakemake.output
    setups = {name: read_setup(path) for name, path in zip(params.models, given.setups, strict=True)}
    for name, setup in setups.items():
        if (kind := setup["kind"]) in VERDICTS:
            raise InputError(f"{name}: {VERDICTS[kind]}; see its own diagnosis, and mend that first")
    prepared = {
        name: ready(
            DiagnosisRequest.of(model, given.get("phantom"), snakemake.threads).located(setups[name]["location"])
        )[1]
        for name, model in params.models.items()
    }
    found = explain_scanner(
        snakemake.wildcards.scanner,
        prepared,
        params.effects,
        params.accuracy,
        params.protocols,
        {name: scanned_in(model["settings"]) for name, model in params.models.items()},
        params.judged_on,
    )
    fit = found.choice.chosen
    first = next(iter(fit.fits))
    physics = prepared[first].fitter.model.of_study(fit.physics, fit.fits[first].nuisance)
    text = f"# {found.content['sentence']}\n# An overlay of the study: snakemake --configfile physics.yaml\n"
    if protocol := found.content["recordings"][first]["protocol"]:
        text += f"# What recordings of one protocol have in common is as in protocol {protocol}.\n"
    overlay = {"physics": physics, "noise": {"model": "physical"}}
    write_text(text + yaml.safe_dump(overlay, sort_keys=False), output.physics)
    write_text(page(found.content), output.report)
    write_document(found.content, output.diagnosis, SCANNER)
    log.info("%s", found.content["sentence"])
    print(found.content["sentence"])
