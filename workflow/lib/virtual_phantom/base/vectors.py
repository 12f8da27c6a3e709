"""Scan geometries as vectors: where the source, the detector and its pixels are in every view.

A ray runs from the source to the middle of a pixel. Pixel (row, column) of a flat detector lies at::

    detector_mm + u column_direction + v row_direction        u, v: column_positions_mm, row_positions_mm

and that of a cylindrical one, an arc of the radius r about a focus, at::

    detector_mm + r sin(u / r) column_direction - r (1 - cos(u / r)) normal + v row_direction

in the frame of geometry.py. This is the one place that says so; whoever needs rays takes them from here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from .errors import InputError

# Largest part of a direction's length, and of a right angle's cosine, that rounding may make.
ROUNDING = 1e-9
FLAT, CYLINDRICAL = "flat", "cylindrical"


class Upright(NamedTuple):
    """A scan whose detector rows lie above each other along z, seen from above. All arrays have shape (views,).

    Attributes
    ----------
    cosine, sine : ndarray
        Column direction (cosine, sine, 0); the detector faces the source along (sine, -cosine, 0).
    depth : ndarray
        From the source to the isocentre along that, mm.
    beside : ndarray
        How far the source lies from the isocentre along the columns, mm.
    distance : ndarray
        From the source to the detector's reference point along that, mm.
    first_column : ndarray
        Position of column 0 along the columns, from the foot of the perpendicular from the source, mm.
    source_z : ndarray
        Height of the source, mm.
    first_row : ndarray
        Height of row 0 over the source, mm.
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

    VectorGeometry holds any of them view by view; geometry.OrbitGeometry a circle or helix, by the few numbers that say
    all. Both have source_mm, detector_mm (the detector's reference point: its centre, if both offsets are 0),
    toward_mm (from the one to the other), column_direction and row_direction, (views, 3); every(step), one view of so
    many; and turned(angle_rad), about z from +x to +y.

    Attributes
    ----------
    columns, rows : int
        Pixels of the detector.
    column_pitch_mm, row_pitch_mm : float
        Distances between their centres, mm.
    column_offset_px, row_offset_px : float
        Shift of the detector's centre from its reference point along columns and rows, in pixels.
    surface : {"flat", "cylindrical"}
        Of the detector. On a cylindrical one, pitch and offset of the columns are lengths along the arc.
    arc_radius_mm : float or None
        Of a cylindrical detector, mm: how far its focus lies from its reference point, across it. None of a flat one.
    view_interval_ms : float or None
        From the middle of one view to that of the next, ms; None: not known.
    exposure_ms : float or None
        How long the beam is on in every view's interval, ms: in its middle, while the detector integrates over all of
        it; None: throughout.
    view_times : ndarray, shape (views,)
        Middle of each view, in intervals from the middle of the scan. None is made into one after another: view i of N
        at i + 1/2 - N/2.

    Raises
    ------
    InputError
        For a detector or times that cannot be.
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
        """Copy arrays as float64 that cannot be written to."""
        for name in arrays:
            values = np.array(getattr(self, name), dtype=np.float64)
            values.setflags(write=False)
            object.__setattr__(self, name, values)

    def _check(self) -> None:
        """Set and freeze the times. Raises InputError for a detector or times that cannot be."""
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
            if not reach < self.arc_radius_mm * math.pi / 2:  # not: NaN is refused too
                raise InputError(
                    f"scan geometry: a detector that reaches {reach:g} mm from its reference point is more than half "
                    f"a circle of arc_radius_mm {self.arc_radius_mm:g}"
                )

    @property
    def times_s(self) -> np.ndarray:
        """Middle of each view's interval, when it is exposed: seconds from the middle of the scan, shape (views,).

        Raises
        ------
        InputError
            If the scan's times are not known.
        """
        return self.view_times * self.known_interval_ms / 1000

    @property
    def duration_s(self) -> float:
        """From the begin of the first view's interval to the end of the last one's, seconds.

        Raises
        ------
        InputError
            If the scan's times are not known.
        """
        return (self.view_times[-1] - self.view_times[0] + self.views_apart) * self.known_interval_ms / 1000

    @property
    def known_interval_ms(self) -> float:
        """view_interval_ms, which must be known.

        Raises
        ------
        InputError
            If it is not.
        """
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

    @property
    def shape(self) -> tuple[int, int, int]:
        """Of its projections: views, rows, columns."""
        return self.views, self.rows, self.columns

    @property
    def key(self) -> tuple:
        """Equal for geometries whose rays are the same, and hashable."""
        return type(self).__name__, *(
            value.tobytes() if isinstance(value := getattr(self, one.name), np.ndarray) else value
            for one in fields(self)
        )

    @cached_property
    def normal(self) -> np.ndarray:
        """Unit vectors across the detector, away from the source, shape (views, 3)."""
        return np.cross(self.column_direction, self.row_direction)

    @property
    def magnification(self) -> float:
        """At the isocentre, mean over views."""
        return float(np.mean(_dot(self.toward_mm, self.normal) / -_dot(self.source_mm, self.normal)))

    def column_positions_mm(self) -> np.ndarray:
        """Column centres along the detector, on its arc if it has one, mm from its reference point, (columns,)."""
        return (np.arange(self.columns) - (self.columns - 1) / 2 + self.column_offset_px) * self.column_pitch_mm

    def on_surface_mm(self, positions_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where positions along the detector are.

        Parameters
        ----------
        positions_mm : ndarray
            As column_positions_mm gives them.

        Returns
        -------
        across_mm : ndarray
            From the reference point along the column direction.
        nearer_mm : ndarray
            From the plane through the reference point across the normal, towards the source: 0 on a flat detector.
        """
        if self.surface == FLAT:
            return positions_mm, np.zeros_like(positions_mm)
        angles, radius = positions_mm / self.arc_radius_mm, self.arc_radius_mm
        return radius * np.sin(angles), 2 * radius * np.sin(angles / 2) ** 2

    def row_positions_mm(self) -> np.ndarray:
        """Row centres along the detector, mm from its reference point, shape (rows,)."""
        return (np.arange(self.rows) - (self.rows - 1) / 2 + self.row_offset_px) * self.row_pitch_mm

    def ray(self, view: int, row: int, column: int) -> tuple[np.ndarray, np.ndarray]:
        """Source and detector-pixel centre (x, y, z) in mm of one ray: the definition, not the fast path."""
        source = self.source_mm[view]
        across, nearer = (one[column] for one in self.on_surface_mm(self.column_positions_mm()))
        along = across * self.column_direction[view] - nearer * self.normal[view]
        up = self.row_positions_mm()[row] * self.row_direction[view]
        return source, source + self.toward_mm[view] + along + up

    @property
    def parallel(self) -> bool:
        """Whether the beam is parallel: none that is given by vectors is."""
        return False

    @cached_property
    def is_upright(self) -> bool:
        """Whether the detector's rows lie above each other along z in every view."""
        return bool(np.abs(self.row_direction - [0, 0, 1]).max() < ROUNDING)

    def bundles(self) -> tuple[np.ndarray, np.ndarray]:
        """All rays, in bundles that share their shadow in the plane across z.

        Of an upright detector a bundle is a column, of any other one pixel after another, a row at a time. Reshaped to
        (views, rows, columns), what is worked out as [view, row, bundle] is in its place.

        Returns
        -------
        to : ndarray, shape (3, views, bundles)
            The way (x, y, z) from the source to the detector, mm.
        rows : ndarray, shape (rows,) or (1,)
            What each row adds to its z, mm.
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
        """The scan seen from above.

        Parameters
        ----------
        who : str
            What needs an upright detector, for the message.

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
        """Solid angle under which the source sees each pixel, over that of a pixel at the foot of the perpendicular.

        It is the inverse square of the distance times the cosine of the incidence: on a flat detector the cube of that
        cosine. On an arc, the foot is that of the perpendicular to the plane through its reference point.

        Returns
        -------
        ndarray, shape (views or 1, rows, columns)
        """
        (to_x, to_y, to_z), rows = self.bundles()
        squared = (to_x**2 + to_y**2)[:, None] + (to_z[:, None] + rows[:, None]) ** 2
        squared, distance = squared.reshape(self.shape), _dot(self.toward_mm, self.normal)[:, None, None]
        cosine = distance / np.sqrt(squared)
        if self.surface == FLAT:
            return cosine**3
        # How far the source lies from the planes that touch the arc at its columns.
        angles = self.column_positions_mm() / self.arc_radius_mm
        across, nearer = self.on_surface_mm(self.column_positions_mm())
        across, nearer = _dot(self.toward_mm, self.column_direction)[:, None] + across, distance[..., 0] - nearer
        facing = across * np.sin(angles) + nearer * np.cos(angles)
        return cosine**2 * facing[:, None] / np.sqrt(squared)

    def by_vectors(self) -> VectorGeometry:
        """The same scan, held view by view."""
        shared = {one.name: getattr(self, one.name) for one in fields(ScanGeometry)}
        return VectorGeometry(
            source_mm=self.source_mm,
            detector_mm=self.detector_mm,
            column_direction=self.column_direction,
            row_direction=self.row_direction,
            **shared,
        )


@dataclass(frozen=True, kw_only=True)
class VectorGeometry(ScanGeometry):
    """Any scan, view by view: sources that jitter or fly, detectors that roll, tilt or sag.

    Attributes
    ----------
    source_mm : ndarray, shape (views, 3)
        Where the source is, mm.
    detector_mm : ndarray, shape (views, 3)
        Where the detector's reference point is, mm.
    column_direction : ndarray, shape (views, 3)
        Unit vectors of increasing column.
    row_direction : ndarray, shape (views, 3)
        Unit vectors of increasing row.

    Raises
    ------
    InputError
        For other shapes, vectors that are not finite (a source at infinity is not built), directions that are not
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
        """How many views the scan has."""
        return len(self.source_mm)

    @property
    def toward_mm(self) -> np.ndarray:
        """From the source to the detector's reference point, mm, shape (views, 3)."""
        return self.detector_mm - self.source_mm

    def every(self, step: int) -> VectorGeometry:
        """One view of so many, each at its time."""
        return self.at(np.arange(0, self.views, step))

    def at(self, views: np.ndarray) -> VectorGeometry:
        """Some of the views, by number, each at its time."""
        return replace(self, **{name: getattr(self, name)[views] for name in (*_VECTORS, "view_times")})

    def turned(self, angle_rad: float) -> VectorGeometry:
        """Source and detector turned about z, from +x to +y."""
        sine, cosine = math.sin(angle_rad), math.cos(angle_rad)
        turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
        return replace(self, **{name: getattr(self, name) @ turn.T for name in _VECTORS})


_VECTORS = ("source_mm", "detector_mm", "column_direction", "row_direction")


def _dot(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.einsum("vi,vi->v", one, other)
