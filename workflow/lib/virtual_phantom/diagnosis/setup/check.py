"""Check of the scan set-up before any effect is fitted: description of the scan, scanned object, and data."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...base.errors import refusing
from ...io.files import read_text, write_text
from ...io.volumes import read_nifti
from ...recordings.images import ImagesRecording
from ...recordings.projections import ProjectionsRecording
from ...recordings.recording import Recording
from ..assumptions import object_text, scan_text
from ..fitting.nuisance import PLACE, PRIOR_BOUND_SD, nuisances
from ..projections.lost_rays import check_scans
from ..projections.observed import Scans, scans
from ..projections.own_simulation import scene_of_scan
from ..request import DiagnosisRequest
from ..verdict.verdict import Diagnosis, unfitted_diagnosis
from ..verdict_text import SETUP_VERDICTS, setup_lines
from .data_checks import copied_repeats, outlying_repeat, wrong_illumination
from .finding import AS_STATED, DESCRIPTION, MOST, SetupResult, find
from .located import locate
from .mismatch import Comparison
from .orientation import orientation

# Content of a set-up that is not checked.
NOT_CHECKED = {
    "of": "line integrals",
    "kind": AS_STATED,
    "mistakes": {},
    "alike": [],
    "share_stated": 0.0,
    "share": 0.0,
    "location": {},
}


def check_setup(recording: Recording, request: DiagnosisRequest) -> SetupResult | None:
    """Compare a recording with its description; None if the check is switched off or not possible.

    Raises
    ------
    InputError
        For projections with too few views, or too few rays with a signal.
    """
    if not request.settings.check_setup:
        return None
    if isinstance(recording, ProjectionsRecording):
        return _check_projections(recording, request)
    return _check_images(recording, request) if isinstance(recording, ImagesRecording) else None


def _check_images(recording: ImagesRecording, request: DiagnosisRequest) -> SetupResult | None:
    if request.settings.simulation is not None:
        return None  # in the recording's geometry
    if not request.settings.of_phantom:
        return locate(recording, request)
    phantom = read_nifti(request.phantom)
    repeats = np.stack([repeat.array for repeat in recording.repeats])
    # The center of the images is assumed to be the isocenter.
    grid = replace(recording.grid, centre_mm=(0.0, 0.0, 0.0))
    return orientation(repeats, phantom.array, phantom.grid, grid)


def _check_projections(recording: ProjectionsRecording, request: DiagnosisRequest) -> SetupResult:
    taken = scans(recording.repeats)
    check_scans(taken, str(recording.document.path))
    known = {number.name: number.sd for number in nuisances(0.0, 1.0, request.alignment(recording.nominal))}
    reach = {name: PRIOR_BOUND_SD * known[name] for name in (*PLACE, "scale")}
    location, unchecked = request.settings.location, recording.document.content.get("not_checked", ())
    comparison = Comparison(
        scene_of_scan(request, recording), taken.repeats, taken.usable, MOST, reach, location, unchecked
    )
    scan = recording.document.content["scan"]
    finding = find(comparison, scan, recording.log, float(taken.repeats[:, taken.usable].max()))
    mistakes = {}
    if finding.kind == DESCRIPTION:
        mistakes[finding.best.name] = finding.best.line
    if finding.kind in (AS_STATED, DESCRIPTION):
        mistakes |= _mistakes_of_data(recording, taken)
    kind, location = (DESCRIPTION, {}) if mistakes else (finding.kind, finding.location)
    alike = tuple(dict.fromkeys(mismatch.name for mismatch in finding.alike))
    maps = comparison.residual(finding.stated), comparison.residual(finding.best)
    shares = finding.stated.share, finding.share
    return SetupResult("line integrals", kind, mistakes, alike, *shares, maps, location)


def _mistakes_of_data(recording: ProjectionsRecording, taken: Scans) -> dict[str, str]:
    """Return the mistakes that the repeats and the white field show."""
    names = [str(path.name) for path in recording.document.repeats]
    mistakes = {}
    if copies := copied_repeats(taken.repeats):
        removed = (f"{names[copy]}, which is a copy of {names[one]}" for copy, one in copies.items())
        mistakes["copied repeat"] = f"repeats: remove {'; and '.join(removed)}"
    if not mistakes and (which := outlying_repeat(taken.repeats, taken.usable)) is not None:
        mistakes["a repeat of another scan"] = f"repeats: remove {names[which]}, or compare it with the others"
    if lit := wrong_illumination(taken.white, recording.geometry, recording.scan):
        mistakes["illumination"] = f"scan.illumination: {lit} (from the shape of the white field)"
    return mistakes


def setup_diagnosis(found: SetupResult, recording: Recording, request: DiagnosisRequest) -> Diagnosis:
    """Return the diagnosis of a recording whose set-up or object is wrong; no effect is fitted."""
    scanned = "the study's phantom" if request.settings.of_phantom else object_text(request)
    lines = setup_lines(found.content, scanned)
    modelled = {"object": object_text(request), "scan": scan_text(request, recording)}
    verdict = SETUP_VERDICTS[found.kind]
    return unfitted_diagnosis(recording.name, verdict, lines, found, modelled=modelled, setup=found.content)


def write_setup(content: Mapping, path: str | Path) -> None:
    """Write SetupResult.content, or NOT_CHECKED."""
    write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", path)


def read_setup(path: str | Path) -> dict:
    """Read what `write_setup` wrote.

    Raises
    ------
    InputError
        If the file is missing or has other content.
    """
    with refusing(f"{path}: holds no check of the scan set-up", OSError, ValueError, KeyError, advice="make it again"):
        content = json.loads(read_text(path))
        return {key: content[key] for key in NOT_CHECKED}
