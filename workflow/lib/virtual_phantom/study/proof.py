"""Files and settings of the blind validation (target `proof`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from ..base.errors import InputError
from ..base.geometry import ImageProtocol
from ..base.proof_settings import ProofProtocol, ProofSettings
from ..base.settings import FbpSettings, GridSettings, MaterialSettings, ScanSettings, from_mapping, to_mapping
from ..config.outputs import Files
from ..config.plan import Plan
from ..diagnosis.candidate_effects import candidates
from ..diagnosis.settings import Disc, FitSettings, LabelledObject, ObjectUncertainty, RecordingSettings, ShapesObject
from ..io.schema import defaults_of
from ..physics.effect import require
from ..proof.hiding.materials import DENSE, DENSE_FROM_HU, SOFT
from ..proof.hiding.objects import DISC, HU, LABELS, SHAPES
from ..proof.hiding.orbits import HELIX, Orbit, image_grid
from ..proof.hiding.suite import (
    IMAGES,
    PROJECTIONS,
    PROTOCOLS,
    World,
    check_recordings,
    check_simulators,
    check_tried,
    singles,
    truth,
    worlds,
)
from ..recordings.scan import DETECTOR

# Files of stated_object.write that the diagnosis of a case reads, by description
STATED_FILES = {
    HU: {"phantom": "image.nii.gz", "image": "image.nii.gz", "rois": "rois.csv"},
    SHAPES: {"shapes": "object.yaml"},
    LABELS: {"labels": "labels.nii.gz"},
    DISC: {},
}
SURFACE_SD_MM = 0.2  # tolerance of stated objects: about the RMS of the errors that imperfections.SHAPE_MM allows


@dataclass(frozen=True)
class Proof:
    """Blind validation of one configuration.

    Attributes
    ----------
    worlds : mapping of str to World
        By name of the case.
    """

    plan: Plan
    files: Files
    worlds: Mapping[str, World]

    @classmethod
    def read(cls, plan: Plan, files: Files) -> Proof:
        """Return the blind validation of a configuration.

        Raises
        ------
        InputError
            If the settings do not give a set of cases.
        """
        settings = plan.study.proof
        found = cls(plan, files, worlds(settings))
        check_simulators(settings.simulators)
        check_tried(settings)
        check_recordings(settings.recordings, plan.study.diagnosis.recordings)
        for name in settings.tried or ():
            require(name, "proof.tried")
        found._candidates(IMAGES)
        return found

    @property
    def cases(self) -> tuple[str, ...]:
        """Names of the cases."""
        return tuple(self.worlds)

    @property
    def settings(self) -> ProofSettings:
        """Section `proof` of the configuration."""
        return self.plan.study.proof

    @property
    def hiding(self) -> dict:
        """Settings that determine the hidden effects."""
        settings = to_mapping(self.settings)
        return {
            **_parts(settings, "seed", "simulators", "declared", "effects", "strengths", "none", "pairs", "unknown"),
            **_parts(settings, "unknown_kinds"),
            "images": _parts(settings["images"], "strengths", "effects"),
            "scan": _parts(settings["scan"], "rows"),
        }

    def scan_settings(self, case: str) -> dict:
        """Return the settings of the recordings of a case, apart from its hidden effects."""
        settings = to_mapping(self.settings)
        shared = _parts(settings, "seed", "scan", "held_out_protocol")
        of_images = {"images": _parts(settings["images"], "views_times")}
        return shared | (of_images if self.worlds[case].kind == IMAGES else {})

    def all(self, name: str) -> list[str]:
        """Return the paths of an output of all cases."""
        return [self.files(name, case=case) for case in self.cases]

    def compared(self) -> list[str]:
        """Return the tables of agreement with the other protocol that are scored: of cases with one hidden effect.

        A table is made after the diagnosis of its case, so that it reveals nothing to the diagnosis.
        """
        return [self.files("proof_elsewhere", case=case) for case in singles(self.settings)]

    def times(self) -> list[str]:
        """Return the benchmark files of the jobs of all cases."""
        jobs = [(job, case) for job in ("scan", "diagnosis") for case in self.cases]
        jobs += [("elsewhere", case) for case in singles(self.settings)]
        return [self.files.benchmark(f"proof/{job}_{case}") for job, case in jobs]

    def real(self, name: str) -> list[str]:
        """Return the paths of an output of the diagnoses of all real recordings in the report."""
        return [self.files(name, recording=recording) for recording in self.settings.recordings]

    def object_files(self, case: str) -> dict[str, str]:
        """Return {content: path} of the files that describe the object of a case; a disc has none."""
        names = STATED_FILES[self.worlds[case].description]
        return {content: f"{self.files('proof_object', case=case)}/{name}" for content, name in names.items()}

    def object_file(self, case: str, content: str) -> str | None:
        """Return one of `object_files`, or None."""
        return self.object_files(case).get(content)

    def tried_on(self, case: str) -> list[str]:
        """Return the candidate effects of a case."""
        world = self.worlds[case]
        return self._candidates(world.kind, self._settings(case, "scan").baseline, world.geometry == HELIX)

    def model(self, case: str) -> FitSettings:
        """Return the settings that the fits of a case depend on."""
        return self._model(self.files("proof_recording", case=case), case, "scan")

    def held_out_model(self, case: str) -> FitSettings:
        """Return the settings that the fits of a case's scan with the held-out protocol depend on."""
        return self._model(self.files("proof_held_out", case=case), case, "held_out_protocol")

    def _candidates(self, kind: str, baseline: Mapping | None = None, helical: bool = False) -> list[str]:
        settings = _diagnosed(self.settings.scan, baseline=baseline or {})
        if kind == PROJECTIONS:
            found, tried = candidates(settings, helical=helical), self.settings.tried
            return found if tried is None else [name for name in found if name in tried]
        try:
            return candidates(replace(settings, effects=self.settings.images.tried), IMAGES)
        except InputError as error:
            raise InputError(str(error).replace("diagnosis.effects", "proof.images.tried")) from None

    def _settings(self, case: str, protocol: str) -> RecordingSettings:
        world, files = self.worlds[case], self.object_files(case)
        described: dict = {}
        if world.description == DISC:
            outer = world.stated(self.settings.seed).parts[0]
            described = {"disc": Disc(2 * outer.radius_mm, outer.material)}
        elif world.description == LABELS:
            materials = world.stated(self.settings.seed).label_materials
            described = {"object": LabelledObject(files["labels"], materials)}
        elif world.description != HU:
            described = {"object": ShapesObject(files["shapes"])}
        declared = truth(case, self.settings)["imperfections"]["stated"]  # the diagnosis gets no other part of a truth
        return _diagnosed(getattr(self.settings, protocol), baseline=declared, **described)

    def _model(self, folder: str, case: str, protocol: str) -> FitSettings:
        study, world, simulated = self.plan.study, self.worlds[case], None
        if world.kind == IMAGES:
            orbit = dict(zip(PROTOCOLS, world.orbits(self.settings), strict=True))[protocol]
            simulated = image_protocol(orbit, getattr(self.settings, protocol).rotation_time_ms)
        return FitSettings(
            folder=folder,
            settings=self._settings(case, protocol),
            mu_water_per_mm=study.mu_water_per_mm,
            materials=MaterialSettings(SOFT, DENSE, DENSE_FROM_HU),
            seed=study.seed,
            protocol=simulated,
        )


