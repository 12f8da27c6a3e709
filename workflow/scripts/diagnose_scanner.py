"""Which physics the recordings of a scanner share: scanner.json, physics.yaml and the report."""

from collections.abc import Mapping, Sequence

import yaml

from virtual_phantom.base.errors import InputError
from virtual_phantom.diagnosis.preparation import ready
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.scanner.scanner import explain_scanner, scanned_in
from virtual_phantom.diagnosis.setup.verdict import VERDICTS, read_setup
from virtual_phantom.io.documents import SCANNER, write_document
from virtual_phantom.io.files import write_text
from virtual_phantom.report.scanner import page
from virtual_phantom.study.job import job, log


def main(
    *,
    phantom_file: str | None,
    setup_files: Sequence[str],
    diagnosis_file: str,
    physics_file: str,
    report_file: str,
    scanner: str,
    models: Mapping[str, Mapping],
    effects: Sequence[str],
    accuracy: Mapping[str, float],
    protocols: Mapping,
    judged_on: Sequence[str],
    threads: int,
) -> None:
    setups = {name: read_setup(path) for name, path in zip(models, setup_files, strict=True)}
    for name, setup in setups.items():
        if (kind := setup["kind"]) in VERDICTS:
            raise InputError(f"{name}: {VERDICTS[kind]}; see its own diagnosis, and mend that first")
    prepared = {
        name: ready(DiagnosisRequest.of(model, phantom_file, threads).located(setups[name]["location"]))[1]
        for name, model in models.items()
    }
    found = explain_scanner(
        scanner,
        prepared,
        effects,
        accuracy,
        protocols,
        {name: scanned_in(model["settings"]) for name, model in models.items()},
        judged_on,
    )
    fit = found.choice.chosen
    first = next(iter(fit.fits))
    physics = prepared[first].fitter.model.of_study(fit.physics, fit.fits[first].nuisance)
    text = f"# {found.content['sentence']}\n# An overlay of the study: snakemake --configfile physics.yaml\n"
    if protocol := found.content["recordings"][first]["protocol"]:
        text += f"# What recordings of one protocol have in common is as in protocol {protocol}.\n"
    overlay = {"physics": physics, "noise": {"model": "physical"}}
    write_text(text + yaml.safe_dump(overlay, sort_keys=False), physics_file)
    write_text(page(found.content), report_file)
    write_document(found.content, diagnosis_file, SCANNER)
    log.info("%s", found.content["sentence"])
    print(found.content["sentence"])


if "snakemake" in globals():
    with job(snakemake):
        main(
            phantom_file=snakemake.input.get("phantom"),
            setup_files=snakemake.input.setups,
            diagnosis_file=snakemake.output.diagnosis,
            physics_file=snakemake.output.physics,
            report_file=snakemake.output.report,
            scanner=snakemake.wildcards.scanner,
            models=snakemake.params.models,
            effects=snakemake.params.effects,
            accuracy=snakemake.params.accuracy,
            protocols=snakemake.params.protocols,
            judged_on=snakemake.params.judged_on,
            threads=snakemake.threads,
        )
