"""Request for the diagnosis of one recording: its section of the configuration, and the scanner's nominal settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from ..base.geometry import OrbitGeometry, grid_of, scan_geometry
from ..physics.beam.sensors import Sensor
from ..physics.beam.spectra import Anode

LOCATION_DIGITS = 1  # decimals of an object location that is found, mm


@dataclass(frozen=True)
class Disc:
    """A homogeneous cylinder along z."""

    diameter_mm: float
    material: str


@dataclass(frozen=True)
class MaskedObject:
    """A homogeneous object given as a mask.

    Attributes
    ----------
    mask : str
        Path of an image (scanned_object.mask_scene).
    """

    mask: str
    material: str


@dataclass(frozen=True)
class LabelledObject:
    """An object given as a label map.

    Attributes
    ----------
    labels : str
        Path of an image of integers.
    materials : mapping of str to str or mapping
        Material by label (physics.scenes.labeled.materials_of).
    """

    labels: str
    materials: Mapping[str, str | Mapping]


@dataclass(frozen=True)
class ShapesObject:
    """An object of shapes.

    Attributes
    ----------
    kind : str
        Name of a shipped object, or path of a file (physics.scenes.objects.read_object).
    """

    kind: str
    parameters: Mapping[str, float | str] = field(default_factory=dict)


@dataclass(frozen=True)
class Settings:
    """Section diagnosis.recordings.<name> of the configuration, as far as fits depend on it.

    Attributes
    ----------
    samples : int or None
        Rays per detector pixel and direction; None: see workload.samples_for.
    view_step : int or None
        Every such view is used; None: see workload.step_for.
    alignment : mapping of str to float
        {nuisance parameter: standard deviation that replaces the default}.
    nominal_photons : float or None
        Stated noise-equivalent photons per pixel in air.
    disc, object
        The scanned object; with neither, the study's phantom was scanned.
    protocol : str or None
        Name of the protocol that simulates a recording of images.
    location : mapping of str to float
        Object location by axis (fitting.nuisance.LOCATION), mm from the isocenter; 0 if not stated.
    check_setup : bool
        Whether the set-up of the scan is checked first.
    object_may_differ : bool or float
        See run.find_missing_physics.
    baseline : mapping
        Declared physics, {effect: {parameter: {value, sd}}} (fitting.priors).
    """

    samples: int | None
    view_step: int | None
    alignment: Mapping[str, float]
    nominal_photons: float | None = None
    disc: Disc | None = None
    object: MaskedObject | LabelledObject | ShapesObject | None = None
    protocol: str | None = None
    location: Mapping[str, float] = field(default_factory=dict)
    check_setup: bool = False
    object_may_differ: bool | float = False
    baseline: Mapping[str, Mapping[str, Mapping[str, float]]] = field(default_factory=dict)

    @classmethod
    def of(cls, section: Mapping) -> Settings:
        """Read the section, with defaults filled in."""
        scanned: dict = {}
        if "disc" in section:
            scanned["disc"] = Disc(**section["disc"])
        if "object" in section:
            scanned["object"] = _object_class(section["object"])(**section["object"])
        return cls(**{**section, **scanned})

    @property
    def of_phantom(self) -> bool:
        """Whether the study's phantom was scanned."""
        return self.disc is None and self.object is None

    @property
    def of_shapes(self) -> bool:
        """Whether a disc or an object of shapes was scanned."""
        return self.disc is not None or isinstance(self.object, ShapesObject)


def _object_class(section: Mapping) -> type:
    if "mask" in section:
        return MaskedObject
    return LabelledObject if "labels" in section else ShapesObject


@dataclass(frozen=True)
class Protocol:
    """The protocol of the study that simulates a recording of images.

    Attributes
    ----------
    scan, grid : mapping
        Sections of the configuration, with defaults.
    algorithm : {"sirt", "fbp"}
    settings : mapping
        Keyword arguments of the algorithm.
    """

    scan: Mapping
    grid: Mapping
    projections: int
    algorithm: str
    settings: Mapping
    engine: str

    @property
    def geometry(self) -> OrbitGeometry:
        """Geometry of the scan."""
        return scan_geometry(self.scan, self.projections, grid_of(self.grid))


@dataclass(frozen=True)
class DiagnosisRequest:
    """All that the diagnosis of one recording depends on, besides the candidate effects.

    Attributes
    ----------
    mu_water_per_mm : float
        Attenuation of water for the monochromatic beam, 1/mm.
    materials : mapping
        Section `materials` of the configuration: conversion of HU to materials.
    phantom : str, Path or None
        Image of the study's phantom, HU; None if `settings` has a disc or an object.
    seed : int
        Seed of the study, for simulated noise.
    protocol : Protocol or None
        None for projections.
    """

    folder: str | Path
    settings: Settings
    mu_water_per_mm: float
    materials: Mapping
    phantom: str | Path | None = None
    seed: int = 0
    protocol: Protocol | None = None
    threads: int = 1

    def located(self, location: Mapping[str, float]) -> DiagnosisRequest:
        """Return the request with the object at this location; itself if the location is empty."""
        return replace(self, settings=replace(self.settings, location=dict(location))) if location else self

    @classmethod
    def of(cls, model: Mapping, phantom: str | Path | None, threads: int) -> DiagnosisRequest:
        """Read what a job is given (study.diagnosis_jobs.Diagnosis.model)."""
        protocol = model["protocol"] and Protocol(**model["protocol"])
        given = {**model, "settings": Settings.of(model["settings"]), "protocol": protocol}
        return cls(**given, phantom=phantom, threads=threads)


@dataclass(frozen=True)
class NominalSettings:
    """Nominal settings of the scanner, from recording.yaml."""

    anode: Anode
    tube_kvp: float | None
    sensor: Sensor
