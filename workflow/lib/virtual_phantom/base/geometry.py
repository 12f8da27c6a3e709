"""Grids and scan geometries, and the one statement of the coordinates that everything here uses.

Right-handed scanner frame in mm, the axes of NIfTI's RAS world frame: +x to the patient's right, +y to anterior,
+z to superior, along the table. The isocentre lies at the centre of the volume. At view angle b (radians)

    source           (-R sin b,  R cos b,  z_b)        R = source_to_isocentre_mm; at b = 0 the source is at +y
    detector columns ( cos b,    sin b,    0  )        unit vector of increasing column
    detector rows    ( 0,        0,        1  )        unit vector of increasing row

and the detector's centre lies opposite the source at distance source_to_detector_mm from it. Arrays are indexed
volume[z, y, x] and projections[view, row, column], each index running along the positive axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np

from .errors import InputError


@dataclass(frozen=True)
class Grid:
    """A regular voxel grid, its axes along the scanner frame.

    shape      voxels (z, y, x)
    spacing    mm (z, y, x)
    centre_mm  where the centre of the grid lies in the NIfTI world frame, mm (x, y, z)
    """

    shape: tuple[int, int, int]
    spacing: tuple[float, float, float]
    centre_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)

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
        matrix = np.diag([*self.spacing[::-1], 1.0])
        extent = (np.array(self.shape[::-1]) - 1) * np.array(self.spacing[::-1])
        matrix[:3, 3] = np.array(self.centre_mm) - extent / 2
        return matrix

    @property
    def voxel_volume_mm3(self) -> float:
        return math.prod(self.spacing)

    @property
    def extent_mm(self) -> tuple[float, float, float]:
        """Edge lengths of the whole grid, mm (z, y, x)."""
        return tuple(n * s for n, s in zip(self.shape, self.spacing, strict=True))

    def axes_mm(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Voxel centres along z, y and x in mm from the centre of the grid (the isocentre)."""
        return tuple((np.arange(n) - (n - 1) / 2) * s for n, s in zip(self.shape, self.spacing, strict=True))

    def refined(self, factor: int) -> Grid:
        """The same box sampled `factor` times finer along each axis."""
        return replace(
            self, shape=tuple(n * factor for n in self.shape), spacing=tuple(s / factor for s in self.spacing)
        )

    def matches(self, other: Grid, tolerance_mm: float = 1e-3) -> bool:
        """True if both grids put the same voxels at the same places (to `tolerance_mm` anywhere in the volume)."""
        return self.shape == other.shape and bool(
            np.all(np.abs(self._corners_mm() - other._corners_mm()) < tolerance_mm)
        )

    def _corners_mm(self) -> np.ndarray:
        last = np.array(self.shape[::-1]) - 1
        return np.stack([self.affine[:3, 3], self.affine[:3, :3] @ last + self.affine[:3, 3]])

    def __str__(self) -> str:
        nz, ny, nx = self.shape
        dz, dy, dx = self.spacing
        return f"{nx} x {ny} x {nz} voxels of {dx:g} x {dy:g} x {dz:g} mm (x, y, z) centred at {self.centre_mm}"


