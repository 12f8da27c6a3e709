"""Files, settings, forecasts and resources of the diagnoses of a configuration."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace

from ..base.errors import InputError
from ..base.geometry import ImageProtocol
from ..config.dependencies import shipped
from ..config.outputs import Files
from ..config.plan import Plan
from ..diagnosis.candidate_effects import candidate_conditions, candidates, check_accuracy, check_kinds
from ..diagnosis.fitting.priors import declared
from ..diagnosis.settings import (
    OBJECT_INPUTS,
    Baseline,
    FitSettings,
    LabelledObject,
    MaskedObject,
    OtherScan,
    RecordingSettings,
    ScannerSettings,
    ShapesObject,
)
from ..diagnosis.workload import samples_and_step
from ..physics.effect import OF_SCANNER, image_effects, load, require
from ..physics.scenes.object_files import object_path
from ..recordings.document import files_of_recording
from ..recordings.scan import missing_for_geometry
from .costs import diagnoses
from .costs.limits import UNKNOWN_MINUTES, diagnosis_minutes
from .recordings import Recordings

FIT_CACHE = "fits"  # folder of cached fits, next to diagnosis.json
# Views, rows and columns of the largest scan of one slice that simulates images of an object (images.scan).
SCAN_OF_IMAGES = (700, 1, 360)
READ_BYTES = 35  # memory per ray of a recording (measured: 33, for a clinical rotation of 56 million rays)
DEFAULT_CORES = 2  # of a diagnosis if the number of available cores is not known


@dataclass(frozen=True)
class Diagnosis:
    """Diagnoses of one configuration.

    Attributes
    ----------
    engine : str
        Engine that simulates images (projectors.choose_engine).
    candidates : mapping of str to list of str
        {recording: candidate effects}.
    rates : mapping
        Measured costs (costs.rates).
    """

    plan: Plan
    files: Files
    recordings: Recordings
    engine: str
    candidates: Mapping[str, list[str]]
    rates: Mapping

    @classmethod
    def read(cls, plan: Plan, files: Files, recordings: Recordings, engine: str, rates: Mapping) -> Diagnosis:
        """Return the diagnoses of a configuration.

        Raises
        ------
        InputError
            If a diagnosis is not possible.
        """
        settings = plan.study.diagnosis
        check_kinds(settings.recordings, recordings.documents)
        check_accuracy(settings.model_accuracy)
        effects = {}
        for name, recording in settings.recordings.items():
            shown = candidate_conditions(recordings.content(name))
            if recording.protocol:
                shown["helical"] = plan.scan_of(recording.protocol).trajectory == "helical"
            none = recording.physics_from or recording.of_unknown
            effects[name] = [] if none else candidates(recording, **shown)
        diagnosis = cls(plan, files, recordings, engine, effects, rates)
        for scanner in settings.scanners:
            diagnosis.shared_candidates(scanner)  # raises InputError for wrong settings
        return diagnosis

    @property
    def settings(self) -> dict[str, RecordingSettings]:
        """{recording: settings of its diagnosis}."""
        return self.plan.study.diagnosis.recordings

    @property
    def scanners(self) -> dict[str, ScannerSettings]:
        """{scanner: settings of its joint diagnosis}."""
        return self.plan.study.diagnosis.scanners

    def scanner_inputs(self, scanner: str) -> dict:
        """Return the inputs of all recordings of a scanner, with the checks of their scan set-ups."""
        recordings = self.scanners[scanner].recordings
        separate = [self.inputs(name) for name in recordings]
        inputs = {"files": [path for recording in separate for path in recording["files"]]}
        inputs["setups"] = [self.files("setup", recording=name) for name in recordings]
        for kind, key in OBJECT_INPUTS.items():
            if objects := [recording[kind] for recording in separate if kind in recording]:
                inputs[key] = objects
        if phantoms := [recording["phantom"] for recording in separate if "phantom" in recording]:
            inputs["phantom"] = phantoms[0]
        return inputs

    def in_fits(self, *recordings: str) -> list[str]:
        """Return the effects that fits of these recordings may contain: candidates and declared effects."""
        names = [effect for name in recordings for effect in (*self.candidates[name], *self.settings[name].baseline)]
        names += [
            effect
            for scanner in self.scanners.values()
            if set(scanner.recordings) & set(recordings)
            for effect in scanner.baseline
        ]
        names += [
            effect
            for name in recordings
            if self.settings[name].baseline_from
            for effect in self.in_fits(self.settings[name].baseline_from)
        ]
        return sorted(set(names))

    def shared_candidates(self, scanner: str) -> list[str]:
        """Return the candidate effects of a scanner: its `effects`, or all candidates that its recordings share.

        Raises
        ------
        InputError
            If a configured effect is not a candidate of all recordings, belongs to a single scan or is declared, or if
            the recordings declare different properties of their scanner.
        """
        recordings, configured = self.scanners[scanner].recordings, self.scanners[scanner].effects
        for name in recordings:
            if self.recordings.content(name)["kind"] == "images" and not self.settings[name].of_phantom:
                raise InputError(
                    f"diagnosis.scanners.{scanner}.recordings: {name} holds images of an object, which can only be "
                    "diagnosed alone; remove it"
                )
        where = f"diagnosis.scanners.{scanner}.effects"
        known = self._declared_alike(scanner)
        first, *others = [self.candidates[name] for name in recordings]
        common = [
            name
            for name in first
            if all(name in other for other in others) and not load(name).of_one_scan and name not in known
        ]
        for name in configured or []:
            require(name, where)
            if load(name).of_one_scan:
                raise InputError(f"{where}: {name} differs between the scans of a scanner; remove it")
            if name in known:
                raise InputError(f"{where}: {name} is declared under baseline; remove it")
            if name not in common:
                raise InputError(
                    f"{where}: {name} is not a candidate of every recording; add it to their effects, or remove it here"
                )
        return list(configured or common)

    def _declared_alike(self, scanner: str) -> Baseline:
        """Return the effects that all recordings of a scanner declare, as the first recording does.

        Raises
        ------
        InputError
            If another recording declares other effects, or other values of the scanner's parameters.
        """
        where = f"diagnosis.scanners.{scanner}"
        first, *others = self.scanners[scanner].recordings
        declared(self.scanners[scanner].baseline, f"{where}.baseline")
        known = self._baseline(scanner, first)
        for name in others:
            here = self._baseline(scanner, name)
            if odd := sorted(set(known) ^ set(here)):
                declaring = first if odd[0] in known else name
                raise InputError(
                    f"{where}: recording {declaring} declares {odd[0]}, but others do not; declare it under "
                    f"{where}.baseline"
                )
            for effect in known:
                for parameter in load(effect).parameters:
                    differs = known[effect].get(parameter.name) != here[effect].get(parameter.name)
                    if differs and parameter.belongs_to == OF_SCANNER:
                        raise InputError(
                            f"{where}: {first} and {name} declare different values of {parameter.name} of {effect}, "
                            f"which belongs to the scanner; declare it once, under {where}.baseline"
                        )
        return known

    def _baseline(self, scanner: str, recording: str) -> Baseline:
        return self.scanners[scanner].baseline | self.settings[recording].baseline

    def models(self, scanner: str, judged: bool = True) -> dict[str, FitSettings]:
        """Return {recording: model} of a scanner, with the effects that are declared for the scanner.

        Parameters
        ----------
        judged : bool, optional
            Whether to include the recordings of `test_recordings`, which are not fitted.
        """
        models = {}
        for name in self.scanners[scanner].recordings:
            if name in self.scanners[scanner].test_recordings and not judged:
                continue
            model = self.model(name)
            models[name] = replace(model, settings=replace(model.settings, baseline=self._baseline(scanner, name)))
        return models

    @property
    def properties(self) -> tuple[str, ...]:
        """Effects that each change one property of images, for comparisons of features."""
        return ("photon_flux", *image_effects())

    def all(self) -> list[str]:
        """Return the JSON files of all diagnoses."""
        documents = [self.files("diagnosis", recording=name) for name in self.settings]
        documents += [self.files("scanner_diagnosis", scanner=name) for name in self.scanners]
        return documents + [
            self.files("feature_diagnosis", comparison=name) for name in self.plan.study.diagnosis.comparisons
        ]

    def next_measurements(self) -> list[str]:
        """Return the rankings of further measurements: for recordings of projections, and for their scanners."""
        of_projections = [name for name in self.settings if self.recordings.content(name)["kind"] == "projections"]
        scanners = [name for name, scanner in self.scanners.items() if set(scanner.recordings) <= set(of_projections)]
        return [self.files("next_measurement", recording=name) for name in of_projections if self.candidates[name]] + [
            self.files("scanner_next_measurement", scanner=name) for name in scanners
        ]

    def reports(self) -> list[str]:
        """Return the report pages of all diagnoses."""
        pages = [self.files("diagnosis_report", recording=name) for name in self.settings]
        pages += [self.files("scanner_report", scanner=name) for name in self.scanners]
        return pages + [self.files("feature_report", comparison=name) for name in self.plan.study.diagnosis.comparisons]

    def inputs(self, name: str) -> dict:
        """Return the files of a recording and of the scanned object."""
        inputs: dict = {"files": self.recordings.sources(name)}
        settings, scanned = self.settings[name], self.settings[name].object
        if isinstance(scanned, OtherScan):
            inputs["files"] += map(str, files_of_recording(scanned.scan))
        elif isinstance(scanned, ShapesObject):
            inputs["shapes"] = shipped(object_path(scanned.kind))
        elif isinstance(scanned, MaskedObject):
            inputs["mask"] = scanned.mask
        elif isinstance(scanned, LabelledObject):
            inputs["labels"] = scanned.labels
        elif settings.simulation is not None:
            inputs["simulation"] = settings.simulation
        elif settings.of_phantom:
            inputs["phantom"] = self.files("phantom_fine")
        if settings.baseline_from:
            inputs["declared"] = self.files("diagnosis", recording=settings.baseline_from)
        return inputs

    def physics(self, name: str) -> dict[str, str]:
        """Return the diagnosis that the physics of a recording is taken from; empty without physics_from."""
        other = self.settings[name].physics_from
        return {} if other is None else {"physics": self.files("diagnosis", recording=other)}

    def found_physics(self, name: str | None) -> list[str]:
        """Return the file of the diagnosed physics of a recording or scanner; empty if `name` is None."""
        if name is None:
            return []
        if name in self.settings:
            return [self.files("found_physics", recording=name)]
        return [self.files("scanner_physics", scanner=name)]

    def effects_of(self, geometry: str) -> list[str]:
        """Return the effects of scans of a geometry: the stated ones, or all that a diagnosis may find."""
        settings = self.plan.geometry_settings(geometry)
        name = settings.physics_from
        if name is None:
            return list(settings.physics)
        return self.in_fits(*([name] if name in self.settings else self.scanners[name].recordings))

    def same_material(self, name: str) -> bool:
        """Return whether the object of physics_from has the same single material as the object of this recording."""
        other = self.settings.get(self.settings[name].physics_from)
        materials = [one and getattr(one.disc or one.object, "material", None) for one in (self.settings[name], other)]
        return materials[0] is not None and materials[0] == materials[1]

    def regions(self, name: str) -> dict[str, str]:
        """Return image and ROIs of the study's phantom if it is the scanned object, else {}."""
        if not self.settings[name].of_phantom:
            return {}
        return {
            "image": self.files("phantom_image"),
            "rois": self.files("phantom_table"),
            "masks": self.files("phantom_rois"),
        }

    def fit_cache(self, name: str) -> str:
        """Return the folder of the cached fits of a diagnosis."""
        return f"{os.path.dirname(self.files('diagnosis', recording=name))}/{FIT_CACHE}"

    def protocol(self, name: str) -> ImageProtocol | None:
        """Return the protocol that simulates a recording of images; None for projections."""
        protocol, study = self.settings[name].protocol, self.plan.study
        if protocol is None:
            return None
        settings = study.protocols[protocol]
        return ImageProtocol(
            scan=self.plan.scan_of(protocol),
            grid=study.grid,
            projections=settings.projections,
            algorithm=settings.algorithm,
            settings=getattr(study.reconstruction, settings.algorithm),
            engine=self.engine,
        )

    def gpus(self, name: str) -> int:
        """Return the number of GPUs: images are simulated by the study's engine, projections on the CPU."""
        return int(self.engine == "astra_cuda" and self.settings[name].protocol is not None)

    def model(self, name: str) -> FitSettings:
        """Return the settings that all fits of a recording depend on."""
        study = self.plan.study
        return FitSettings(
            folder=self.recordings.folder(name),
            settings=self.settings[name].in_fits,
            mu_water_per_mm=study.mu_water_per_mm,
            materials=study.materials,
            seed=study.seed,
            protocol=self.protocol(name),
        )

    def processes(self, name: str, cores: int | None) -> int:
        """Return the number of parallel processes of a diagnosis, which is at most the number of candidates.

        Parameters
        ----------
        cores : int or None
            Available cores; None if not known.
        """
        if self.gpus(name):  # a CUDA context does not survive a fork, and all processes would share one GPU
            return 1
        return max(1, min(cores or DEFAULT_CORES, len(self.candidates[name])))

    def extent(self, name: str) -> diagnoses.Extent | None:
        """Return the amount of work of a diagnosis.

        Returns
        -------
        Extent or None
            None if the cost is not known: for images of the study's phantom, for physics from another recording, and
            if a file cannot be read, which the job reports.
        """
        settings, content = self.settings[name], self.recordings.content(name)
        if settings.protocol is not None or not self.candidates[name]:
            return None
        if content["kind"] == "images":
            shape = SCAN_OF_IMAGES
        elif missing_for_geometry(content["scan"]):
            return None
        else:
            shape = tuple(content["scan"][key] for key in ("views", "rows", "columns"))
        study = self.plan.study
        voxels = [study.grid.oversampling * count for count in study.grid.shape]
        phantom = voxels, diagnoses.material_count(study.materials)
        try:
            return diagnoses.extent(settings, shape, len(self.candidates[name]), phantom)
        except InputError:
            return None

    def forecasts(self, cores: int | None) -> list[dict]:
        """Return the forecasts of all diagnoses for `snakemake plan`.

        Parameters
        ----------
        cores : int or None
            Available cores; None if not known.

        Returns
        -------
        list of dict
            All have `name`, and `seconds`: (lower, upper) end of the wall time, or None if it is not known.
            Recordings also have the numbers of effects and processes. If the cost is known, they have the number of
            rays and the CPU time.
        """
        forecasts: list[dict] = []
        for name in self.settings:
            processes, extent = self.processes(name, cores), self.extent(name)
            entry = {"name": name, "effects": len(self.candidates[name]), "processes": processes, "seconds": None}
            if extent is not None:
                entry["rays"] = extent.rays
                if forecast := extent.forecast(self.rates, processes):
                    entry |= {"seconds": list(forecast.wall), "cpu_seconds": list(forecast.cpu)}
            forecasts.append(entry)
        return forecasts + [
            {"name": name, "seconds": None} for name in (*self.scanners, *self.plan.study.diagnosis.comparisons)
        ]

    def minutes(self, name: str, processes: int) -> int:
        """Return the time limit of a diagnosis on a cluster, minutes.

        If the extent is not known: an hour for each round of parallel fits, and four hours for everything else.
        """
        extent = self.extent(name)
        if extent is None:
            return 60 * (4 + math.ceil(len(self.candidates[name]) / processes))
        forecast = extent.forecast(self.rates, processes)
        return UNKNOWN_MINUTES if forecast is None else diagnosis_minutes(forecast.wall[1])

    def megabytes(self, name: str, processes: int = 1) -> int:
        """Return the memory of a diagnosis, MB.

        It consists of the rays of all repeats and, for the fitted rays, of path lengths at several samples per pixel,
        derivatives and numerical errors. For images, it includes random realizations of the noise.
        """
        settings, protocol = self.settings[name], self.protocol(name)
        if settings.of_unknown:
            return self.recordings.megabytes(name)
        if protocol:
            shape, view_step = (protocol.projections, protocol.scan.rows, protocol.scan.columns), 1
        elif self.recordings.content(name)["kind"] == "images":
            shape, view_step = SCAN_OF_IMAGES, 1
        else:
            scan, view_step = self.recordings.content(name)["scan"], settings.view_step
            shape = scan["views"], scan["rows"], scan["columns"]
        samples, step = samples_and_step(settings.samples, view_step, shape)
        rays = math.prod(shape) / 1e6
        return int(1500 + READ_BYTES * rays + processes * rays / step * (60 * samples**2 + 500))
