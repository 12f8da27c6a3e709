"""What the configuration asks of the diagnosis of one recording, and what the recording's labels say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from ..base.geometry import OrbitGeometry, grid_of, scan_geometry
from ..physics.beam.sensors import Sensor
from ..physics.beam.spectra import Anode


@dataclass(frozen=True)
class Disc:
    """A homogeneous cylinder along z.

    Attributes
    ----------
    diameter_mm : float
        mm.
    """

    diameter_mm: float
    material: str


@dataclass(frozen=True)
class MaskedObject:
    """A homogeneous object given as a mask.

    Attributes
    ----------
    mask : str
        Path of an image, as projections.scanned.mask_scene reads it.
    """

    mask: str
    material: str


@dataclass(frozen=True)
class LabelledObject:
    """An object given as a label map.

    Attributes
    ----------
    labels : str
        Path of an image of whole numbers.
    materials : mapping of str to str or mapping
        The material of every label, as physics.labelled.materials_of takes it.
    """

    labels: str
    materials: Mapping[str, str | Mapping]


@dataclass(frozen=True)
class ShapesObject:
    """An object of shapes.

    Attributes
    ----------
    kind : str
        Name of one of the library's, or path of a file (physics.objects.read_object).
    parameters : mapping of str to float or str
        Of that.
    """

    kind: str
    parameters: Mapping[str, float | str] = field(default_factory=dict)


@dataclass(frozen=True)
class Settings:
    """diagnosis.recordings.<name> of the configuration, as far as fits depend on it.

    Attributes
    ----------
    samples : int or None
        Rays per detector pixel and direction; None: as many as extent.samples_for says.
    view_step : int or None
        One view of so many is used; None: as few as fits can take.
    alignment : mapping of str to float
        {nuisance parameter: standard deviation that replaces the default}.
    nominal_photons : float or None
        Noise-equivalent photons per pixel in air, as stated.
    object : MaskedObject, LabelledObject, ShapesObject or None
        What was scanned; without both of them, the study's phantom.
    protocol : str or None
        Name of the protocol that simulates a recording of images.
    location : mapping of str to float
        Where the object lies, by name of alignment.LOCATION, mm from the isocenter; 0 where it is not stated.
    check_setup : bool
        Whether the description of the scan is doubted first.
    object_may_differ : bool or float
        As course.explain takes it.
    baseline : mapping
        {effect: {parameter: {value, sd}}}: physics that is known (core.declared).
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
        """From the complete section."""
        scanned: dict = {}
        if "disc" in section:
            scanned["disc"] = Disc(**section["disc"])
        if "object" in section:
            scanned["object"] = _kind_of(section["object"])(**section["object"])
        return cls(**{**section, **scanned})

    @property
    def of_phantom(self) -> bool:
        """Whether the study's phantom was scanned."""
        return self.disc is None and self.object is None

    @property
    def of_shapes(self) -> bool:
        """Whether a disc or an object of shapes was."""
        return self.disc is not None or isinstance(self.object, ShapesObject)


def _kind_of(section: Mapping) -> type:
    if "mask" in section:
        return MaskedObject
    return LabelledObject if "labels" in section else ShapesObject


@dataclass(frozen=True)
class Protocol:
    """The protocol of the study that simulates a recording of images.

    Attributes
    ----------
    scan, grid : mapping
        Sections of the configuration, complete.
    projections : int
        Number of views.
    algorithm : {"sirt", "fbp"}
    settings : mapping
        Keywords of the algorithm.
    engine : str
        Of the algorithm.
    """

    scan: Mapping
    grid: Mapping
    projections: int
    algorithm: str
    settings: Mapping
    engine: str

    @property
    def geometry(self) -> OrbitGeometry:
        """Of the scan."""
        return scan_geometry(self.scan, self.projections, grid_of(self.grid))


@dataclass(frozen=True)
class DiagnosisRequest:
    """What the configuration asks.

    Attributes
    ----------
    folder : str or Path
        Of the recording.
    mu_water_per_mm : float
        Of the monochromatic beam, 1/mm.
    materials : mapping
        How HU are divided, as the configuration's section.
    phantom : str, Path or None
        Image of the study's phantom, HU; None where `settings` has a disc or an object.
    seed : int
        Of the study, for simulated noise.
    protocol : Protocol or None
        None of projections.
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
        """The same with the object where its scan shows it; this one for no location."""
        return replace(self, settings=replace(self.settings, location=dict(location))) if location else self

    @classmethod
    def of(cls, model: Mapping, phantom: str | Path | None, threads: int) -> DiagnosisRequest:
        """From what a job is given (study.diagnosis_jobs.Diagnosis.model)."""
        protocol = model["protocol"] and Protocol(**model["protocol"])
        given = {**model, "settings": Settings.of(model["settings"]), "protocol": protocol}
        return cls(**given, phantom=phantom, threads=threads)


@dataclass(frozen=True)
class NominalSettings:
    """What is written on the scanner.

    Attributes
    ----------
    tube_kvp : float or None
        kV; None: not known.
    """

    anode: Anode
    tube_kvp: float | None
    sensor: Sensor