@dataclass(frozen=True)
class ScanGeometry:
    """Where source and flat detector are in every view (see the module's docstring for the frame).

    angles_rad     view angles, radians, (views,)
    source_z_mm    source height in every view, mm, (views,); constant for a circular scan
    column_offset_px, row_offset_px   shift of the detector's centre along its columns and rows, in pixels
    views_per_rotation  how many views make one turn; weights of FDK need it
    view_interval_ms  from the middle of one view to that of the next; None: not known
    exposure_ms    how long the beam is on in every view's interval, in its middle, while the detector integrates over
                   all of it; None: throughout
    view_times     middle of each view, in intervals from the middle of the scan, (views,); None: one after another,
                   view i of N at i + 1/2 - N/2
    """

    source_to_isocentre_mm: float
    source_to_detector_mm: float
    columns: int
    rows: int
    column_pitch_mm: float
    row_pitch_mm: float
    angles_rad: np.ndarray
    source_z_mm: np.ndarray
    views_per_rotation: float
    column_offset_px: float = 0.0
    row_offset_px: float = 0.0
    view_interval_ms: float | None = None
    exposure_ms: float | None = None
    view_times: np.ndarray | None = None

    def __post_init__(self):
        if self.view_times is None:
            views = np.size(self.angles_rad)
            object.__setattr__(self, "view_times", np.arange(views) + 0.5 - views / 2)
        for name in ("angles_rad", "source_z_mm", "view_times"):
            values = np.array(getattr(self, name), dtype=np.float64)
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        if self.angles_rad.ndim != 1 or self.angles_rad.size < 1 or self.angles_rad.shape != self.source_z_mm.shape:
            raise InputError("scan geometry: need at least one view, and one source height for every view angle")
        if self.view_times.shape != self.angles_rad.shape:
            raise InputError("scan geometry: need one time for every view angle")
        interval = self.view_interval_ms
        if interval is not None and not 0 < interval < math.inf:
            raise InputError(f"scan geometry: view_interval_ms {interval} must be positive")
        if self.exposure_ms is not None and not 0 <= self.exposure_ms <= (interval or math.inf):
            raise InputError(
                f"scan geometry: exposure_ms {self.exposure_ms} must be from 0 to view_interval_ms {interval}"
            )
        if self.columns < 1 or self.rows < 1 or min(self.column_pitch_mm, self.row_pitch_mm) <= 0:
            raise InputError(
                f"detector of {self.columns} columns x {self.rows} rows, {self.column_pitch_mm} x {self.row_pitch_mm} "
                "mm: all four must be positive"
            )
        if not 0 < self.source_to_isocentre_mm < self.source_to_detector_mm:
            raise InputError(
                f"source_to_isocentre_mm {self.source_to_isocentre_mm} must be positive and less than "
                f"source_to_detector_mm {self.source_to_detector_mm}"
            )

    @property
    def views(self) -> int:
        return self.angles_rad.size

    @property
    def times_s(self) -> np.ndarray:
        """When each view is exposed, in the middle of its interval, seconds from the middle of the scan, (views,).

        Raises InputError if the scan's times are not known."""
        return self.view_times * self.known_interval_ms / 1000

    @property
    def duration_s(self) -> float:
        """From the begin of the first view's interval to the end of the last one's. Raises InputError as times_s."""
        return (self.view_times[-1] - self.view_times[0] + self.views_apart) * self.known_interval_ms / 1000

    @property
    def known_interval_ms(self) -> float:
        """view_interval_ms. Raises InputError if it is not known."""
        if self.view_interval_ms is None:
            raise InputError(
                "scan: the time from view to view is not known, by which afterglow, motion and the drift of a dark "
                "signal go; state scan.view_interval_ms or scan.rotation_time_ms"
            )
        return self.view_interval_ms

    @property
    def views_apart(self) -> int:
        """How many of the scanner's views lie from one view to the next: 1, unless only some are kept (`every`)."""
        return 1 if self.views < 2 else round(self.view_times[1] - self.view_times[0])

    def every(self, step: int) -> ScanGeometry:
        """One view of so many, each at its time."""
        return replace(
            self,
            angles_rad=self.angles_rad[::step],
            source_z_mm=self.source_z_mm[::step],
            view_times=self.view_times[::step],
            views_per_rotation=self.views_per_rotation / step,
        )

    @property
    def shape(self) -> tuple[int, int, int]:
        """Of its projections: views, rows, columns."""
        return self.views, self.rows, self.columns

    @property
    def key(self) -> tuple:
        """Equal for geometries whose rays are the same, and hashable."""
        return tuple(
            value.tobytes() if isinstance(value := getattr(self, one.name), np.ndarray) else value
            for one in fields(self)
        )

    @property
    def magnification(self) -> float:
        return self.source_to_detector_mm / self.source_to_isocentre_mm

    @property
    def feed_per_rotation_mm(self) -> float:
        """Table feed per turn, mm; 0 for a circular scan."""
        if self.views < 2:
            return 0.0
        return float(self.source_z_mm[1] - self.source_z_mm[0]) * self.views_per_rotation

    @property
    def field_of_view_radius_mm(self) -> float:
        """Radius of the cylinder around the isocentre that every view sees completely (in-plane)."""
        half = self.columns / 2 - abs(self.column_offset_px)
        fan = math.atan(half * self.column_pitch_mm / self.source_to_detector_mm)
        return self.source_to_isocentre_mm * math.sin(fan)

    def column_positions_mm(self) -> np.ndarray:
        """Column centres along the detector, mm from the ray through the isocentre's axis, (columns,)."""
        return (np.arange(self.columns) - (self.columns - 1) / 2 + self.column_offset_px) * self.column_pitch_mm

    def row_positions_mm(self) -> np.ndarray:
        """Row centres along the detector, mm from the source's own height, (rows,)."""
        return (np.arange(self.rows) - (self.rows - 1) / 2 + self.row_offset_px) * self.row_pitch_mm

    def solid_angles(self) -> np.ndarray:
        """Solid angle under which the source sees each pixel, over that of a pixel at the foot of the perpendicular:
        the inverse square of the distance times the cosine of the incidence, so its cube. [row, column]."""
        off = np.hypot(self.column_positions_mm(), self.row_positions_mm()[:, None])
        return (1 + (off / self.source_to_detector_mm) ** 2) ** -1.5

    def ray(self, view: int, row: int, column: int) -> tuple[np.ndarray, np.ndarray]:
        """Source and detector-pixel centre (x, y, z) in mm of one ray: the definition, not the fast path."""
        b = self.angles_rad[view]
        z = self.source_z_mm[view]
        source = np.array([-math.sin(b), math.cos(b), 0]) * self.source_to_isocentre_mm + [0, 0, z]
        away = np.array([math.sin(b), -math.cos(b), 0]) * self.source_to_detector_mm
        along = np.array([math.cos(b), math.sin(b), 0]) * self.column_positions_mm()[column]
        return source, source + away + along + [0, 0, self.row_positions_mm()[row]]


