"""Files and settings of the blind validation (target `proof`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from ..base.errors import InputError
from ..base.proof_settings import ProofProtocol, ProofSettings
from ..base.settings import to_mapping
from ..config.dependencies import resource
from ..config.outputs import Files
from ..config.plan import Plan
from ..diagnosis.candidate_effects import candidates
from ..diagnosis.settings import FitSettings, RecordingSettings
from ..proof.hiding.objects import OBJECTS
from ..proof.hiding.suite import (
    PHANTOMS,
    PROTOCOLS,
    cases,
    check_recordings,
    check_tried,
    kind_of,
    phantom_of,
    views_of,
)


@dataclass(frozen=True)
class Proof:
    """Blind validation of one configuration.

    Attributes
    ----------
    cases : tuple of str
        Names of the cases.
    tried : mapping of str to list of str
        {kind of recording: candidate effects}.
    """

    plan: Plan
    files: Files
    cases: tuple[str, ...]
    tried: Mapping[str, list[str]]

    @classmethod
    def read(cls, plan: Plan, files: Files) -> Proof:
        """Return the blind validation of a configuration.

        Raises
        ------
        InputError
            If the settings do not give a set of cases.
        """
        settings = plan.study.proof
        named = tuple(cases(settings))
        check_tried(settings)
        check_recordings(settings.recordings, plan.study.diagnosis.recordings)
        stated = _diagnosed(settings.scan)
        try:
            of_images = candidates(replace(stated, effects=settings.images.tried), "images")
        except InputError as error:
            raise InputError(str(error).replace("diagnosis.effects", "proof.images.tried")) from None
        return cls(plan, files, named, {"projections": candidates(stated), "images": of_images})

    @property
    def settings(self) -> ProofSettings:
        """Section `proof` of the configuration."""
        return self.plan.study.proof

    @property
    def hiding(self) -> dict:
        """Settings that determine the hidden effects."""
        settings = to_mapping(self.settings)
        return {
            **_parts(settings, "seed", "effects", "strengths", "none", "pairs", "unknown", "unknown_kinds"),
            "images": _parts(settings["images"], "strengths", "effects"),
            "scan": _parts(settings["scan"], "rows"),
        }

    def scan_settings(self, case: str) -> dict:
        """Return the settings of the recordings of a case, apart from its hidden effects."""
        settings = to_mapping(self.settings)
        shared = _parts(settings, "seed", "scan", "held_out_protocol")
        of_images = {"images": _parts(settings["images"], "views_times")}
        return shared | (of_images if self._kind(case) == "images" else {})

    def all(self, name: str) -> list[str]:
        """Return the paths of an output of all cases."""
        return [self.files(name, case=case) for case in self.cases]

    def times(self) -> list[str]:
        """Return the benchmark files of the jobs of all cases."""
        jobs = ("scan", "diagnosis", "elsewhere")
        return [self.files.benchmark(f"proof/{job}_{case}") for job in jobs for case in self.cases]

    def real(self, name: str) -> list[str]:
        """Return the paths of an output of the diagnoses of all real recordings in the report."""
        return [self.files(name, recording=recording) for recording in self.settings.recordings]

    @property
    def phantoms(self) -> tuple[str, ...]:
        """Names of the scanned phantoms, which the cases use in turn."""
        return PHANTOMS

    def layout(self, phantom: str) -> str:
        """Return the layout file of a phantom."""
        return resource(OBJECTS[phantom].layout)

    def fine_phantom(self, case: str) -> str:
        """Return the fine phantom that a case scans."""
        return self.files("proof_fine", phantom=phantom_of(case))

    def known_phantom(self, case: str) -> dict[str, str]:
        """Return the description of the phantom of a case for its diagnosis."""
        phantom = phantom_of(case)
        image = self.files("proof_image", phantom=phantom)
        return {
            "phantom": image,
            "image": image,
            "rois": self.files("proof_table", phantom=phantom),
            "masks": self.files("proof_rois", phantom=phantom),
        }

    def tried_on(self, case: str) -> list[str]:
        """Return the candidate effects of a case."""
        return self.tried[self._kind(case)]

    def model(self, case: str) -> FitSettings:
        """Return the settings that the fits of a case depend on."""
        return self._model(self.files("proof_recording", case=case), case, "scan")

    def held_out_model(self, case: str) -> FitSettings:
        """Return the settings that the fits of a case's scan with the held-out protocol depend on."""
        return self._model(self.files("proof_held_out", case=case), case, "held_out_protocol")

    def _model(self, folder: str, case: str, protocol: str) -> FitSettings:
        study, settings, kind = self.plan.study, self.settings, self._kind(case)
        phantom, taken, simulated = OBJECTS[phantom_of(case)], getattr(settings, protocol), None
        if kind == "images":
            views = dict(zip(PROTOCOLS, views_of(kind, settings), strict=True))[protocol]
            detector = settings.scan.columns, settings.scan.rows
            simulated = phantom.protocol(*detector, views, taken.rotation_time_ms, "cpu")
        return FitSettings(
            folder=folder,
            settings=_diagnosed(taken),
            mu_water_per_mm=study.mu_water_per_mm,
            materials=phantom.stated,
            seed=study.seed,
            protocol=simulated,
        )

    def _kind(self, case: str) -> str:
        return kind_of(case, self.settings)


def _diagnosed(taken: ProofProtocol) -> RecordingSettings:
    """Return the settings of the diagnosis of a scan."""
    return RecordingSettings(samples=2, view_step=1, alignment={}, nominal_photons=taken.photons)


def _parts(section: Mapping, *keys: str) -> dict:
    """Return some keys of a section: a change of other keys does not rerun the job."""
    return {key: section[key] for key in keys if key in section}
