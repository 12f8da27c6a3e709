"""What the configuration asks of the diagnosis, as its jobs take it."""

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

KEPT = "fits"  # folder beside a diagnosis
READ_BYTES = 35  # of memory for each ray that a recording holds (a clinical turn of 56 million rays: 33)
DEFAULT_CORES = 2  # that a diagnosis takes where nobody says how many there are
# A fit depends on none of these: another list of effects redoes none.
NOT_MODELLED = ("effects", "physics_from", "baseline_from")


def _object_file(settings: Mapping) -> dict[str, str]:
    """The file of an object, by what it is."""
    drawn = {key: settings[key] for key in ("mask", "labels") if key in settings}
    return drawn or {"shapes": shipped(object_path(settings["kind"]))}


@dataclass(frozen=True)
class Diagnosis:
    """Of one configuration.

    Attributes
    ----------
    engine : str
        What simulates images (projectors.choose_engine).
    candidates : mapping of str to list of str
        {recording: the effects that are tried}.
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
        """What a configuration asks for.

        Parameters
        ----------
        engine : str
            What simulates images (projectors.choose_engine).
        rates : mapping
            Measured costs (costs.rates).

        Raises
        ------
        InputError
            For what no diagnosis can be made of.
        """
        settings = plan.config["diagnosis"]
        check_kinds(settings["recordings"], recordings.documents)
        check_accuracy(settings["model_accuracy"])
        tried = {}
        for name, one in settings["recordings"].items():
            shown = shown_by(recordings.content(name))
            if "protocol" in one:
                scan = plan.geometry_settings(plan.geometry_of(one["protocol"]))["scan"]
                shown["helical"] = scan["trajectory"] == "helical"
            tried[name] = [] if "physics_from" in one else candidates(one, **shown)
        found = cls(plan, files, recordings, engine, tried, rates)
        for name in settings["scanners"]:
            found.shared(name)
        return found

    @property
    def settings(self) -> dict[str, dict]:
        """{recording: what is asked of it}."""
        return self.plan.config["diagnosis"]["recordings"]

    @property
    def scanners(self) -> dict[str, dict]:
        """{scanner: its recordings, and the effects to try}."""
        return self.plan.config["diagnosis"]["scanners"]

    def scanner_inputs(self, scanner: str) -> dict:
        """All that the recordings of a scanner need, with the checks of how they are described."""
        every = [self.inputs(name) for name in self.scanners[scanner]["recordings"]]
        inputs = {"files": [path for one in every for path in one["files"]]}
        inputs["setups"] = [self.files("setup", recording=name) for name in self.scanners[scanner]["recordings"]]
        for kind, key in (("mask", "masks"), ("labels", "label_maps"), ("shapes", "shapes")):
            if drawn := [one[kind] for one in every if kind in one]:
                inputs[key] = drawn
        if phantoms := [one["phantom"] for one in every if "phantom" in one]:
            inputs["phantom"] = phantoms[0]
        return inputs

    def in_fits(self, *recordings: str) -> list[str]:
        """The effects that fits of recordings may hold: those that are tried, and those that are declared."""
        names = [
            effect
            for name in recordings
            for effect in (*self.candidates[name], *self.settings[name].get("baseline", {}))
        ]
        names += [
            effect
            for one in self.scanners.values()
            if set(one["recordings"]) & set(recordings)
            for effect in one["baseline"]
        ]
        names += [
            effect
            for name in recordings
            if "baseline_from" in self.settings[name]
            for effect in self.in_fits(self.settings[name]["baseline_from"])
        ]
        return sorted(set(names))

    def shared(self, scanner: str) -> list[str]:
        """The effects that are tried on a scanner: those that every recording shows, or those that are asked for.

        Raises
        ------
        InputError
            For one that a recording does not show, that belongs to one scan, or that is declared; and where recordings
            do not declare the same of their scanner.
        """
        recordings, asked = self.scanners[scanner]["recordings"], self.scanners[scanner].get("effects")
        where = f"diagnosis.scanners.{scanner}.effects"
        known = self._declared_alike(scanner)
        shown = [self.candidates[name] for name in recordings]
        common = [
            name
            for name in shown[0]
            if all(name in one for one in shown) and not load(name).of_one_scan and name not in known
        ]
        for name in asked or []:
            require(name, where)
            if load(name).of_one_scan:
                raise InputError(f"{where}: {name} is one scan's alone; take it out")
            if name in known:
                raise InputError(f"{where}: {name} is declared under baseline; take it out")
            if name not in common:
                raise InputError(
                    f"{where}: {name} is not tried on every recording; add it to their effects, or take it out"
                )
        return list(asked or common)

    def _declared_alike(self, scanner: str) -> dict[str, dict]:
        """What all recordings of a scanner declare of it.

        Returns
        -------
        dict of str to dict
            {effect: {parameter: {value, sd}}}, as the first recording has it.

        Raises
        ------
        InputError
            Where another one declares other effects, or otherwise what is not its protocol's.
        """
        where = f"diagnosis.scanners.{scanner}"
        first, *others = self.scanners[scanner]["recordings"]
        declared(self.scanners[scanner]["baseline"], f"{where}.baseline")
        known = self._baseline(scanner, first)
        for name in others:
            here = self._baseline(scanner, name)
            if odd := sorted(set(known) ^ set(here)):
                one = next(key for key in (first, name) if odd[0] in self._baseline(scanner, key))
                raise InputError(
                    f"{where}: of its recordings {one} declares {odd[0]}, and not all do; declare it under "
                    f"{where}.baseline"
                )
            for effect in known:
                for parameter in load(effect).parameters:
                    apart = known[effect].get(parameter.name) != here[effect].get(parameter.name)
                    if apart and parameter.belongs_to == OF_SCANNER:
                        raise InputError(
                            f"{where}: {first} and {name} declare {parameter.name} of {effect} otherwise, which is one "
                            f"number of the scanner; declare it once, under {where}.baseline"
                        )
        return known

    def _baseline(self, scanner: str, recording: str) -> dict[str, dict]:
        return self.scanners[scanner]["baseline"] | self.settings[recording].get("baseline", {})

    def models(self, scanner: str, judged: bool = True) -> dict[str, dict]:
        """{recording: as `model`, with what is declared of its scanner}.

        Parameters
        ----------
        judged : bool, optional
            Also of those that only judge.
        """
        found = {}
        for name in self.scanners[scanner]["recordings"]:
            if name in self.scanners[scanner]["judged_on"] and not judged:
                continue
            model = self.model(name)
            known = {"baseline": self._baseline(scanner, name)}
            found[name] = model | {"settings": model["settings"] | known}
        return found

    @property
    def comparisons(self) -> list[str]:
        """Comparisons of features that are diagnosed."""
        return self.plan.config["diagnosis"]["comparisons"]

    @property
    def accuracy(self) -> dict[str, float]:
        """How far the model of each effect can be trusted."""
        return self.plan.config["diagnosis"]["model_accuracy"]

    @property
    def matters(self) -> dict[str, float] | None:
        """What a difference must change in images to matter; None: every significant one does."""
        return self.plan.config["diagnosis"]["matters"]

    @property
    def fail_on(self) -> list[str]:
        """Verdicts by which the target `diagnosis` fails."""
        return self.plan.config["diagnosis"]["fail_on"]

    @property
    def properties(self) -> tuple[str, ...]:
        """Effects that change one property of images each, for comparisons of features."""
        return ("photon_flux", *image_effects())

    def all(self) -> list[str]:
        """The documents of all diagnoses."""
        documents = [self.files("diagnosis", recording=name) for name in self.settings]
        documents += [self.files("scanner_diagnosis", scanner=name) for name in self.scanners]
        return documents + [self.files("feature_diagnosis", comparison=name) for name in self.comparisons]

    def next_measurements(self) -> list[str]:
        """Where further recordings are ranked: of recordings of projections with candidates, and of scanners."""
        own = [name for name in self.settings if self.candidates[name] and self.protocol(name) is None]
        scanners = [
            name for name, one in self.scanners.items() if all(self.protocol(key) is None for key in one["recordings"])
        ]
        return [self.files("next_measurement", recording=name) for name in own] + [
            self.files("scanner_next_measurement", scanner=name) for name in scanners
        ]

    def reports(self) -> list[str]:
        """The pages of all diagnoses."""
        pages = [self.files("diagnosis_report", recording=name) for name in self.settings]
        pages += [self.files("scanner_report", scanner=name) for name in self.scanners]
        return pages + [self.files("feature_report", comparison=name) for name in self.comparisons]

    def inputs(self, name: str) -> dict:
        """The recording's own files, and what was scanned."""
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
        """Where the physics is taken from, if it is not to be found here."""
        other = self.settings[name].get("physics_from")
        return {} if other is None else {"physics": self.files("diagnosis", recording=other)}

    def found(self, name: str | None) -> list[str]:
        """The file of the physics that is found of a recording or a scanner; of None, none."""
        if name is None:
            return []
        if name in self.settings:
            return [self.files("found_physics", recording=name)]
        return [self.files("scanner_physics", scanner=name)]

    def effects_of(self, geometry: str) -> list[str]:
        """Effects that scans of a geometry have, or may have where they are to be found."""
        settings = self.plan.geometry_settings(geometry)
        name = settings.get("physics_from")
        if name is None:
            return list(settings["physics"])
        return self.in_fits(*([name] if name in self.settings else self.scanners[name]["recordings"]))

    def same_material(self, name: str) -> bool:
        """Whether the object whose physics is taken was of the same single material."""
        settings = self.settings[name]
        both = settings, self.settings.get(settings.get("physics_from"), {})
        materials = [one.get("disc", one.get("object", {})).get("material") for one in both]
        return materials[0] is not None and materials[0] == materials[1]

    def regions(self, name: str) -> dict[str, str]:
        """Image and regions of the study's phantom, if that was scanned."""
        if {"disc", "object"} & set(self.settings[name]):
            return {}
        return {
            "image": self.files("phantom_image"),
            "rois": self.files("phantom_table"),
            "masks": self.files("phantom_rois"),
        }

    def kept(self, name: str) -> str:
        """The folder of fits from which a diagnosis goes on."""
        return f"{os.path.dirname(self.files('diagnosis', recording=name))}/{KEPT}"

    def protocol(self, name: str) -> dict | None:
        """The protocol that simulates a recording of images; None for projections."""
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
        """Images are simulated by the study's engine, projections on the CPU."""
        return int(self.engine == "astra_cuda" and self.protocol(name) is not None)

    def model(self, name: str) -> dict:
        """What was scanned and is simulated: all that the fits of a recording share."""
        settings = self.settings[name]
        return {
            "folder": self.recordings.folder(name),
            "settings": {key: value for key, value in settings.items() if key not in NOT_MODELLED},
            "mu_water_per_mm": self.plan.config["mu_water_per_mm"],
            "materials": self.plan.config["materials"],
            "seed": self.plan.config["seed"],
            "protocol": self.protocol(name),
        }

    def processes(self, name: str, cores: int | None) -> int:
        """That fit a recording side by side: no more than it has effects to try.

        Parameters
        ----------
        name : str
            The recording.
        cores : int or None
            That there are; None where that is not known.
        """
        if self.gpus(name):  # what has begun on a device survives no fork, and there is one of it
            return 1
        return max(1, min(cores or DEFAULT_CORES, len(self.candidates[name])))

    def extent(self, name: str) -> diagnoses.Extent | None:
        """How large the diagnosis of a recording is.

        Parameters
        ----------
        name : str
            The recording.

        Returns
        -------
        Extent or None
            None where costs are not known: of images, of physics that is found on another recording, and where a file
            cannot be read, which the job tells.
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
        """What `snakemake plan` says of every diagnosis.

        Parameters
        ----------
        cores : int or None
            That there are; None where that is not known.

        Returns
        -------
        list of dict
            name, and of recordings effects and processes, rays where they are known, and the lower and the upper end
            of the wall time in seconds (None: not known) and of the CPU time.
        """
        found: list[dict] = []
        for name in self.settings:
            processes, extent = self.processes(name, cores), self.extent(name)
            one = {"name": name, "effects": len(self.candidates[name]), "processes": processes}
            if extent is None:
                found.append(one | {"seconds": None})
            else:
                forecast = extent.forecast(self.rates, processes)
                known = {} if forecast is None else {"cpu_seconds": list(forecast.cpu)}
                seconds = None if forecast is None else list(forecast.wall)
                found.append(one | {"rays": extent.rays, "seconds": seconds} | known)
        return found + [{"name": name, "seconds": None} for name in (*self.scanners, *self.comparisons)]

    def minutes(self, name: str, processes: int) -> int:
        """The most that a diagnosis may take on a cluster.

        Where nothing is known of it: an hour for each round of fits, and four for all else.

        Parameters
        ----------
        name : str
            The recording.
        processes : int
            Side by side.
        """
        extent = self.extent(name)
        if extent is None:
            return 60 * (4 + math.ceil(len(self.candidates[name]) / processes))
        forecast = extent.forecast(self.rates, processes)
        return UNKNOWN_MINUTES if forecast is None else diagnosis_minutes(forecast.wall[1])

    def megabytes(self, name: str, processes: int = 1) -> int:
        """Memory of the fits, MB.

        That is rays of all repeats, and of those that are fitted path lengths at several samples per pixel, derivatives
        and numerical errors; of images, the realisations of noise.

        Parameters
        ----------
        name : str
            The recording.
        processes : int, optional
            Side by side.
        """
        protocol = self.protocol(name)
        scan = protocol["scan"] if protocol else self.recordings.content(name)["scan"]
        settings = self.settings[name]
        shape = protocol["projections"] if protocol else scan["views"], scan["rows"], scan["columns"]
        view_step = 1 if protocol else settings["view_step"]
        samples, step = fitted(settings["samples"], view_step, is_shapes(settings), shape)
        rays = math.prod(shape) / 1e6
        return int(1500 + READ_BYTES * rays + processes * rays / step * (60 * samples**2 + 500))
