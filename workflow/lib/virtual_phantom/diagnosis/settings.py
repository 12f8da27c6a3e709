"""Section `diagnosis` of the configuration."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from ..base.geometry import ImageProtocol
from ..base.settings import MaterialSettings

# {input of the job of a recording that describes the object: input of the job of a scanner}
OBJECT_INPUTS = {"mask": "masks", "labels": "label_maps", "shapes": "shapes", "simulation": "simulations"}

Baseline = dict[str, dict[str, dict[str, float]]]  # {effect: {parameter: {value, sd}}}


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
        Material by label (physics.scenes.labeled.label_materials).
    """

    labels: str
    materials: dict[str, Any]


@dataclass(frozen=True)
class ShapesObject:
    """An object of shapes.

    Attributes
    ----------
    kind : str
        Name of a shipped object, or path of a file (physics.scenes.objects.read_object).
    """

    kind: str
    parameters: dict[str, float | str] | None = None


@dataclass(frozen=True)
class OtherScan:
    """An object that is given as another scan of it (images.other_scan).

    Attributes
    ----------
    scan : str
        Path of the folder of a recording of images, or of an image in HU.
    """

    scan: str


@dataclass(frozen=True)
class UnknownObject:
    """An object that is not known: only the data themselves are checked (setup.unknown_object)."""

    unknown: bool


@dataclass(frozen=True)
class ObjectUncertainty:
    """Standard deviations of errors of the stated object.

    Attributes
    ----------
    density : float
        Relative, of the density of each material.
    hu : float
        HU of a phantom.
    surface_mm : float
        Location of the surface of each part, mm.
    materials : dict of str to float
        {material: relative standard deviation of its density}, which replaces `density`.
    """

    density: float = 0.01
    hu: float = 5.0
    surface_mm: float = 0.2
    materials: dict[str, float] = field(default_factory=dict)

    def density_of(self, material: str) -> float:
        """Return the relative standard deviation of a material's density."""
        return self.materials.get(material, self.density)


@dataclass(frozen=True)
class RecordingSettings:
    """Section diagnosis.recordings.<name>.

    Attributes
    ----------
    samples : int or None
        Rays per detector pixel and direction; None: workload.SAMPLES.
    view_step : int or None
        Step between the views that are used; None: see workload.step_for.
    alignment : mapping of str to float
        {nuisance parameter: standard deviation that replaces the default}.
    nominal_photons : float or None
        Stated noise-equivalent photons per pixel in air.
    disc, object
        The scanned object; with neither and without `simulation`, the study's phantom was scanned.
    simulation : str or None
        Path of the user's own simulation of the recording, in place of an object (projections.own_simulation,
        images.setting.simulated_images).
    simulation_energy_kev : float or None
        Energy of a simulation without a declared spectrum; None: the energy of the study's monochromatic beam.
    protocol : str or None
        Name of the protocol that simulates a recording of images.
    location : mapping of str to float
        Object location (fitting.nuisance.PLACE), mm from the isocenter and degrees; 0 if not stated.
    slices : tuple of 2 int or None
        First and last slice of images that show the object, from 0; None: the central ones.
    check_setup : bool
        Whether the set-up of the scan is checked first.
    object_may_differ : bool or float
        See run.find_missing_physics.
    object_exact : bool
        Whether the object is known exactly; otherwise with the errors of `object_uncertainty`.
    baseline : mapping
        Declared physics, {effect: {parameter: {value, sd}}} (fitting.priors).
    effects : tuple of str or None
        Effects to try; None: all.
    physics_from, baseline_from : str or None
        Other diagnosed recording: all its physics is used unchanged, or its findings are declared here.
    """

    samples: int | None
    view_step: int | None
    alignment: dict[str, float]
    nominal_photons: float | None = None
    disc: Disc | None = None
    object: MaskedObject | LabelledObject | ShapesObject | OtherScan | UnknownObject | None = None
    simulation: str | None = None
    simulation_energy_kev: float | None = None
    protocol: str | None = None
    location: dict[str, float] = field(default_factory=dict)
    slices: tuple[int, ...] | None = None
    check_setup: bool = False
    object_may_differ: bool | float = False
    object_exact: bool = False
    object_uncertainty: ObjectUncertainty = field(default_factory=ObjectUncertainty)
    baseline: Baseline = field(default_factory=dict)
    effects: tuple[str, ...] | None = None
    physics_from: str | None = None
    baseline_from: str | None = None

    @property
    def of_phantom(self) -> bool:
        """Whether the study's phantom was scanned."""
        return self.disc is None and self.object is None and self.simulation is None

    @property
    def of_scan(self) -> bool:
        """Whether another scan stands for the object."""
        return isinstance(self.object, OtherScan)

    @property
    def of_unknown(self) -> bool:
        """Whether the scanned object is not known."""
        return isinstance(self.object, UnknownObject)

    @property
    def in_fits(self) -> RecordingSettings:
        """The settings that fits depend on. A change of the others, such as the list of effects, keeps cached fits."""
        return replace(self, effects=None, physics_from=None, baseline_from=None)


@dataclass(frozen=True)
class ScannerSettings:
    """Section diagnosis.scanners.<name>.

    Attributes
    ----------
    test_recordings : tuple of str
        Recordings that are only used for validation.
    protocols : dict of str to tuple of str
        {protocol: recordings}.
    baseline : dict
        As in RecordingSettings, for all recordings.
    """

    recordings: tuple[str, ...]
    test_recordings: tuple[str, ...]
    protocols: dict[str, tuple[str, ...]]
    baseline: Baseline
    effects: tuple[str, ...] | None = None


@dataclass(frozen=True)
class DiagnosisSettings:
    """Section `diagnosis`.

    Attributes
    ----------
    matters : dict of str to float, or None
        {quantity: relevance threshold}.
    model_accuracy : dict of str to float
        {effect: relative accuracy of its model}.
    """

    comparisons: tuple[str, ...]
    matters: dict[str, float] | None
    fail_on: tuple[str, ...]
    model_accuracy: dict[str, float]
    recordings: dict[str, RecordingSettings]
    scanners: dict[str, ScannerSettings]


@dataclass(frozen=True)
class FitSettings:
    """Settings that all fits of a recording depend on.

    Attributes
    ----------
    folder : str
        Folder of the recording.
    settings : RecordingSettings
        Only what fits depend on (`RecordingSettings.in_fits`).
    mu_water_per_mm : float
        Attenuation of water for the monochromatic beam, 1/mm.
    materials : MaterialSettings
        Conversion of HU to materials.
    seed : int
        Seed of the study, for simulated noise.
    protocol : ImageProtocol or None
        None for projections.
    """

    folder: str
    settings: RecordingSettings
    mu_water_per_mm: float
    materials: MaterialSettings
    seed: int
    protocol: ImageProtocol | None
