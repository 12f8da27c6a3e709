"""The description of a recording of projections, checked, and what is said of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ...io.volumes import read_nifti
from ...recordings.images import ImagesRecording
from ...recordings.projections import ProjectionsRecording
from ..fitting.nuisance import PLACE, SURE, nuisances
from ..projections.observed import Scans, scans
from ..request import DiagnosisRequest
from ..scanned_object import scene_of
from .finding import AS_STATED, DESCRIPTION, MOST, Finding, find
from .mismatch import Comparison
from .orientation import OrientationFound, orientation
from .repeats import copies, odd_ones
from .white_field import wrong_illumination


@dataclass(frozen=True)
class SetUp:
    """What was found.

    Attributes
    ----------
    kind : {"as stated", "description", "object", "empty"}
    mistakes : dict of str to str
        {mistake: what to change}.
    alike : tuple of str
        Mistakes that this object could not show.
    share_stated, share : float
        Of the variance of line integrals, what the description leaves as it stands, and as it should be.
    location : dict of str to float
        As Finding.location.
    """

    kind: str
    mistakes: Mapping[str, str]
    alike: tuple[str, ...]
    share_stated: float
    share: float
    comparison: Comparison = field(repr=False)
    finding: Finding = field(repr=False)
    location: Mapping[str, float] = field(default_factory=dict)

    @property
    def content(self) -> dict:
        """For diagnosis.json and the jobs that wait for it."""
        return {
            "of": "line integrals",
            "kind": self.kind,
            "mistakes": dict(self.mistakes),
            "alike": list(self.alike),
            "share_stated": self.share_stated,
            "share": self.share,
            "location": dict(self.location),
        }

    def maps(self) -> tuple[np.ndarray, np.ndarray]:
        """Residuals of the scan as it is described, and as it should be, shape (views, columns)."""
        return self.comparison.residual(self.finding.stated), self.comparison.residual(self.finding.best)


def set_up(recording: ProjectionsRecording | ImagesRecording, asked: DiagnosisRequest) -> SetUp | OrientationFound:
    """Check how a recording is described."""
    if isinstance(recording, ImagesRecording):
        phantom = read_nifti(asked.phantom)
        repeats = np.stack([one.array for one in recording.repeats])
        # The images' centre is taken for the isocentre.
        grid = replace(recording.grid, centre_mm=(0.0, 0.0, 0.0))
        return orientation(repeats, phantom.array, phantom.grid, grid)
    taken = scans(recording.repeats)
    known = {one.name: SURE * one.sd for one in nuisances(0.0, 1.0, asked.settings.alignment)}
    reach = {name: known[name] for name in (*PLACE, "scale")}
    comparison = Comparison(scene_of(asked), taken.repeats, taken.usable, MOST, reach, asked.settings.location)
    scan = recording.document.content["scan"]
    finding = find(comparison, scan, recording.log, float(taken.repeats[:, taken.usable].max()))
    mistakes = {}
    if finding.kind == DESCRIPTION:
        mistakes[finding.best.name] = finding.best.line
    if finding.kind in (AS_STATED, DESCRIPTION):
        mistakes |= _of_data(recording, taken)
    return SetUp(
        DESCRIPTION if mistakes else finding.kind,
        mistakes,
        tuple(dict.fromkeys(one.name for one in finding.alike)),
        finding.stated.share,
        finding.share,
        comparison,
        finding,
        {} if mistakes else finding.location,
    )


def _of_data(recording: ProjectionsRecording, taken: Scans) -> dict[str, str]:
    """Mistakes that repeats and the white field show."""
    names = [str(path.name) for path in recording.document.repeats]
    mistakes = {}
    for first, second in copies(taken.repeats):
        mistakes["copied repeat"] = f"repeats: take out {names[second]}, which holds the same numbers as {names[first]}"
    if not mistakes:
        for which, _ in odd_ones(taken.repeats, taken.usable):
            mistakes["a repeat of another scan"] = f"repeats: take out {names[which]}, or compare it with the others"
    lit = wrong_illumination(taken.white, recording.geometry, recording.scan)
    if lit is not None:
        mistakes["illumination"] = f"scan.illumination: {lit[0]} (the white field falls off like that)"
    return mistakes