def image_protocol(orbit: Orbit, rotation_ms: float) -> ImageProtocol:
    """Return the settings that the diagnosis of images knows: the scan, and another reconstruction than the hidden."""
    detector = {name: getattr(orbit, name) for name in DETECTOR}
    circle = {"trajectory": "circular", "turns": 1.0, "rotation_time_ms": rotation_ms}
    scan = from_mapping(ScanSettings, defaults_of("scan") | circle | detector)
    images = image_grid(orbit)
    grid = GridSettings(images.shape, images.spacing, oversampling=1)
    settings = FbpSettings(normalise="coverage")
    return ImageProtocol(scan, grid, projections=orbit.views, algorithm="fbp", settings=settings, engine="cpu")


def _diagnosed(taken: ProofProtocol, **described) -> RecordingSettings:
    """Return the settings of the diagnosis of a scan, of a user who states tolerances but no rays and views."""
    uncertain = ObjectUncertainty(surface_mm=SURFACE_SD_MM)
    return RecordingSettings(
        None, None, {}, nominal_photons=taken.photons, object_uncertainty=uncertain, check_setup=True, **described
    )


def _parts(section: Mapping, *keys: str) -> dict:
    """Return some keys of a section: a change of other keys does not rerun the job."""
    return {key: section[key] for key in keys if key in section}
