"""Grids and scan geometries, and the coordinate system of the whole package.

The scanner frame is right-handed, in mm, with the axes of NIfTI's RAS world frame: +x to the patient's right, +y to
anterior, +z to superior, along the table. The isocenter is the center of the volume. At view angle b (radians)::

    source           (-R sin b,  R cos b,  z_b)        R = source_to_isocentre_mm; at b = 0 the source is at +y
    detector columns ( cos b,    sin b,    0  )        unit vector of increasing column
    detector rows    ( 0,        0,        1  )        unit vector of increasing row

The detector's center is opposite the source, at the distance source_to_detector_mm. With a flying focal spot, the
position above is the focal center and the detector does not move. Arrays are indexed volume[z, y, x] and
projections[view, row, column]; every index increases along its positive axis. vectors.py defines general scans and
rays.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from .errors import InputError
from .settings import FbpSettings, GridSettings, ScanSettings, SirtSettings, to_mapping
from .vectors import CYLINDRICAL, FLAT, ScanGeometry

# Distances of a parallel beam: from source to isocenter, and from isocenter to detector, which is behind any object.
# Rays are parallel to 1e-6 of their spacing, and float64 resolves positions along them to 1e-6 mm.
PARALLEL_MM, BEHIND_MM = 1e9, 1e3
PARALLEL = "parallel"  # value of `scan.beam`
SPOT_KEYS = ("columns_mm", "radius_mm", "z_mm")  # keys of `flying_focal_spot` in a `scan` section


@dataclass(frozen=True)
class Grid:
    """A regular voxel grid with axes along the scanner frame.

    Attributes
    ----------
    shape : tuple of 3 int
        Voxels (z, y, x).
    spacing : tuple of 3 float
        Voxel size in mm (z, y, x).
    centre_mm : tuple of 3 float
        Center of the grid in the NIfTI world frame, mm (x, y, z).
    directions : tuple of 3 tuple of 3 float, or None
        Unit vectors of the axes x, y and z of an image that is slightly rotated but read as upright. Regions that were
        drawn on the image refer to these axes (`drawn_affine`); everything else treats the grid as upright.

    Raises
    ------
    InputError
        If there are not three positive voxel counts and sizes.
    """

    shape: tuple[int, int, int]
    spacing: tuple[float, float, float]
    centre_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    directions: tuple[tuple[float, ...], ...] | None = field(default=None, compare=False, repr=False)

    def __post_init__(self):
        object.__setattr__(self, "shape", tuple(int(n) for n in self.shape))
        object.__setattr__(self, "spacing", tuple(float(s) for s in self.spacing))
        object.__setattr__(self, "centre_mm", tuple(float(c) for c in self.centre_mm))
        if len(self.shape) != 3 or min(self.shape) < 1:
            raise InputError(f"grid shape {self.shape}: give three positive voxel counts (z, y, x)")
        if len(self.spacing) != 3 or not all(math.isfinite(s) and s > 0 for s in self.spacing):
            raise InputError(f"grid spacing {self.spacing}: give three positive lengths in mm (z, y, x)")

    @property
    def affine(self) -> np.ndarray:
        """4 x 4 matrix from voxel index (x, y, z) to NIfTI world mm (x, y, z)."""
        return self._affine(np.eye(3))

    @property
    def drawn_affine(self) -> np.ndarray:
        """Matrix like `affine`, but along `directions`, as used by programs in which regions are drawn."""
        return self._affine(self._axes)

    @property
    def _axes(self) -> np.ndarray:
        return np.eye(3) if self.directions is None else np.transpose(self.directions)

    def _affine(self, axes: np.ndarray) -> np.ndarray:
        matrix = np.eye(4)
        matrix[:3, :3] = axes * self.spacing[::-1]
        matrix[:3, 3] = np.array(self.centre_mm) - matrix[:3, :3] @ (np.array(self.shape[::-1]) - 1) / 2
        return matrix

    @property
    def voxel_volume_mm3(self) -> float:
        """Volume of one voxel, cubic mm."""
        return math.prod(self.spacing)

    @property
    def extent_mm(self) -> tuple[float, float, float]:
        """Edge lengths of the whole grid, mm (z, y, x)."""
        return tuple(n * s for n, s in zip(self.shape, self.spacing, strict=True))

    def axes_mm(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return voxel centers along z, y and x in mm from the center of the grid (the isocenter)."""
        return tuple((np.arange(n) - (n - 1) / 2) * s for n, s in zip(self.shape, self.spacing, strict=True))

    def refined(self, factor: int) -> Grid:
        """Return a grid of the same extent, sampled `factor` times finer along each axis."""
        return replace(
            self, shape=tuple(n * factor for n in self.shape), spacing=tuple(s / factor for s in self.spacing)
        )

    def matches(self, other: Grid, tolerance_mm: float = 1e-3) -> bool:
        """Return whether both grids have the same voxels at the same positions, to `tolerance_mm` everywhere."""
        return self.shape == other.shape and bool(
            np.all(np.abs(self._corners_mm() - other._corners_mm()) < tolerance_mm)
        )

    def _corners_mm(self) -> np.ndarray:
        last = np.array(self.shape[::-1]) - 1
        return np.stack([self.affine[:3, 3], self.affine[:3, :3] @ last + self.affine[:3, 3]])

    def displacement_by_rotation(self, other: Grid) -> float:
        """Return the largest displacement of a voxel that the different `directions` of two grids cause, in voxels."""
        spacing = np.array(self.spacing[::-1])
        ends = (np.array(self.shape[::-1]) - 1) / 2 * spacing
        return float((np.abs(self._axes - other._axes) @ ends / spacing).max())

    def __str__(self) -> str:
        nz, ny, nx = self.shape
        dz, dy, dx = self.spacing
        return f"{nx} x {ny} x {nz} voxels of {dx:g} x {dy:g} x {dz:g} mm (x, y, z) centered at {self.centre_mm}"


