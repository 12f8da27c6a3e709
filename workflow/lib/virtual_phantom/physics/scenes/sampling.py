"""End points of rays: points of the focal spot, and points within a detector pixel."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from ...base.geometry import OrbitGeometry, ScanGeometry, orbit_of

if TYPE_CHECKING:
    from ..state import State

# Points along a side of the focal spot. Shadows of an object at the isocenter are at most one pixel apart, as far as
# MAX_POINTS allows. Compared with 96 points per side, the peak of a ball as wide as a pixel then has an error of 6 %.
# With three points, and pixels a quarter as wide as the blur, the error would be 32 %.
MIN_POINTS, MAX_POINTS = 3, 7
# Points of fits, and the blur in pixels up to which they are enough. Two points have the variance of the spot: at the
# Nyquist frequency, the MTF changes by sinc(b / 2) - cos(pi b / sqrt(12)) = 0.0014 for a blur b of half a pixel.
FEW_POINTS, FEW_POINTS_PX = 2, 0.5
MAX_RAYS = 4_000_000  # computed at once, with about 100 bytes each
# Attributes that a SupersampledScan takes from its geometry, because they do not depend on the rays of a pixel.
DELEGATED = (
    *("views", "source_mm", "detector_mm", "toward_mm", "column_direction", "row_direction", "normal"),
    *("surface", "on_surface_mm", "is_upright"),
)


@cache
def _gauss_legendre(count: int) -> list[tuple[float, float]]:
    """Return nodes in [-1/2, 1/2] and weights of sum 1 of Gauss-Legendre quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return [(float(node) / 2, float(weight) / 2) for node, weight in zip(nodes, weights, strict=True)]


@cache
def pixel_quadrature(
    samples: int, of_rows: bool = True, of_columns: int | None = None
) -> tuple[tuple[tuple[float, float], float], ...]:
    """Return points within a pixel and their weights.

    With Gauss-Legendre nodes, two rays per direction blur as the whole pixel does (equal second moments). Equidistant
    rays would have 1 - 1 / samples^2 of its variance.

    Parameters
    ----------
    samples : int
        Rays per direction.
    of_rows : bool, optional
        False for a detector of one row (fan beam), whose rays stay in the plane.
    of_columns : int, optional
        Rays along the columns; None: `samples`.

    Returns
    -------
    tuple of tuple
        ((column, row) from the pixel's center in pixels, weight).
    """
    columns = _gauss_legendre(of_columns or samples)
    rows = _gauss_legendre(samples) if of_rows else [(0.0, 1.0)]
    return tuple(((column, row), weight * other) for row, other in rows for column, weight in columns)


@dataclass(frozen=True)
class SupersampledScan:
    """A scan with several rays per pixel. Scenes accept it in place of a geometry.

    Tracing all rays of a scan at once takes a fraction of the time of separate scans.

    Attributes
    ----------
    pixel_scan : ScanGeometry
        The scan with one ray per pixel.
    columns_px, rows_px : tuple of float
        Positions of the rays from the pixel's center, pixels, ascending.
    """

    pixel_scan: ScanGeometry
    columns_px: tuple[float, ...]
    rows_px: tuple[float, ...]

    def __getattr__(self, name: str):
        """Return a DELEGATED attribute of the geometry."""
        if name not in DELEGATED:
            raise AttributeError(f"a supersampled scan has no {name}")
        return getattr(self.pixel_scan, name)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of its projections: views, rows of rays, columns of rays. Rays of a pixel are neighbors."""
        views, rows, columns = self.pixel_scan.shape
        return views, rows * len(self.rows_px), columns * len(self.columns_px)

    @property
    def key(self) -> tuple:
        """As ScanGeometry.key."""
        return self.pixel_scan.key, self.columns_px, self.rows_px

    def column_positions_mm(self) -> np.ndarray:
        """As ScanGeometry.column_positions_mm, for every column of rays."""
        offsets = np.multiply(self.columns_px, self.pixel_scan.column_pitch_mm)
        return np.add.outer(self.pixel_scan.column_positions_mm(), offsets).ravel()

    def row_positions_mm(self) -> np.ndarray:
        """As ScanGeometry.row_positions_mm, for every row of rays."""
        return np.add.outer(
            self.pixel_scan.row_positions_mm(), np.multiply(self.rows_px, self.pixel_scan.row_pitch_mm)
        ).ravel()

    def turned(self, angle_rad: float) -> SupersampledScan:
        """As ScanGeometry.turned."""
        return replace(self, pixel_scan=self.pixel_scan.turned(angle_rad))

    def bundles(self) -> tuple[np.ndarray, np.ndarray]:
        """As ScanGeometry.bundles."""
        return ScanGeometry.bundles(self)


def supersampled(
    geometry: ScanGeometry, samples: int, of_columns: int | None = None
) -> list[tuple[ScanGeometry | SupersampledScan, np.ndarray]]:
    """Return scans with the rays of `pixel_quadrature`, each with as many rays as fit into memory.

    Parameters
    ----------
    samples, of_columns : int
        See `pixel_quadrature`.

    Returns
    -------
    list of tuple
        (scan, weights of its rays, shape (rows, columns) of rays per pixel).
    """
    quadrature = pixel_quadrature(samples, geometry.rows > 1, of_columns)
    if len(quadrature) == 1:
        return [(geometry, np.ones((1, 1)))]
    columns, rows = (sorted({point[axis] for point, _ in quadrature}) for axis in (0, 1))
    weights = np.array([weight for _, weight in quadrature]).reshape(len(rows), len(columns))
    at_once = max(1, MAX_RAYS // int(np.prod(geometry.shape)))
    by_column = max(1, min(len(columns), at_once // len(rows)))
    by_row = min(len(rows), at_once)
    return [
        (
            SupersampledScan(geometry, tuple(columns[column : column + by_column]), tuple(rows[row : row + by_row])),
            weights[row : row + by_row, column : column + by_column],
        )
        for row in range(0, len(rows), by_row)
        for column in range(0, len(columns), by_column)
    ]


def average_rays(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the weighted sum over the rays of each pixel, shape (..., rows, columns).

    Parameters
    ----------
    values : ndarray, shape (..., rows of rays, columns of rays)
    weights : ndarray, shape (rows, columns) of rays per pixel
    """
    by_row, by_column = weights.shape
    if weights.size == 1:
        return values * weights[0, 0]
    # Sums over short axes of an array would take three times as long as this loop over the rays of a pixel.
    return sum(
        weights[row, column] * values[..., row::by_row, column::by_column]
        for row in range(by_row)
        for column in range(by_column)
    )


