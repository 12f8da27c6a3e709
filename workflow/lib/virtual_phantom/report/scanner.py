"""Report of the joint diagnosis of a scanner: shared physics, and the fit of each recording by the others."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Protocol

from ..diagnosis.residuals.dataset import Prepared
from ..diagnosis.result_files import write_overlay
from ..diagnosis.scanner.scanner import ScannerDiagnosis
from ..figures import scanner as figures
from ..io.documents import SCANNER, write_document
from ..io.files import write_text
from .html import COLORS, OTHER_COLOR, number, picture, render, within


class ScannerFiles(Protocol):
    """Paths of the files that a scanner's diagnosis writes."""

    diagnosis: str
    physics: str
    report: str


def write_scanner_results(found: ScannerDiagnosis, prepared: Mapping[str, Prepared], output: ScannerFiles) -> None:
    """Write scanner.json, physics.yaml and the report."""
    content, fit = found.content, found.choice.chosen
    first = next(iter(fit.fits))
    physics = prepared[first].fitter.model.in_study_units(fit.physics, fit.fits[first].nuisance)
    remarks = []
    if protocol := content["recordings"][first]["protocol"]:
        remarks.append(f"Parameters of a protocol are those of protocol {protocol}.")
    write_overlay(content, {"physics": physics, "noise": {"model": "physical"}}, output.physics, remarks)
    write_text(scanner_page(content), output.report)
    write_document(content, output.diagnosis, SCANNER)


def scanner_page(content: dict) -> str:
    """Return the report as HTML, from the content of scanner.json."""
    removed = picture(figures.draw_recordings(content["recordings"]))
    colour = COLORS.get(content["verdict"], OTHER_COLOR)
    filters = {"number": number, "within": within}
    shown = {kind: _parameters(content["recordings"].values(), kind) for kind in ("alone", "own")}
    shown |= {"removed": removed, "colour": colour}
    return render("scanner", filters, d=content | {"recording": content["scanner"]}, **shown)


def _parameters(recordings: Iterable[Mapping], kind: str) -> list[tuple[str, str]]:
    """Return every (effect, parameter) of recordings under this key of scanner.json."""
    return list(
        dict.fromkeys(
            (effect, key) for recording in recordings for effect, keys in recording[kind].items() for key in keys
        )
    )
