"""Open the seals of the blind test and score it: score.json, the page, the confusion matrix and an example."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from virtual_phantom.figures import before_after, confusion, style
from virtual_phantom.io.documents import SCORE, write_document
from virtual_phantom.io.files import write_text
from virtual_phantom.proof.hiding import seal
from virtual_phantom.proof.scoring.collect import collect
from virtual_phantom.proof.scoring.example import example, in_words, residual_maps
from virtual_phantom.proof.scoring.real import minutes, row
from virtual_phantom.proof.scoring.registration import assessed, log_run
from virtual_phantom.proof.scoring.score import score
from virtual_phantom.report.proof import blind_validation_page
from virtual_phantom.study.job import job, log


def main(
    *,
    sealed: Sequence[str],
    seals: str,
    verdicts: Sequence[str],
    diagnoses: Sequence[str],
    others: Sequence[str],
    times: Sequence[str],
    real_diagnoses: Sequence[str],
    case_maps: Sequence[str],
    real_maps: Sequence[str],
    registration_file: str,
    runs_file: str,
    score_file: str,
    page_file: str,
    confusion_files: list[str],
    example_files: list[str],
    suite: Mapping,
    registered_settings: Mapping,
) -> None:
    cases = collect(sealed, seals, verdicts, diagnoses, others)
    real = [row(path) for path in real_diagnoses]
    registration = assessed(
        seal.read(registration_file), seals, runs_file, [case.name for case in cases], registered_settings
    )
    found = score(cases, minutes(times), real, suite, registration)
    maps = {Path(folder).parent.name: residual_maps(folder) for folder in [*case_maps, *real_maps]}
    reports = {
        Path(path).parent.name: Path(os.path.relpath(Path(path).with_name("report.html"), Path(page_file).parent))
        for path in [*diagnoses, *real_diagnoses]
    }
    write_document(found, score_file, SCORE)
    write_text(blind_validation_page(found, maps, {case: path.as_posix() for case, path in reports.items()}), page_file)
    style.save(confusion.draw(found["confusion"]), confusion_files)
    shown = example(cases)
    figure = before_after.draw(*maps[shown.name], shown.kind, *in_words(shown))
    style.save(figure, example_files)
    log_run(runs_file, "scored", registration, len(cases))
    for target in found["targets"]:
        log.info("%s: %s, target %s %s", target["what"], target["value"], target["sense"], target["target"])


if "snakemake" in globals():
    with job(snakemake):
        main(
            sealed=snakemake.input.sealed,
            seals=snakemake.input.seals,
            verdicts=snakemake.input.verdicts,
            diagnoses=snakemake.input.diagnoses,
            others=snakemake.input.others,
            times=snakemake.input.times,
            real_diagnoses=snakemake.input.real,
            case_maps=snakemake.input.maps,
            real_maps=snakemake.input.real_maps,
            registration_file=snakemake.input.registration,
            runs_file=snakemake.params.runs,
            score_file=snakemake.output.score,
            page_file=snakemake.output.page,
            confusion_files=[snakemake.output.confusion_png, snakemake.output.confusion_pdf],
            example_files=[snakemake.output.example_png, snakemake.output.example_pdf],
            suite=snakemake.params.suite,
            registered_settings=snakemake.params.registered,
        )