@dataclass(frozen=True, kw_only=True)
class OrbitGeometry(ScanGeometry):
    """A circular or helical scan (see the module's docstring for the frame).

    The detector's reference point is the foot of the perpendicular from the focal center. If the radius of a
    cylindrical detector is not given, the focal center is its focus. ScanGeometry describes the other attributes.

    Attributes
    ----------
    source_to_isocentre_mm : float
        Radius of the focal center's orbit, mm.
    source_to_detector_mm : float
        Distance from the focal center to the detector's reference point, mm.
    angles_rad : ndarray, shape (views,)
    source_z_mm : ndarray, shape (views,)
        Height of the focal center in every view, mm; constant for a circular scan.
    views_per_rotation : float
        Views per turn, for the weights of FDK.
    spots_mm : ndarray, shape (spots, 3)
        Position of the focal spot relative to the focal center, mm: along the columns, away from the isocenter, along
        z. View i has spot i mod spots. A single spot at 0 does not fly.

    Raises
    ------
    InputError
        If there is no view, the arrays differ in length, the isocenter is not between source and detector, or spots are
        impossible.
    """

    source_to_isocentre_mm: float
    source_to_detector_mm: float
    angles_rad: np.ndarray
    source_z_mm: np.ndarray
    views_per_rotation: float
    spots_mm: np.ndarray = ((0.0, 0.0, 0.0),)

    def __post_init__(self):
        self._freeze("angles_rad", "source_z_mm", "spots_mm")
        if self.surface == CYLINDRICAL and self.arc_radius_mm is None:
            object.__setattr__(self, "arc_radius_mm", float(self.source_to_detector_mm))
        if self.angles_rad.ndim != 1 or self.angles_rad.size < 1 or self.angles_rad.shape != self.source_z_mm.shape:
            raise InputError("scan geometry: need at least one view, and one source height for every view angle")
        self._check()
        if not 0 < self.source_to_isocentre_mm < self.source_to_detector_mm:
            raise InputError(
                f"source_to_isocentre_mm {self.source_to_isocentre_mm} must be positive and less than "
                f"source_to_detector_mm {self.source_to_detector_mm}"
            )
        self._check_spots()

    def _check_spots(self) -> None:
        spots = self.spots_mm
        if spots.ndim != 2 or spots.shape[1] != 3 or not 1 <= len(spots) <= self.views:
            raise InputError("scan geometry: need three lengths for each focal spot, and no more spots than views")
        if not np.abs(spots).max() < min(self.source_to_isocentre_mm, self.source_to_detector_mm) / 2:
            raise InputError(
                f"scan geometry: a focal spot {np.abs(spots).max():g} mm from the focal center is too far away; "
                "are all lengths in mm?"
            )

    @property
    def has_focal_spot_offset(self) -> bool:
        """Whether a focal spot is away from the focal center: a flying or a displaced focal spot."""
        return bool(self.spots_mm.any())

    @property
    def spot_of_view(self) -> np.ndarray:
        """Number of the spot in each view, shape (views,)."""
        return np.arange(self.views) % len(self.spots_mm)

    @property
    def views(self) -> int:
        """Number of views."""
        return self.angles_rad.size

    @cached_property
    def source_mm(self) -> np.ndarray:
        """Position of the source, mm, shape (views, 3)."""
        sine, cosine = np.sin(self.angles_rad), np.cos(self.angles_rad)
        radius = self.source_to_isocentre_mm
        return np.stack([-radius * sine, radius * cosine, self.source_z_mm], axis=1) + self._spot_offset_mm

    @cached_property
    def toward_mm(self) -> np.ndarray:
        """Vector from the source to the detector's reference point, mm, shape (views, 3)."""
        sine, cosine = np.sin(self.angles_rad), np.cos(self.angles_rad)
        distance = self.source_to_detector_mm
        return np.stack([distance * sine, -distance * cosine, np.zeros(self.views)], axis=1) - self._spot_offset_mm

    @cached_property
    def _spot_offset_mm(self) -> np.ndarray | float:
        """Vector from the focal center to the source, mm, shape (views, 3); 0 without an offset."""
        if not self.has_focal_spot_offset:
            return 0.0
        along, away, up = self.spots_mm[self.spot_of_view].T[..., None]
        return along * self.column_direction - away * self.normal + up * self.row_direction

    @cached_property
    def detector_mm(self) -> np.ndarray:
        """Position of the detector's reference point, mm, shape (views, 3)."""
        return self.source_mm + self.toward_mm

    @cached_property
    def column_direction(self) -> np.ndarray:
        """Unit vectors of increasing column, shape (views, 3)."""
        return np.stack([np.cos(self.angles_rad), np.sin(self.angles_rad), np.zeros(self.views)], axis=1)

    @cached_property
    def row_direction(self) -> np.ndarray:
        """Unit vectors of increasing row, shape (views, 3)."""
        return np.tile([0.0, 0.0, 1.0], (self.views, 1))

    def every(self, step: int) -> OrbitGeometry:
        """Return the scan with every `step`-th view, at its time."""
        spots = len(self.spots_mm)
        found = self.at(np.arange(0, self.views, step))
        cycle = found.spots_mm[: spots // math.gcd(spots, step)]
        return replace(found, views_per_rotation=self.views_per_rotation / step, spots_mm=cycle)

    def at(self, views: np.ndarray) -> OrbitGeometry:
        """Return the scan with some of the views, by number, at their times and with their spots."""
        return replace(
            self,
            angles_rad=self.angles_rad[views],
            source_z_mm=self.source_z_mm[views],
            view_times=self.view_times[views],
            spots_mm=self.spots_mm[views % len(self.spots_mm)] if len(self.spots_mm) > 1 else self.spots_mm,
        )

    def divided(self, rows: int, columns: int) -> OrbitGeometry:
        """Return the scan with every pixel divided into `rows` times `columns` pixels."""
        return replace(
            self,
            rows=self.rows * rows,
            columns=self.columns * columns,
            row_pitch_mm=self.row_pitch_mm / rows,
            column_pitch_mm=self.column_pitch_mm / columns,
            row_offset_px=self.row_offset_px * rows,
            column_offset_px=self.column_offset_px * columns,
        )

    def turned(self, angle_rad: float) -> OrbitGeometry:
        """Return the scan with source and detector turned about z, from +x to +y."""
        return replace(self, angles_rad=self.angles_rad + angle_rad)

    @property
    def parallel(self) -> bool:
        """Whether the beam is parallel (`parallel_beam`)."""
        return self.source_to_isocentre_mm >= PARALLEL_MM

    @property
    def magnification(self) -> float:
        """Magnification at the isocenter."""
        return self.source_to_detector_mm / self.source_to_isocentre_mm

    @property
    def feed_per_rotation_mm(self) -> float:
        """Table feed per turn, mm; 0 for a circular scan."""
        if self.views < 2:
            return 0.0
        return float(self.source_z_mm[1] - self.source_z_mm[0]) * self.views_per_rotation

    @property
    def field_of_view_radius_mm(self) -> float:
        """Radius of the cylinder around the isocenter that is completely in the fan of every view."""
        half = self.columns / 2 - abs(self.column_offset_px)
        if self.surface == FLAT and not self.has_focal_spot_offset:
            fan = math.atan(half * self.column_pitch_mm / self.source_to_detector_mm)
            return self.source_to_isocentre_mm * math.sin(fan)
        edges = (self.columns / 2 * np.array([-1, 1]) + self.column_offset_px) * self.column_pitch_mm
        low, high = self.from_axis_mm(edges).T
        return max(float(min(-low.max(), high.min())), 0.0)

    def from_axis_mm(self, positions_mm: np.ndarray) -> np.ndarray:
        """Return signed in-plane distances between the rotation axis and rays to column positions, mm.

        The shape is (spots, positions).
        """
        along, away, _ = self.spots_mm.T[..., None]
        to_along, to_ahead = self.from_spots_mm(positions_mm)
        return (along * to_ahead + (self.source_to_isocentre_mm + away) * to_along) / np.hypot(to_along, to_ahead)

    def from_spots_mm(self, positions_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return in-plane vectors from spots to column positions, mm: along the columns, and toward the detector."""
        along, away, _ = self.spots_mm.T[..., None]
        across, nearer = self.on_surface_mm(positions_mm)
        return across - along, self.source_to_detector_mm + away - nearer

    def fan_angles_rad(self) -> np.ndarray:
        """Return the fan angles of the columns from the focal center, radians, shape (columns,)."""
        across, nearer = self.on_surface_mm(self.column_positions_mm())
        return np.arctan2(across, self.source_to_detector_mm - nearer)

    def solid_angles(self) -> np.ndarray:
        """Return ScanGeometry.solid_angles; shape (1, rows, columns) if all views are equal."""
        if self.surface != FLAT or self.has_focal_spot_offset:
            if len(self.spots_mm) > 1:
                return super().solid_angles()
            first = replace(
                self, angles_rad=self.angles_rad[:1], source_z_mm=self.source_z_mm[:1], view_times=self.view_times[:1]
            )
            return super(OrbitGeometry, first).solid_angles()
        off = np.hypot(self.column_positions_mm(), self.row_positions_mm()[:, None])
        return (1 + (off / self.source_to_detector_mm) ** 2)[None] ** -1.5


def orbit_of(geometry: ScanGeometry, who: str) -> OrbitGeometry:
    """Return the geometry unchanged if it is circular or helical. `who` names in the message what needs such a scan.

    Raises
    ------
    InputError
        If the scan is neither circular nor helical.
    """
    if not isinstance(geometry, OrbitGeometry):
        raise InputError(f"{who} needs a circular or helical scan; the scan geometry is given view by view")
    return geometry


def circular(
    *, views: int, turns: float = 1.0, start_angle_rad: float = 0.0, direction: int = 1, **detector
) -> OrbitGeometry:
    """Return a circular scan: views evenly spaced over some turns at one table position.

    Parameters
    ----------
    start_angle_rad : float, optional
        Angle of the first view, radians.
    direction : {1, -1}, optional
        Direction of rotation: 1 from +x to +y.
    **detector
        Other fields of OrbitGeometry.
    """
    views_per_rotation = views / turns
    angles = start_angle_rad + direction * 2 * np.pi * np.arange(views) / views_per_rotation
    return OrbitGeometry(
        angles_rad=angles, source_z_mm=np.zeros(views), views_per_rotation=views_per_rotation, **detector
    )


def helical(
    *,
    views: int,
    volume_height_mm: float,
    pitch: float = 1.0,
    turns: float | None = None,
    start_angle_rad: float = 0.0,
    direction: int = 1,
    **detector,
) -> OrbitGeometry:
    """Return a helical scan: views evenly spaced on a helix centered at the isocenter.

    Parameters
    ----------
    volume_height_mm : float
        Height that the beam must cover, mm.
    pitch : float, optional
        Table feed per turn over the detector's height at the isocenter (IEC 60601-2-44).
    turns : float, optional
        None: (volume height + beam height) / feed, so that the whole beam covers the whole volume.
    start_angle_rad : float, optional
        Angle of the first view, radians.
    direction : {1, -1}, optional
        Direction of rotation: 1 from +x to +y.
    **detector
        Other fields of OrbitGeometry.
    """
    beam = (
        detector["rows"]
        * detector["row_pitch_mm"]
        * detector["source_to_isocentre_mm"]
        / detector["source_to_detector_mm"]
    )
    feed = pitch * beam
    turns = (volume_height_mm + beam) / feed if turns is None else turns
    views_per_rotation = views / turns
    turn = (np.arange(views) - (views - 1) / 2) / views_per_rotation
    angles = start_angle_rad + direction * 2 * np.pi * np.arange(views) / views_per_rotation
    return OrbitGeometry(angles_rad=angles, source_z_mm=turn * feed, views_per_rotation=views_per_rotation, **detector)


def parallel_beam() -> dict[str, float]:
    """Return the distances of a parallel beam, mm, as fields of OrbitGeometry for `circular` and `helical`.

    The source is so far away that its rays are parallel within rounding, and the magnification is 1.
    """
    return {"source_to_isocentre_mm": PARALLEL_MM, "source_to_detector_mm": PARALLEL_MM + BEHIND_MM}


def with_beam(scan: Mapping) -> dict:
    """Return a `scan` section, of a study or a recording, with the source and detector distances of its beam.

    With `beam: parallel`, the distances of `parallel_beam` replace the section's own distances.
    """
    return dict(scan) | (parallel_beam() if scan.get("beam") == PARALLEL else {})


def grid_of(settings: GridSettings) -> Grid:
    """Return the grid of the configuration's `grid` section, centered at 0, on which the phantom is made.

    A CT phantom has its own position in the world, so later steps use the grid of the phantom's image.
    """
    return Grid(settings.shape, settings.spacing_mm)


def scan_geometry(scan: ScanSettings, projections: int, grid: Grid) -> OrbitGeometry:
    """Return the geometry of a study's scan with this number of projections; without `turns`, a helix covers `grid`."""
    if scan.beam == PARALLEL:
        scan = replace(scan, **parallel_beam())
    detector = {
        key: getattr(scan, key)
        for key in (
            "source_to_isocentre_mm",
            "source_to_detector_mm",
            "columns",
            "rows",
            "column_pitch_mm",
            "row_pitch_mm",
            "column_offset_px",
            "row_offset_px",
        )
    }
    detector |= detector_and_spot_fields(to_mapping(scan))
    start = math.radians(scan.start_angle_deg)
    if scan.trajectory == "circular":
        geometry = circular(views=projections, turns=scan.turns or 1.0, start_angle_rad=start, **detector)
    else:
        geometry = helical(
            views=projections,
            volume_height_mm=grid.extent_mm[0],
            pitch=scan.pitch,
            turns=scan.turns,
            start_angle_rad=start,
            **detector,
        )
    return replace(geometry, view_interval_ms=scan.rotation_time_ms / geometry.views_per_rotation)


def detector_and_spot_fields(scan: dict) -> dict:
    """Return the detector surface and focal spots of a `scan` section as fields of OrbitGeometry, with defaults."""
    surface, radius = scan.get("detector", FLAT), scan.get("arc_radius_mm")
    spots = [[spot.get(key, 0.0) for key in SPOT_KEYS] for spot in scan.get("flying_focal_spot") or [{}]]
    return {"surface": surface, "arc_radius_mm": radius, "spots_mm": np.array(spots, float)}


def detector_and_spot_keys(geometry: OrbitGeometry) -> dict:
    """Return beam, detector surface and focal spots of a geometry as keys of a recording's `scan` section."""
    stated = {"beam": PARALLEL} if geometry.parallel else {}
    stated |= {"detector": geometry.surface}
    if geometry.surface != FLAT and geometry.arc_radius_mm != geometry.source_to_detector_mm:
        stated["arc_radius_mm"] = geometry.arc_radius_mm
    if geometry.has_focal_spot_offset:
        stated["flying_focal_spot"] = [dict(zip(SPOT_KEYS, spot, strict=True)) for spot in geometry.spots_mm.tolist()]
    return stated


@dataclass(frozen=True)
class ImageProtocol:
    """The protocol of a study that simulates a recording of images.

    Attributes
    ----------
    projections : int
        Number of views.
    algorithm : {"sirt", "fbp"}
    """

    scan: ScanSettings
    grid: GridSettings
    projections: int
    algorithm: str
    settings: SirtSettings | FbpSettings
    engine: str

    @property
    def geometry(self) -> OrbitGeometry:
        """Geometry of the scan."""
        return scan_geometry(self.scan, self.projections, grid_of(self.grid))
