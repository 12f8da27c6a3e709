"""What the configuration asks of the proof, as its jobs take it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ..base.errors import InputError
from ..config.dependencies import resource
from ..config.outputs import Files
from ..config.plan import Plan
from ..diagnosis.candidate_effects import candidates
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
    """Of one configuration.

    Attributes
    ----------
    cases : tuple of str
        Their names.
    tried : mapping of str to list of str
        {kind of recording: the effects that are tried}.
    """

    plan: Plan
    files: Files
    cases: tuple[str, ...]
    tried: Mapping[str, list[str]]

    @classmethod
    def read(cls, plan: Plan, files: Files) -> Proof:
        """What a configuration asks for.

        Raises
        ------
        InputError
            For what no suite can be made of.
        """
        settings = plan.config["proof"]
        named = tuple(cases(settings))
        check_tried(settings)
        check_recordings(settings["recordings"], plan.config["diagnosis"]["recordings"])
        stated = {"nominal_photons": settings["scan"]["photons"]}
        try:
            of_images = candidates(stated | {"effects": settings["images"]["tried"]}, "images")
        except InputError as error:
            raise InputError(str(error).replace("diagnosis.effects", "proof.images.tried")) from None
        return cls(plan, files, named, {"projections": candidates(stated), "images": of_images})

    @property
    def settings(self) -> dict:
        """The section of the configuration."""
        return self.plan.config["proof"]

    @property
    def drawn(self) -> dict:
        """What is concealed depends on this alone."""
        settings = self.settings
        return {
            **_parts(settings, "seed", "effects", "strengths", "none", "pairs", "unknown", "unknown_kinds"),
            "images": _parts(settings["images"], "strengths", "effects"),
            "scan": _parts(settings["scan"], "rows"),
        }

    def scanned(self, case: str) -> dict:
        """What the recordings of a case depend on beside what is concealed."""
        shared = _parts(self.settings, "seed", "scan", "held_out_protocol")
        of_images = {"images": _parts(self.settings["images"], "views_times")}
        return shared | (of_images if self._kind(case) == "images" else {})

    def all(self, name: str) -> list[str]:
        """An output of every case."""
        return [self.files(name, case=case) for case in self.cases]

    def times(self) -> list[str]:
        """What the jobs of every case took."""
        jobs = ("scan", "diagnosis", "elsewhere")
        return [self.files.benchmark(f"proof/{job}_{case}") for job in jobs for case in self.cases]

    def real(self, name: str) -> list[str]:
        """An output of the diagnosis of every real recording that stands beside the cases."""
        return [self.files(name, recording=recording) for recording in self.settings["recordings"]]

    @property
    def phantoms(self) -> tuple[str, ...]:
        """What is scanned, in turn."""
        return PHANTOMS

    def layout(self, phantom: str) -> str:
        """What a phantom is made from."""
        return resource(OBJECTS[phantom].layout)

    def fine_phantom(self, case: str) -> str:
        """What is scanned in a case."""
        return self.files("proof_fine", phantom=phantom_of(case))

    def known_phantom(self, case: str) -> dict[str, str]:
        """What the diagnosis is told of it."""
        phantom = phantom_of(case)
        image = self.files("proof_image", phantom=phantom)
        return {
            "phantom": image,
            "image": image,
            "rois": self.files("proof_table", phantom=phantom),
            "masks": self.files("proof_rois", phantom=phantom),
        }

    def tried_on(self, case: str) -> list[str]:
        """The effects that a case is tried against."""
        return self.tried[self._kind(case)]

    def model(self, case: str) -> dict:
        """As Diagnosis.model, of the recording of a case."""
        return self._model(self.files("proof_recording", case=case), case, "scan")

    def held_out_model(self, case: str) -> dict:
        """The same of its scan by another protocol."""
        return self._model(self.files("proof_held_out", case=case), case, "held_out_protocol")

    def _model(self, folder: str, case: str, protocol: str) -> dict:
        config, settings, kind = self.plan.config, self.settings, self._kind(case)
        one, scan = OBJECTS[phantom_of(case)], settings["scan"]
        views = dict(zip(PROTOCOLS, views_of(kind, settings), strict=True))[protocol]
        rotation = settings[protocol]["rotation_time_ms"]
        simulated = {"samples": 2, "view_step": 1, "nominal_photons": settings[protocol]["photons"], "alignment": {}}
        return {
            "folder": folder,
            "settings": simulated,
            "mu_water_per_mm": config["mu_water_per_mm"],
            "materials": one.stated,
            "seed": config["seed"],
            "protocol": (
                one.protocol(scan["columns"], scan["rows"], views, rotation, "cpu") if kind == "images" else None
            ),
        }

    def _kind(self, case: str) -> str:
        return kind_of(case, self.settings)


def _parts(section: Mapping, *keys: str) -> dict:
    """What a job depends on of a section: other keys do not run it again."""
    return {key: section[key] for key in keys if key in section}
