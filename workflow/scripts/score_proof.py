"""Open the seals of the blind test and score it: score.json, the page, the confusion matrix and an example."""

import os
from pathlib import Path

from virtual_phantom.figures import before_after, confusion, style
from virtual_phantom.io.documents import SCORE, write_document
from virtual_phantom.io.files import write_text
from virtual_phantom.proof.conceal.case import collect
from virtual_phantom.proof.score.example import example, in_words, residual_maps
from virtual_phantom.proof.score.real import minutes, row
from virtual_phantom.proof.score.score import score
from virtual_phantom.report.proof import blind_validation_page
from virtual_phantom.statistics.proof_record import read_proof_record
from virtual_phantom.study.job import job

with job(snakemake) as log:
    given, output = snakemake.input, snakemake.output
    cases = collect(given.sealed, given.seals, given.verdicts, given.diagnoses, given.others)
    real = [row(path) for path in given.real]
    found = score(cases, minutes(given.times), real, snakemake.params.suite, read_proof_record(given.record))
    maps = {Path(folder).parent.name: residual_maps(folder) for folder in [*given.maps, *given.real_maps]}
    reports = {
        Path(path).parent.name: Path(os.path.relpath(Path(path).with_name("report.html"), Path(output.page).parent))
        for path in [*given.diagnoses, *given.real]
    }
    write_document(found, output.score, SCORE)
    write_text(
        blind_validation_page(found, maps, {case: path.as_posix() for case, path in reports.items()}), output.page
    )
    style.save(confusion.draw(found["confusion"]), [output.confusion_png, output.confusion_pdf])
    shown = example(cases)
    figure = before_after.draw(*maps[shown.name], shown.kind, *in_words(shown))
    style.save(figure, [output.example_png, output.example_pdf])
    for target in found["targets"]:
        log.info("%s: %s, target %s %s", target["what"], target["value"], target["sense"], target["target"])
