"""Files, settings, forecasts and resources of the diagnoses of a configuration."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass

from ..base.errors import InputError
from ..config.dependencies import shipped
from ..config.outputs import Files
from ..config.plan import Plan
from ..diagnosis.candidate_effects import candidates, check_accuracy, check_kinds, shown_by
from ..diagnosis.fitting.priors import declared
from ..diagnosis.workload import fitted, is_shapes
from ..physics.effect import OF_SCANNER, image_effects, load, require
from ..physics.scenes.object_files import object_path
from ..recordings.scan import missing_for_geometry
from .costs import diagnoses
from .costs.limits import UNKNOWN_MINUTES, diagnosis_minutes
from .recordings import Recordings

FIT_CACHE = "fits"  # folder of cached fits, next to diagnosis.json
READ_BYTES = 35  # memory per ray of a recording (measured: 33, for a clinical rotation of 56 million rays)
DEFAULT_CORES = 2  # of a diagnosis if the number of available cores is not known
# Fits do not depend on these keys. A change, such as another list of effects, keeps the cached fits.
NOT_IN_MODEL = ("effects", "physics_from", "baseline_from")


def _object_file(settings: Mapping) -> dict[str, str]:
    """Return {kind of file: path} of the description of an object."""
    images = {key: settings[key] for key in ("mask", "labels") if key in settings}
    return images or {"shapes": shipped(object_path(settings["kind"]))}


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
        settings = plan.config["diagnosis"]
        check_kinds(settings["recordings"], recordings.documents)
        check_accuracy(settings["model_accuracy"])
        effects = {}
        for name, recording in settings["recordings"].items():
            shown = shown_by(recordings.content(name))
            if "protocol" in recording:
                scan = plan.geometry_settings(plan.geometry_of(recording["protocol"]))["scan"]
                shown["helical"] = scan["trajectory"] == "helical"
            effects[name] = [] if "physics_from" in recording else candidates(recording, **shown)
        diagnosis = cls(plan, files, recordings, engine, effects, rates)
        for scanner in settings["scanners"]:
            diagnosis.shared(scanner)  # raises InputError for wrong settings
        return diagnosis

    @property
    def settings(self) -> dict[str, dict]:
        """{recording: settings of its diagnosis}."""
        return self.plan.config["diagnosis"]["recordings"]

    @property
    def scanners(self) -> dict[str, dict]:
        """{scanner: settings of its joint diagnosis}."""
        return self.plan.config["diagnosis"]["scanners"]

    def scanner_inputs(self, scanner: str) -> dict:
        """Return the inputs of all recordings of a scanner, with the checks of their scan set-ups."""
        recordings = self.scanners[scanner]["recordings"]
        separate = [self.inputs(name) for name in recordings]
        inputs = {"files": [path for recording in separate for path in recording["files"]]}
        inputs["setups"] = [self.files("setup", recording=name) for name in recordings]
        for kind, key in (("mask", "masks"), ("labels", "label_maps"), ("shapes", "shapes")):
            if objects := [recording[kind] for recording in separate if kind in recording]:
                inputs[key] = objects
        if phantoms := [recording["phantom"] for recording in separate if "phantom" in recording]:
            inputs["phantom"] = phantoms[0]
        return inputs

    def in_fits(self, *recordings: str) -> list[str]:
        """Return the effects that fits of these recordings may contain: candidates and declared effects."""
        names = [
            effect
            for name in recordings
            for effect in (*self.candidates[name], *self.settings[name].get("baseline", {}))
        ]
        names += [
            effect
            for scanner in self.scanners.values()
            if set(scanner["recordings"]) & set(recordings)
            for effect in scanner["baseline"]
        ]
        names += [
            effect
            for name in recordings
            if "baseline_from" in self.settings[name]
            for effect in self.in_fits(self.settings[name]["baseline_from"])
        ]
        return sorted(set(names))

    def shared(self, scanner: str) -> list[str]:
        """Return the candidate effects of a scanner: those of its `effects`, or all that its recordings share.

        Raises
        ------
        InputError
            If a configured effect is not a candidate of all recordings, belongs to a single scan or is declared, or if
            the recordings declare different properties of their scanner.
        """
        recordings, configured = self.scanners[scanner]["recordings"], self.scanners[scanner].get("effects")
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

    def _declared_alike(self, scanner: str) -> dict[str, dict]:
        """Return the effects that all recordings of a scanner declare.

        Returns
        -------
        dict of str to dict
            {effect: {parameter: {value, sd}}} of the first recording.

        Raises
        ------
        InputError
            If another recording declares other effects, or other values of the scanner's parameters.
        """
        where = f"diagnosis.scanners.{scanner}"
        first, *others = self.scanners[scanner]["recordings"]
        declared(self.scanners[scanner]["baseline"], f"{where}.baseline")
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

    def _baseline(self, scanner: str, recording: str) -> dict[str, dict]:
        return self.scanners[scanner]["baseline"] | self.settings[recording].get("baseline", {})

    def models(self, scanner: str, judged: bool = True) -> dict[str, dict]:
        """Return {recording: model} of a scanner, with the effects that are declared for the scanner.

        Parameters
        ----------
        judged : bool, optional
            Whether to include the recordings of `judged_on`, which are not fitted.
        """
        models = {}
        for name in self.scanners[scanner]["recordings"]:
            if name in self.scanners[scanner]["judged_on"] and not judged:
                continue
            model = self.model(name)
            known = {"baseline": self._baseline(scanner, name)}
            models[name] = model | {"settings": model["settings"] | known}
        return models

    @property
    def comparisons(self) -> list[str]:
        """Comparisons of features to diagnose."""
        return self.plan.config["diagnosis"]["comparisons"]

    @property
    def accuracy(self) -> dict[str, float]:
        """{effect: relative accuracy of its model}."""
        return self.plan.config["diagnosis"]["model_accuracy"]

    @property
    def matters(self) -> dict[str, float] | None:
        """Relevance thresholds of differences in images; None if every significant difference is relevant."""
        return self.plan.config["diagnosis"]["matters"]

    @property
    def fail_on(self) -> list[str]:
        """Verdicts with which the target `diagnosis` fails."""
        return self.plan.config["diagnosis"]["fail_on"]

    @property
    def properties(self) -> tuple[str, ...]:
        """Effects that each change one property of images, for comparisons of features."""
        return ("photon_flux", *image_effects())

    def all(self) -> list[str]:
        """Return the JSON files of all diagnoses."""
        documents = [self.files("diagnosis", recording=name) for name in self.settings]
        documents += [self.files("scanner_diagnosis", scanner=name) for name in self.scanners]
        return documents + [self.files("feature_diagnosis", comparison=name) for name in self.comparisons]

    def next_measurements(self) -> list[str]:
        """Return the rankings of further measurements: for recordings of projections, and for their scanners."""
        of_projections = [name for name in self.settings if self.protocol(name) is None]
        scanners = [
            name for name, scanner in self.scanners.items() if set(scanner["recordings"]) <= set(of_projections)
        ]
        return [self.files("next_measurement", recording=name) for name in of_projections if self.candidates[name]] + [
            self.files("scanner_next_measurement", scanner=name) for name in scanners
        ]

    def reports(self) -> list[str]:
        """Return the report pages of all diagnoses."""
        pages = [self.files("diagnosis_report", recording=name) for name in self.settings]
        pages += [self.files("scanner_report", scanner=name) for name in self.scanners]
        return pages + [self.files("feature_report", comparison=name) for name in self.comparisons]

    def inputs(self, name: str) -> dict:
        """Return the files of a recording and of the scanned object."""
        inputs: dict = {"files": self.recordings.sources(name)}
        settings = self.settings[name]
        if "object" in settings:
            inputs |= _object_file(settings["object"])
        elif "disc" not in settings:
            inputs["phantom"] = self.files("phantom_fine")
        if "baseline_from" in settings:
            inputs["declared"] = self.files("diagnosis", recording=settings["baseline_from"])
        return inputs

    def physics(self, name: str) -> dict[str, str]:
        """Return the diagnosis that the physics of a recording is taken from; empty without physics_from."""
        other = self.settings[name].get("physics_from")
        return {} if other is None else {"physics": self.files("diagnosis", recording=other)}

    def found(self, name: str | None) -> list[str]:
        """Return the file of the diagnosed physics of a recording or scanner; empty if `name` is None."""
        if name is None:
            return []
        if name in self.settings:
            return [self.files("found_physics", recording=name)]
        return [self.files("scanner_physics", scanner=name)]

    def effects_of(self, geometry: str) -> list[str]:
        """Return the effects of scans of a geometry: the stated ones, or all that a diagnosis may find."""
        settings = self.plan.geometry_settings(geometry)
        name = settings.get("physics_from")
        if name is None:
            return list(settings["physics"])
        return self.in_fits(*([name] if name in self.settings else self.scanners[name]["recordings"]))

    def same_material(self, name: str) -> bool:
        """Return whether the object of physics_from has the same single material as the object of this recording."""
        settings = self.settings[name]
        both = settings, self.settings.get(settings.get("physics_from"), {})
        materials = [recording.get("disc", recording.get("object", {})).get("material") for recording in both]
        return materials[0] is not None and materials[0] == materials[1]

    def regions(self, name: str) -> dict[str, str]:
        """Return image and ROIs of the study's phantom if it is the scanned object, else {}."""
        if {"disc", "object"} & set(self.settings[name]):
            return {}
        return {
            "image": self.files("phantom_image"),
            "rois": self.files("phantom_table"),
            "masks": self.files("phantom_rois"),
        }

    def fit_cache(self, name: str) -> str:
        """Return the folder of the cached fits of a diagnosis."""
        return f"{os.path.dirname(self.files('diagnosis', recording=name))}/{FIT_CACHE}"

    def protocol(self, name: str) -> dict | None:
        """Return the protocol that simulates a recording of images; None for projections."""
        protocol = self.settings[name].get("protocol")
        if protocol is None:
            return None
        config, settings = self.plan.config, self.plan.config["protocols"][protocol]
        geometry = self.plan.geometry_settings(self.plan.geometry_of(protocol))
        return {
            "scan": geometry["scan"],
            "grid": config["grid"],
            "projections": geometry["projections"],
            "algorithm": settings["algorithm"],
            "settings": config["reconstruction"][settings["algorithm"]],
            "engine": self.engine,
        }

    def gpus(self, name: str) -> int:
        """Return the number of GPUs: images are simulated by the study's engine, projections on the CPU."""
        return int(self.engine == "astra_cuda" and self.protocol(name) is not None)

    def model(self, name: str) -> dict:
        """Return the settings that all fits of a recording depend on."""
        settings = self.settings[name]
        return {
            "folder": self.recordings.folder(name),
            "settings": {key: value for key, value in settings.items() if key not in NOT_IN_MODEL},
            "mu_water_per_mm": self.plan.config["mu_water_per_mm"],
            "materials": self.plan.config["materials"],
            "seed": self.plan.config["seed"],
            "protocol": self.protocol(name),
        }

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
            None if the cost is not known: for images, for physics from another recording, and if a file cannot be
            read, which the job reports.
        """
        settings, content = self.settings[name], self.recordings.content(name)
        if self.protocol(name) is not None or not self.candidates[name] or missing_for_geometry(content["scan"]):
            return None
        shape = tuple(content["scan"][key] for key in ("views", "rows", "columns"))
        config = self.plan.config
        voxels = [config["grid"]["oversampling"] * count for count in config["grid"]["shape"]]
        phantom = voxels, diagnoses.material_count(config["materials"])
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
        return forecasts + [{"name": name, "seconds": None} for name in (*self.scanners, *self.comparisons)]

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
        protocol = self.protocol(name)
        scan = protocol["scan"] if protocol else self.recordings.content(name)["scan"]
        settings = self.settings[name]
        shape = protocol["projections"] if protocol else scan["views"], scan["rows"], scan["columns"]
        view_step = 1 if protocol else settings["view_step"]
        samples, step = fitted(settings["samples"], view_step, is_shapes(settings), shape)
        rays = math.prod(shape) / 1e6
        return int(1500 + READ_BYTES * rays + processes * rays / step * (60 * samples**2 + 500))
