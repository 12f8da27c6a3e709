"""Settings as dataclasses: sections of the configuration that several packages read, and the conversion from mappings.

The JSON schemas state the checks and the defaults. `from_mapping` converts a document that a schema has checked and
completed. A key that may be absent from the document has the default None here, and `to_mapping` omits it if it is
None. A key whose schema default is null has no default here, so that `to_mapping` keeps its null. Therefore
`to_mapping(from_mapping(kind, document)) == document` holds.
"""

from __future__ import annotations

import types
import typing
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import cache
from typing import Any


def from_mapping(kind: Any, value: Any) -> Any:
    """Convert JSON-like data to a type: a dataclass, a tuple or dict of them, a union of them, or a plain value.

    In a union, the first dataclass whose required keys are all given is chosen. A missing required key becomes None.
    """
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if value is None:
        return None
    if origin in (types.UnionType, typing.Union):
        kinds = [one for one in arguments if one is not types.NoneType]
        if len(kinds) > 1:
            kinds = [one for one in kinds if is_dataclass(one) and _required(one) <= value.keys()]
        return from_mapping(kinds[0], value) if kinds else value
    if origin is tuple:
        return tuple(from_mapping(arguments[0], item) for item in value)
    if origin is dict:
        return {key: from_mapping(arguments[1], item) for key, item in value.items()}
    if is_dataclass(kind):
        given = {name: from_mapping(hint, value[name]) for name, hint in _hints(kind).items() if name in value}
        return kind(**dict.fromkeys(_required(kind)) | given)
    return value


def to_mapping(value: Any) -> Any:
    """Convert settings to JSON-like data, such as parameters of a rule, which Snakemake compares by their text."""
    if is_dataclass(value):
        items = [(one, getattr(value, one.name)) for one in fields(value)]
        return {one.name: to_mapping(item) for one, item in items if item is not None or one.default is not None}
    if isinstance(value, Mapping):
        return {key: to_mapping(item) for key, item in value.items()}
    return [to_mapping(item) for item in value] if isinstance(value, tuple) else value


@cache
def _hints(kind: type) -> dict[str, Any]:
    hints = typing.get_type_hints(kind)
    return {one.name: hints[one.name] for one in fields(kind)}


@cache
def _required(kind: type) -> frozenset[str]:
    return frozenset(one.name for one in fields(kind) if one.default is one.default_factory is MISSING)


@dataclass(frozen=True)
class GridSettings:
    """Section `grid`; shape and spacing are (z, y, x)."""

    shape: tuple[int, ...]
    spacing_mm: tuple[float, ...]
    oversampling: int


@dataclass(frozen=True)
class FocalSpot:
    """A position of a flying focal spot relative to the focal center, mm."""

    columns_mm: float
    radius_mm: float
    z_mm: float


@dataclass(frozen=True)
class ScanSettings:
    """Section `scan`, or a complete entry of `scans`."""

    trajectory: str
    pitch: float
    turns: float | None
    start_angle_deg: float
    rotation_time_ms: float
    source_to_isocentre_mm: float
    source_to_detector_mm: float
    beam: str
    detector: str
    arc_radius_mm: float | None
    flying_focal_spot: tuple[FocalSpot, ...] | None
    columns: int
    rows: int
    column_pitch_mm: float
    row_pitch_mm: float
    column_offset_px: float
    row_offset_px: float
    samples: int = 1


@dataclass(frozen=True)
class ShapedRoi:
    """An entry of `phantom.object.rois`: the visible part of one shape.

    Attributes
    ----------
    shape : str
        Name of the shape.
    margin_mm : float
        Erosion of the region, mm.
    """

    name: str
    tissue_class: str
    shape: str
    margin_mm: float = 0.0


@dataclass(frozen=True)
class ShapesPhantom:
    """Section `phantom.object`."""

    kind: str
    parameters: dict[str, float | str] | None = None
    rois: tuple[ShapedRoi, ...] | None = None


@dataclass(frozen=True)
class RoiEntry:
    """An entry of `phantom.ct.rois`.

    Attributes
    ----------
    file : str or None
        None: the common file of the section.
    label : int, str or None
        Region of the file: a number from 1, or a name.
    margin_mm : float
        Voxels closer than this to the surface of the region are excluded.
    parts : int
        Number of compact ROIs that the region is cut into, named name_1, name_2, ...
    fill_gaps : bool
        Interpolate empty slices between drawn ones.
    """

    name: str
    tissue_class: str
    file: str | None = None
    label: int | str | None = None
    margin_mm: float = 0.0
    parts: int = 1
    fill_gaps: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the ROIs of the entry."""
        return (self.name,) if self.parts == 1 else tuple(f"{self.name}_{i}" for i in range(1, self.parts + 1))


@dataclass(frozen=True)
class CtPhantom:
    """Section `phantom.ct`; lengths in the NIfTI world frame, mm."""

    rois: tuple[RoiEntry, ...]
    image: str | None = None
    labels: str | None = None
    centre_mm: tuple[float, ...] | None = None
    keep_mm: tuple[tuple[float, ...], ...] | None = None
    not_checked: tuple[str, ...] | None = None


@dataclass(frozen=True)
class PhantomSettings:
    """Section `phantom`."""

    source: str
    layout: str | None
    object: ShapesPhantom | None = None
    ct: CtPhantom | None = None


@dataclass(frozen=True)
class MaterialSettings:
    """Section `materials`: arguments of physics.beam.materials.Segmentation."""

    soft: str
    dense: str | None
    dense_from_hu: float


@dataclass(frozen=True)
class SensorSettings:
    """Section `sensor`: arguments of physics.beam.sensors.Sensor."""

    material: str
    reads: str


@dataclass(frozen=True)
class KernelSettings:
    """Section `protocols.*.kernel`: arguments of reconstruction.kernel.Kernel."""

    mtf50_per_cm: float
    mtf10_per_cm: float


@dataclass(frozen=True)
class NoiseKernelSettings(KernelSettings):
    """Section `protocols.*.noise_kernel`: a kernel and the noise variance that it gives."""

    variance: float


@dataclass(frozen=True)
class VoxelSettings:
    """Section `protocols.*.voxels`; the voxel size is (z, y, x)."""

    spacing_mm: tuple[float, ...]
    thickness_mm: float


@dataclass(frozen=True)
class SirtSettings:
    """Section `reconstruction.sirt`: arguments of reconstruction.sirt.sirt."""

    iterations: int
    solver: str
    backprojector: str
    terms: int
    tolerance_hu: float


@dataclass(frozen=True)
class FbpSettings:
    """Section `reconstruction.fbp`, with the kernels of a protocol."""

    normalise: str
    kernel: KernelSettings | None = None
    noise_kernel: NoiseKernelSettings | None = None


@dataclass(frozen=True)
class ImageSettings:
    """Reconstruction of the images of a protocol. `physics` has the effects of stage "image" and their parameters."""

    protocol: str
    algorithm: str
    settings: SirtSettings | FbpSettings
    physics: dict
    voxels: VoxelSettings | None = None