def circular(
    *, views: int, turns: float = 1.0, start_angle_rad: float = 0.0, direction: int = 1, **detector
) -> ScanGeometry:
    """`views` evenly spaced over `turns` turns at one table position. `detector` holds ScanGeometry's other fields."""
    views_per_rotation = views / turns
    angles = start_angle_rad + direction * 2 * np.pi * np.arange(views) / views_per_rotation
    return ScanGeometry(
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
) -> ScanGeometry:
    """`views` evenly spaced on a helix centred on the isocentre.

    pitch   table feed per turn over the detector's height as seen at the isocentre (IEC 60601-2-44)
    turns   None: as many as carry the whole beam over the whole volume, (volume height + beam height) / feed
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
    return ScanGeometry(angles_rad=angles, source_z_mm=turn * feed, views_per_rotation=views_per_rotation, **detector)


def grid_of(settings: dict) -> Grid:
    """The grid of the configuration's `grid` section, centred at 0: what the phantom is made on.

    A CT puts it where it lies in the world itself, so that from then on the grid is that of the phantom's image.
    """
    return Grid(tuple(settings["shape"]), tuple(settings["spacing_mm"]))


def scan_geometry(scan: dict, projections: int, grid: Grid) -> ScanGeometry:
    """The geometry of a complete `scan` section of the configuration with `projections` views around `grid`."""
    detector = {
        key: scan[key]
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
    start = math.radians(scan["start_angle_deg"])
    if scan["trajectory"] == "circular":
        geometry = circular(views=projections, turns=scan["turns"] or 1.0, start_angle_rad=start, **detector)
    else:
        geometry = helical(
            views=projections,
            volume_height_mm=grid.extent_mm[0],
            pitch=scan["pitch"],
            turns=scan["turns"],
            start_angle_rad=start,
            **detector,
        )
    return replace(geometry, view_interval_ms=scan["rotation_time_ms"] / geometry.views_per_rotation)
