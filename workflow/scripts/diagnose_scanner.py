"""Diagnose the recordings of a scanner together: scanner.json, physics.yaml and the report."""

from collections.abc import Mapping, Sequence

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.settings import from_mapping
from virtual_phantom.diagnosis.preparation import prepare_recording
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.scanner.scanner import run_scanner_diagnosis, scanned_in
from virtual_phantom.diagnosis.settings import FitSettings
from virtual_phantom.diagnosis.setup.check import read_setup
from virtual_phantom.diagnosis.verdict_text import SETUP_VERDICTS, console_text
from virtual_phantom.report.scanner import ScannerFiles, write_scanner_results
from virtual_phantom.study.job import job, log


def main(
    *,
    phantom_file: str | None,
    setup_files: Sequence[str],
    output: ScannerFiles,
    scanner: str,
    models: Mapping[str, FitSettings],
    effects: Sequence[str],
    accuracy: Mapping[str, float],
    protocols: Mapping,
    test_recordings: Sequence[str],
    threads: int,
) -> None:
    setups = {name: read_setup(path) for name, path in zip(models, setup_files, strict=True)}
    for name, setup in setups.items():
        if (kind := setup["kind"]) in SETUP_VERDICTS:
            raise InputError(f"{name}: {SETUP_VERDICTS[kind]}; see its own diagnosis, and correct that first")
    prepared = {}
    for name, model in models.items():
        request = DiagnosisRequest.of(model, phantom_file, threads).located(setups[name]["location"])
        _, prepared[name] = prepare_recording(request)
    objects = {name: scanned_in(model.settings) for name, model in models.items()}
    found = run_scanner_diagnosis(scanner, prepared, effects, accuracy, protocols, objects, test_recordings)
    write_scanner_results(found, prepared, output)
    log.info("%s", console_text(found.content))
    print(console_text(found.content))


if "snakemake" in globals():
    with job(snakemake):
        main(
            phantom_file=snakemake.input.get("phantom"),
            setup_files=snakemake.input.setups,
            output=snakemake.output,
            scanner=snakemake.wildcards.scanner,
            models=from_mapping(dict[str, FitSettings], snakemake.params.models),
            effects=snakemake.params.effects,
            accuracy=snakemake.params.accuracy,
            protocols=snakemake.params.protocols,
            test_recordings=snakemake.params.test_recordings,
            threads=snakemake.threads,
        )
