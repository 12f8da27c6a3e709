"""Dataclasses of a complete configuration, which `config.read_study` makes after the check with the JSON schema.

Effects with their parameters and conditions of recordings have names that the user chooses, so they stay mappings.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from ..base.geometry import PARALLEL
from ..base.proof_settings import ProofSettings
from ..base.settings import (
    FbpSettings,
    GridSettings,
    KernelSettings,
    MaterialSettings,
    NoiseKernelSettings,
    PhantomSettings,
    ScanSettings,
    SensorSettings,
    SirtSettings,
    VoxelSettings,
)
from ..base.vectors import FLAT
from ..diagnosis.settings import DiagnosisSettings
from ..image_quality.settings import ImageQualitySettings

Effects = dict[str, dict[str, float]]  # {effect: {parameter: value}}
Conditions = dict[str, float | str]  # {condition column of a recording: required value}


@dataclass(frozen=True)
class FeatureSettings:
    """Section `features`: parameter file of pyradiomics, section of each region, and offset of the stored values."""

    parameters: str | None
    section: str
    stored_offset_hu: float


@dataclass(frozen=True)
class NoiseTarget:
    """Section `noise.levels.*.meets`: the ROI variance of a recording."""

    recording: str
    where: Conditions
    rois: tuple[str, ...]
    protocol: str


@dataclass(frozen=True)
class NoiseLevel:
    """Section `noise.levels.*`: A = 1/I0, or the target to which a job matches it."""

    repeats: int
    A: float | None = None
    meets: NoiseTarget | None = None


@dataclass(frozen=True)
class NoiseSettings:
    """Section `noise`."""

    model: str
    draws: str
    zero_counts_as: float
    levels: dict[str, NoiseLevel]


@dataclass(frozen=True)
class Repeats:
    """Section `repeats`: number and largest displacement of re-positioned repeats, and the angle of the first view."""

    repositioned: int
    shift_mm: float
    turn_deg: float
    start_angle: str


@dataclass(frozen=True)
class Protocol:
    """Section `protocols.*`, with the complete effects of scans and of images, or the diagnosis they are taken from."""

    algorithm: str
    projections: int
    group: int | None = None
    noise: tuple[str, ...] | None = None
    scan: str | None = None
    job: str | None = None
    kernel: KernelSettings | None = None
    noise_kernel: NoiseKernelSettings | None = None
    voxels: VoxelSettings | None = None
    physics: Effects | None = None
    image_physics: Effects | None = None
    physics_from: str | None = None

    @property
    def reconstruction(self) -> str:
        """Name of the reconstruction in titles."""
        return "Iterative" if self.noise_kernel else self.algorithm.upper()


@dataclass(frozen=True)
class Reconstruction:
    """Section `reconstruction`."""

    sirt: SirtSettings
    fbp: FbpSettings


@dataclass(frozen=True)
class StatisticsSettings:
    """Section `statistics`: arguments of statistics.wilcoxon.scores."""

    test: str
    compare: str
    threshold: float


@dataclass(frozen=True)
class Measured:
    """Section `measured`."""

    overlay: bool
    table: str | None


@dataclass(frozen=True)
class Dicom:
    """Section `dicom`."""

    images: tuple[str, ...]


@dataclass(frozen=True)
class ScanSelection:
    """Section `public_scans.phantom` or `public_scans.compared`."""

    collection: str
    groups: tuple[int | str, ...] | None = None
    acquisitions: tuple[int, ...] | None = None
    dose_mgy: tuple[float, ...] | None = None
    reconstruction: tuple[str, ...] | None = None


@dataclass(frozen=True)
class PublicScanSettings:
    """Section `public_scans`."""

    own_blur: str
    regions: tuple[int | str, ...]
    phantom: ScanSelection | None = None
    compared: ScanSelection | None = None


@dataclass(frozen=True)
class Downloads:
    """Section `downloads`."""

    htc2022: str
    abdomen_ct: str
    scans: str | None
    endpoint: str
    bucket: str


@dataclass(frozen=True)
class CutOffs:
    """Section `analyses.stability.cut_offs`."""

    w_stability_percent: float
    icc: float
    ccc: float
    cv: float
    qcd: float


@dataclass(frozen=True)
class Stability:
    """Section `analyses.stability`; groups are compared at the first level of `noise` that each protocol has."""

    noise: tuple[str, ...]
    recordings: tuple[str, ...]
    where: dict[str, Conditions]
    without_physics: bool
    noise_control: bool
    cut_offs: CutOffs


@dataclass(frozen=True)
class ExtractionSettings:
    """Section `analyses.extraction`: values of each setting, and the images to extract."""

    bin_width: tuple[float, ...] | None = None
    bin_count: tuple[int, ...] | None = None
    resampled_mm: tuple[float | str, ...] | None = None
    dimensions: tuple[str, ...] | None = None
    protocols: tuple[str, ...] | None = None
    noise: tuple[str, ...] | None = None


@dataclass(frozen=True)
class Optimal:
    """Section `analyses.optimal`: protocols and noise level of the figure of scans."""

    sirt: str
    fbp: str
    noise: str


@dataclass(frozen=True)
class NoiseCalibration:
    """Section `analyses.noise_calibration`."""

    protocols: tuple[str, ...]
    noise: tuple[str, ...]


@dataclass(frozen=True)
class Components:
    """Section `analyses.pca.*`."""

    protocols: tuple[str, ...]
    noise: tuple[str, ...]
    fit_on: str
    recordings: tuple[str, ...]
    by: tuple[str, ...]
    standardise: str


@dataclass(frozen=True)
class Comparison:
    """Section `analyses.comparison.*`."""

    recording: str
    where: Conditions
    protocol: str
    noise: str
    margin_sd: float
    rois: tuple[str, ...] | None = None


@dataclass(frozen=True)
class Analyses:
    """Section `analyses`."""

    stability: Stability | None = None
    extraction: ExtractionSettings | None = None
    optimal: Optimal | None = None
    noise_calibration: NoiseCalibration | None = None
    pca: dict[str, Components] = field(default_factory=dict)
    comparison: dict[str, Comparison] = field(default_factory=dict)


@dataclass(frozen=True)
class Study:
    """A complete configuration."""

    base: str
    seed: int
    results_dir: str
    trial: bool | str
    engine: str
    threads: int
    seeds_per_job: int
    keep_projections: bool
    keep_images: bool
    features: FeatureSettings
    phantom: PhantomSettings
    grid: GridSettings
    mu_water_per_mm: float
    scan: ScanSettings
    scans: dict[str, ScanSettings]
    noise: NoiseSettings
    repeats: Repeats
    protocols: dict[str, Protocol]
    reconstruction: Reconstruction
    statistics: StatisticsSettings
    measured: Measured
    recordings: dict[str, str]
    image_quality: dict[str, ImageQualitySettings]
    physics: dict
    materials: MaterialSettings
    sensor: SensorSettings
    dicom: Dicom
    diagnosis: DiagnosisSettings
    proof: ProofSettings
    public_scans: PublicScanSettings
    subset: str
    keep_scans: bool
    verdicts: str
    downloads: Downloads
    analyses: Analyses

    @property
    def engine_needs(self) -> dict:
        """Return the settings that decide which engines are possible: arguments of projectors.choose_engine."""
        algorithms = {protocol.algorithm for protocol in self.protocols.values()}
        scans = [scan for scan in (self.scan, *self.scans.values()) if scan is not None]
        return {
            "backprojector": self.reconstruction.sirt.backprojector if "sirt" in algorithms else None,
            "normalise": self.reconstruction.fbp.normalise if "fbp" in algorithms else None,
            "flat": all(scan.detector == FLAT and scan.beam != PARALLEL for scan in scans),
        }

    @property
    def results(self) -> str:
        """The folder of all results, without a last slash."""
        return self.results_dir.rstrip("/")