def points(side: float, blurred_px: float, fewest: int | None = None) -> list[tuple[float, float]]:
    """Return points along a side of the focal spot and their weights, by Gauss-Legendre quadrature.

    Parameters
    ----------
    side : float
        Length of the side; 0: one point.
    blurred_px : float
        Width of the blur of an object at the isocenter, pixels.
    fewest : int, optional
        Fewest points for a blur of up to FEW_POINTS_PX; None, and for a larger blur: MIN_POINTS.

    Returns
    -------
    list of tuple of 2 float
        (position from the middle / side, weight).
    """
    if not side:
        return [(0.0, 1.0)]
    fewest = fewest if fewest and blurred_px <= FEW_POINTS_PX else MIN_POINTS
    return list(_gauss_legendre(min(max(fewest, math.ceil(blurred_px) + 1), MAX_POINTS)))


def sources(state: State) -> Iterator[tuple[ScanGeometry, float | np.ndarray]]:
    """Yield the geometry of every point of the focal spot at every time within a view, and its weight.

    The result depends on geometry, `mounting`, `turns`, `jump_mm` and `sources` of the state.
    """
    for turn, share in state.turns:
        geometry = later_geometry(state.geometry, turn) if turn else state.geometry
        for *position_mm, weight in state.sources:
            yield state.mounting.of(displace_source(geometry, *position_mm, jump_mm=state.jump_mm)), share * weight


def later_geometry(geometry: ScanGeometry, intervals: float) -> OrbitGeometry:
    """Return the positions of source and detector some view intervals later.

    Parameters
    ----------
    geometry : ScanGeometry
        A circular or helical scan.
    intervals : float
        Time in view intervals of the scanner, which may be shorter than from view to view of the scan.

    Raises
    ------
    InputError
        As `orbit_of`.
    """
    orbit = orbit_of(geometry, "rotation during a view")
    views = intervals / orbit.views_apart
    angle, rise = (np.gradient(values) if orbit.views > 1 else 0.0 for values in (orbit.angles_rad, orbit.source_z_mm))
    return replace(orbit, angles_rad=orbit.angles_rad + views * angle, source_z_mm=orbit.source_z_mm + views * rise)


def displace_source(
    geometry: ScanGeometry, column_mm: float, row_mm: float, away_mm: float = 0.0, jump_mm: np.ndarray | None = None
) -> ScanGeometry:
    """Return the geometry with a displaced source; the detector stays.

    Parameters
    ----------
    column_mm, row_mm : float
        Displacement along the detector's columns and rows, mm.
    away_mm : float, optional
        Displacement along the detector's normal, away from it, mm.
    jump_mm : ndarray, shape (views, 3), optional
        Additional displacement of every view, in the same three directions.
    """
    if jump_mm is None and not column_mm and not row_mm and not away_mm:
        return geometry
    vectors = geometry.by_vectors()
    by = np.array([column_mm, row_mm, away_mm]) + (0.0 if jump_mm is None else jump_mm)
    column, row, away = np.broadcast_to(by, (geometry.views, 3)).T[..., None]
    by_mm = column * vectors.column_direction + row * vectors.row_direction - away * vectors.normal
    return replace(vectors, source_mm=vectors.source_mm + by_mm)
