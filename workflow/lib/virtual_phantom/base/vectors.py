"""Scan geometries as vectors: positions of the source, the detector and its pixels in every view.

A ray runs from the source to the center of a pixel. Pixel (row, column) of a flat detector is at::

    detector_mm + u column_direction + v row_direction        u, v: column_positions_mm, row_positions_mm

and a pixel of a cylindrical detector, an arc of radius r about a focus, is at::

    detector_mm + r sin(u / r) column_direction - r (1 - cos(u / r)) normal + v row_direction

in the frame of geometry.py. All other modules use these definitions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from .errors import InputError

# Largest rounding error of a direction's length and of a right angle's cosine.
ROUNDING = 1e-9
FLAT, CYLINDRICAL = "flat", "cylindrical"


class Upright(NamedTuple):
    """In-plane description of a scan whose detector rows are stacked along z. All arrays have shape (views,).

    Attributes
    ----------
    cosine, sine : ndarray
        Column direction (cosine, sine, 0); the detector faces the source along (sine, -cosine, 0).
    depth : ndarray
        Distance from the source to the isocenter along the facing direction, mm.
    beside : ndarray
        Distance from the isocenter to the source along the columns, mm.
    distance : ndarray
        Distance from the source to the detector's reference point along the facing direction, mm.
    first_column : ndarray
        Position of column 0 along the columns, from the foot of the perpendicular from the source, mm.
    source_z : ndarray
        Height of the source, mm.
    first_row : ndarray
        Height of row 0 above the source, mm.
    """

    cosine: np.ndarray
    sine: np.ndarray
    depth: np.ndarray
    beside: np.ndarray
    distance: np.ndarray
    first_column: np.ndarray
    source_z: np.ndarray
    first_row: np.ndarray


@dataclass(frozen=True, kw_only=True)
class ScanGeometry:
    """A detector and a point source in every view.

    VectorGeometry stores vectors for each view; geometry.OrbitGeometry stores the parameters of a circle or helix. Both
    have these arrays of shape (views, 3) and methods:

    * source_mm, and detector_mm, the reference point of the detector (its center, if both offsets are 0)
    * toward_mm (from source to detector), column_direction and row_direction
    * every(step): the scan with every step-th view
    * turned(angle_rad): the scan rotated about z from +x to +y

    Attributes
    ----------
    column_pitch_mm, row_pitch_mm : float
        Distances between pixel centers, mm.
    column_offset_px, row_offset_px : float
        Shift of the detector's center from its reference point along columns and rows, in pixels.
    surface : {"flat", "cylindrical"}
        On a cylindrical detector, pitch and offset of the columns are arc lengths.
    arc_radius_mm : float or None
        Distance from the focus of a cylindrical detector to its reference point, mm; None: flat.
    view_interval_ms : float or None
        Time between the centers of successive views, ms; None: not known.
    exposure_ms : float or None
        Time that the beam is on, in the middle of each view's interval, ms; None: the whole interval. The detector
        always integrates over the whole interval.
    view_times : ndarray, shape (views,)
        Center of each view, in intervals from the middle of the scan. None: successive views, view i of N at i + 1/2 -
        N/2.

    Raises
    ------
    InputError
        For an impossible detector or impossible times.
    """

    columns: int
    rows: int
    column_pitch_mm: float
    row_pitch_mm: float
    column_offset_px: float = 0.0
    row_offset_px: float = 0.0
    surface: str = FLAT
    arc_radius_mm: float | None = None
    view_interval_ms: float | None = None
    exposure_ms: float | None = None
    view_times: np.ndarray | None = None

    def _freeze(self, *arrays: str) -> None:
        """Copy arrays as read-only float64."""
        for name in arrays:
            values = np.array(getattr(self, name), dtype=np.float64)
            values.setflags(write=False)
            object.__setattr__(self, name, values)

    def _check(self) -> None:
        """Set and freeze the times. Raises InputError for an impossible detector or impossible times."""
        if self.view_times is None:
            object.__setattr__(self, "view_times", np.arange(self.views) + 0.5 - self.views / 2)
        self._freeze("view_times")
        if self.view_times.shape != (self.views,):
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
        self._check_surface()

    def _check_surface(self) -> None:
        if self.surface not in (FLAT, CYLINDRICAL):
            raise InputError(f"scan geometry: a detector's surface is {FLAT} or {CYLINDRICAL}, not '{self.surface}'")
        if (self.surface == CYLINDRICAL) != (self.arc_radius_mm is not None):
            raise InputError(f"scan geometry: arc_radius_mm is the radius of a {CYLINDRICAL} detector, and of no other")
        if self.surface == CYLINDRICAL:
            reach = np.abs(self.column_positions_mm()[[0, -1]]).max()
            if not reach < self.arc_radius_mm * math.pi / 2:  # `not` also refuses NaN
                raise InputError(
                    f"scan geometry: a detector that reaches {reach:g} mm from its reference point is more than half "
                    f"a circle of arc_radius_mm {self.arc_radius_mm:g}"
                )

    @property
    def times_s(self) -> np.ndarray:
        """Center of each view's interval and exposure: seconds from the middle of the scan, shape (views,).

        Raises
        ------
        InputError
            If the scan's times are not known.
        """
        return self.view_times * self.known_interval_ms / 1000

    @property
    def duration_s(self) -> float:
        """Time from the start of the first view's interval to the end of the last view's interval, seconds.

        Raises
        ------
        InputError
            If the scan's times are not known.
        """
        return (self.view_times[-1] - self.view_times[0] + self.views_apart) * self.known_interval_ms / 1000

    @property
    def known_interval_ms(self) -> float:
        """view_interval_ms, which must be known. Raises InputError if it is not known."""
        if self.view_interval_ms is None:
            raise InputError(
                "scan: the time between views is not known, but afterglow, motion and dark signal drift depend on it; "
                "set scan.view_interval_ms or scan.rotation_time_ms"
            )
        return self.view_interval_ms

    @property
    def views_apart(self) -> int:
        """Step between successive views, counted in views of the scanner: 1, unless `every` selected some."""
        return 1 if self.views < 2 else round(self.view_times[1] - self.view_times[0])

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of the projections: views, rows, columns."""
        return self.views, self.rows, self.columns

    @property
    def key(self) -> tuple:
        """Hashable key of the class and all fields."""
        return type(self).__name__, *(
            value.tobytes() if isinstance(value := getattr(self, attribute.name), np.ndarray) else value
            for attribute in fields(self)
        )

    @cached_property
    def normal(self) -> np.ndarray:
        """Unit vectors across the detector, away from the source, shape (views, 3)."""
        return np.cross(self.column_direction, self.row_direction)

    @property
    def magnification(self) -> float:
        """Magnification at the isocenter, mean over views."""
        return float(np.mean(_dot(self.toward_mm, self.normal) / -_dot(self.source_mm, self.normal)))

    def column_positions_mm(self) -> np.ndarray:
        """Return column centers along the detector or its arc, mm from the reference point, shape (columns,)."""
        return (np.arange(self.columns) - (self.columns - 1) / 2 + self.column_offset_px) * self.column_pitch_mm

    def on_surface_mm(self, positions_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return coordinates of column positions: along the column direction, and towards the source (0 if flat)."""
        if self.surface == FLAT:
            return positions_mm, np.zeros_like(positions_mm)
        angles, radius = positions_mm / self.arc_radius_mm, self.arc_radius_mm
        return radius * np.sin(angles), 2 * radius * np.sin(angles / 2) ** 2

    def row_positions_mm(self) -> np.ndarray:
        """Return row centers along the detector, mm from its reference point, shape (rows,)."""
        return (np.arange(self.rows) - (self.rows - 1) / 2 + self.row_offset_px) * self.row_pitch_mm

    def ray(self, view: int, row: int, column: int) -> tuple[np.ndarray, np.ndarray]:
        """Return source and pixel center (x, y, z) in mm of one ray: the reference definition, not the fast path."""
        source = self.source_mm[view]
        across, nearer = (one[column] for one in self.on_surface_mm(self.column_positions_mm()))
        along = across * self.column_direction[view] - nearer * self.normal[view]
        up = self.row_positions_mm()[row] * self.row_direction[view]
        return source, source + self.toward_mm[view] + along + up

    @property
    def parallel(self) -> bool:
        """Whether the beam is parallel; never for a geometry given by vectors."""
        return False

    @cached_property
    def is_upright(self) -> bool:
        """Whether the detector's rows are stacked along z in every view."""
        return bool(np.abs(self.row_direction - [0, 0, 1]).max() < ROUNDING)

    def bundles(self) -> tuple[np.ndarray, np.ndarray]:
        """Return all rays, in bundles that share their projection onto the x-y plane.

        For an upright detector a bundle is a column; otherwise it is one pixel, in row-major order. An array [view,
        row, bundle] can be reshaped to (views, rows, columns).

        Returns
        -------
        to : ndarray, shape (3, views, bundles)
            Vectors (x, y, z) from the source to the detector, mm.
        rows : ndarray, shape (rows,) or (1,)
            Added to the z component in each row, mm.
        """
        toward, along, up = (each.T[..., None] for each in (self.toward_mm, self.column_direction, self.row_direction))
        across, nearer = self.on_surface_mm(self.column_positions_mm())
        to, rows = toward + along * across, self.row_positions_mm()
        if self.surface != FLAT:
            to -= self.normal.T[..., None] * nearer
        if self.is_upright:
            return to, rows
        return (to[:, :, None] + up[:, :, None] * rows[:, None]).reshape(3, self.views, -1), np.zeros(1)

    def upright(self, who: str) -> Upright:
        """Return the in-plane description of the scan; `who`, for the message, needs an upright detector.

        Raises
        ------
        InputError
            If the detector is not upright.
        """
        if not self.is_upright:
            raise InputError(f"{who} needs detector rows along z in every view; the scan geometry tilts or rolls them")
        columns, normal = self.column_direction, self.normal
        return Upright(
            cosine=columns[:, 0].copy(),
            sine=columns[:, 1].copy(),
            depth=-_dot(self.source_mm, normal),
            beside=_dot(self.source_mm, columns),
            distance=_dot(self.toward_mm, normal),
            first_column=_dot(self.toward_mm, columns) + self.on_surface_mm(self.column_positions_mm())[0][0],
            source_z=self.source_mm[:, 2].copy(),
            first_row=self.toward_mm[:, 2] + self.row_positions_mm()[0],
        )

    def solid_angles(self) -> np.ndarray:
        """Return solid angles relative to a pixel at the foot of the perpendicular, (views or 1, rows, columns).

        A solid angle is proportional to the cosine of the incidence angle over the squared distance; on a flat
        detector, to the cube of this cosine. For an arc, the perpendicular is to its tangent plane at the reference
        point.
        """
        (to_x, to_y, to_z), rows = self.bundles()
        squared = (to_x**2 + to_y**2)[:, None] + (to_z[:, None] + rows[:, None]) ** 2
        squared, distance = squared.reshape(self.shape), _dot(self.toward_mm, self.normal)[:, None, None]
        cosine = distance / np.sqrt(squared)
        if self.surface == FLAT:
            return cosine**3
        # Distances of the source from the tangent planes of the arc at its columns.
        angles = self.column_positions_mm() / self.arc_radius_mm
        across, nearer = self.on_surface_mm(self.column_positions_mm())
        across, nearer = _dot(self.toward_mm, self.column_direction)[:, None] + across, distance[..., 0] - nearer
        facing = across * np.sin(angles) + nearer * np.cos(angles)
        return cosine**2 * facing[:, None] / np.sqrt(squared)

    def by_vectors(self) -> VectorGeometry:
        """Return the same scan as a VectorGeometry."""
        return self if isinstance(self, VectorGeometry) else self._by_vectors

    @cached_property
    def _by_vectors(self) -> VectorGeometry:
        shared = {attribute.name: getattr(self, attribute.name) for attribute in fields(ScanGeometry)}
        return VectorGeometry(
            source_mm=self.source_mm,
            detector_mm=self.detector_mm,
            column_direction=self.column_direction,
            row_direction=self.row_direction,
            **shared,
        )


@dataclass(frozen=True, kw_only=True)
class VectorGeometry(ScanGeometry):
    """Any scan, with vectors for each view: sources that jitter or fly, detectors that roll, tilt or sag.

    Attributes
    ----------
    source_mm : ndarray, shape (views, 3)
        Position of the source, mm.
    detector_mm : ndarray, shape (views, 3)
        Position of the detector's reference point, mm.
    column_direction, row_direction : ndarray, shape (views, 3)
        Unit vectors of increasing column and row.

    Raises
    ------
    InputError
        For wrong shapes, vectors that are not finite (sources at infinity are not supported), directions that are not
        orthonormal, and a detector that faces away from the source.
    """

    source_mm: np.ndarray
    detector_mm: np.ndarray
    column_direction: np.ndarray
    row_direction: np.ndarray

    def __post_init__(self):
        self._freeze(*_VECTORS)
        shapes = {getattr(self, name).shape for name in _VECTORS}
        if self.source_mm.ndim != 2 or shapes != {(self.views, 3)} or self.views < 1:
            raise InputError("scan geometry: need at least one view, and four vectors of x, y and z for every view")
        self._check()
        if not all(np.isfinite(getattr(self, name)).all() for name in _VECTORS):
            raise InputError("scan geometry: vectors must be finite; for parallel beams see parallel_beam()")
        columns, rows = self.column_direction, self.row_direction
        off = np.stack([_dot(columns, columns) - 1, _dot(rows, rows) - 1, _dot(columns, rows)])
        if np.abs(off).max() > ROUNDING:
            view = int(np.abs(off).max(0).argmax())
            raise InputError(
                f"scan geometry: view {view}: the detector's column and row directions must have length 1 and be "
                "perpendicular"
            )
        if (distance := _dot(self.toward_mm, self.normal)).min() <= 0:
            raise InputError(
                f"scan geometry: view {int(distance.argmin())}: the detector faces away from the source; column "
                "direction x row direction must point from the source to the detector"
            )

    @property
    def views(self) -> int:
        """Number of views."""
        return len(self.source_mm)

    @property
    def toward_mm(self) -> np.ndarray:
        """Vector from the source to the detector's reference point, mm, shape (views, 3)."""
        return self.detector_mm - self.source_mm

    def every(self, step: int) -> VectorGeometry:
        """Return the scan with every `step`-th view, at its time."""
        return self.at(np.arange(0, self.views, step))

    def at(self, views: np.ndarray) -> VectorGeometry:
        """Return the scan with some of the views, by number, at their times."""
        return replace(self, **{name: getattr(self, name)[views] for name in (*_VECTORS, "view_times")})

    def turned(self, angle_rad: float) -> VectorGeometry:
        """Return the scan with source and detector turned about z, from +x to +y."""
        sine, cosine = math.sin(angle_rad), math.cos(angle_rad)
        turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
        return replace(self, **{name: getattr(self, name) @ turn.T for name in _VECTORS})


_VECTORS = ("source_mm", "detector_mm", "column_direction", "row_direction")


def _dot(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.einsum("vi,vi->v", one, other)
