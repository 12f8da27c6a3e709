"""Where rays begin and end: points of the focal spot, and points of a pixel."""

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

# Points along a side: the shadows that they cast, of what lies at the isocentre, are no farther apart than a pixel is
# wide, as far as MOST points reach. Of a focal spot, against 96 points per side, the peak of a ball as wide as a pixel
# is then right to 6 % (three points of pixels a quarter as wide as the blur: to 32 %).
LEAST, MOST = 3, 7
MOST_RAYS = 4_000_000  # that are worked out at once: some 100 bytes each
# Where source and detector are, whatever rays meet the pixels.
OF_THE_WHOLE = (
    *("views", "source_mm", "detector_mm", "toward_mm", "column_direction", "row_direction", "normal"),
    *("surface", "on_surface_mm", "is_upright"),
)


@cache
def quadrature(samples: int, of_rows: bool = True) -> tuple[tuple[tuple[float, float], float], ...]:
    """Where rays meet a pixel: Gauss and Legendre's nodes, so that two per direction blur as the whole pixel does.

    Rays evenly spaced would blur by 1 - 1 / samples^2 of that.

    Parameters
    ----------
    samples : int
        Rays per direction.
    of_rows : bool, optional
        False for a detector of one row (fan beam), whose rays stay in the plane.

    Returns
    -------
    tuple of tuple
        ((column, row) from the pixel's centre in pixels, weight).
    """
    nodes, weights = np.polynomial.legendre.leggauss(samples)
    columns = [(float(node) / 2, float(weight) / 2) for node, weight in zip(nodes, weights, strict=True)]
    rows = columns if of_rows else [(0.0, 1.0)]
    return tuple(((column, row), one * other) for row, other in rows for column, one in columns)


@dataclass(frozen=True)
class Divided:
    """A scan whose pixels meet several rays each: what scenes take rays from, in the place of its geometry.

    All rays of a scan at once cost a fraction of what they cost one by one.

    Attributes
    ----------
    columns_px, rows_px : tuple of float
        Where rays meet a pixel, from its centre, in pixels, in rising order.
    """

    whole: ScanGeometry
    columns_px: tuple[float, ...]
    rows_px: tuple[float, ...]

    def __getattr__(self, name: str):
        """What is that of the whole: `OF_THE_WHOLE` of ScanGeometry."""
        if name not in OF_THE_WHOLE:
            raise AttributeError(f"a divided scan has no {name}")
        return getattr(self.whole, name)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Of its projections: views, rows of rays and columns of rays, those of a pixel side by side."""
        views, rows, columns = self.whole.shape
        return views, rows * len(self.rows_px), columns * len(self.columns_px)

    @property
    def key(self) -> tuple:
        """As ScanGeometry.key."""
        return self.whole.key, self.columns_px, self.rows_px

    def column_positions_mm(self) -> np.ndarray:
        """As ScanGeometry.column_positions_mm, of every column of rays."""
        beside = np.multiply(self.columns_px, self.whole.column_pitch_mm)
        return np.add.outer(self.whole.column_positions_mm(), beside).ravel()

    def row_positions_mm(self) -> np.ndarray:
        """As ScanGeometry.row_positions_mm, of every row of rays."""
        return np.add.outer(self.whole.row_positions_mm(), np.multiply(self.rows_px, self.whole.row_pitch_mm)).ravel()

    def turned(self, angle_rad: float) -> Divided:
        """As ScanGeometry.turned."""
        return replace(self, whole=self.whole.turned(angle_rad))

    def bundles(self) -> tuple[np.ndarray, np.ndarray]:
        """As ScanGeometry.bundles."""
        return ScanGeometry.bundles(self)


def divided(geometry: ScanGeometry, samples: int) -> list[tuple[ScanGeometry | Divided, np.ndarray]]:
    """Scans of the rays of every pixel by `quadrature`, as many together as fit into memory.

    Parameters
    ----------
    samples : int
        Rays per pixel and direction.

    Returns
    -------
    list of tuple
        (scan, weights of its rays, shape (rows, columns) of a pixel).
    """
    places = quadrature(samples, geometry.rows > 1)
    if len(places) == 1:
        return [(geometry, np.ones((1, 1)))]
    columns, rows = (sorted({place[axis] for place, _ in places}) for axis in (0, 1))
    weights = np.array([weight for _, weight in places]).reshape(len(rows), len(columns))
    together = max(1, MOST_RAYS // int(np.prod(geometry.shape)))
    by_column = max(1, min(len(columns), together // len(rows)))
    by_row = min(len(rows), together)
    return [
        (
            Divided(geometry, tuple(columns[column : column + by_column]), tuple(rows[row : row + by_row])),
            weights[row : row + by_row, column : column + by_column],
        )
        for row in range(0, len(rows), by_row)
        for column in range(0, len(columns), by_column)
    ]


def averaged(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Of what the rays of a pixel have, the weighted sum.

    Parameters
    ----------
    values : ndarray, shape (..., rows of rays, columns of rays)
    weights : ndarray, shape (rows, columns)
        Of the rays of a pixel.

    Returns
    -------
    ndarray, shape (..., rows, columns)
    """
    by_row, by_column = weights.shape
    if weights.size == 1:
        return values * weights[0, 0]
    # One ray of every pixel after another: sums over short axes of an array take three times as long.
    return sum(
        weights[row, column] * values[..., row::by_row, column::by_column]
        for row in range(by_row)
        for column in range(by_column)
    )


def points(side: float, blurred_px: float) -> list[tuple[float, float]]:
    """Places along a side of 1 from its middle, and their weights: Gauss and Legendre's, none of which is negative.

    Parameters
    ----------
    side : float
        0: a point.
    blurred_px : float
        Width of the blur that the side makes of what lies at the isocentre, pixels.

    Returns
    -------
    list of tuple of 2 float
        (place, weight).
    """
    if not side:
        return [(0.0, 1.0)]
    nodes, weights = np.polynomial.legendre.leggauss(min(max(LEAST, math.ceil(blurred_px) + 1), MOST))
    return [(float(node) / 2, float(weight) / 2) for node, weight in zip(nodes, weights, strict=True)]


def sources(state: State) -> Iterator[tuple[ScanGeometry, float | np.ndarray]]:
    """Where the rays of a scan come from, one point after the other.

    Parameters
    ----------
    state : State
        Its geometry, `mounting`, `turns`, `jump_mm` and `sources`.

    Yields
    ------
    geometry : ScanGeometry
        With its source in that point.
    weight : float or ndarray
        Of the photons that leave for a pixel.
    """
    for turn, share in state.turns:
        geometry = later(state.geometry, turn) if turn else state.geometry
        for *place_mm, weight in state.sources:
            yield state.mounting.of(displaced(geometry, *place_mm, jump_mm=state.jump_mm)), share * weight


def later(geometry: ScanGeometry, intervals: float) -> OrbitGeometry:
    """Where source and detector are, some part of the time from view to view later.

    Parameters
    ----------
    geometry : ScanGeometry
        A circle or helix.
    intervals : float
        Of the scanner's views, of which some may be left out.

    Raises
    ------
    InputError
        As `orbit_of`.
    """
    orbit = orbit_of(geometry, "rotation during a view")
    of_one = intervals / orbit.views_apart
    angle, rise = (np.gradient(one) if orbit.views > 1 else 0.0 for one in (orbit.angles_rad, orbit.source_z_mm))
    return replace(
        orbit,
        angles_rad=orbit.angles_rad + of_one * angle,
        source_z_mm=orbit.source_z_mm + of_one * rise,
    )


def displaced(
    geometry: ScanGeometry,
    column_mm: float,
    row_mm: float,
    away_mm: float = 0.0,
    jump_mm: np.ndarray | None = None,
) -> ScanGeometry:
    """The geometry of a point of the source beside its centre: the source moves, the detector stays.

    Parameters
    ----------
    column_mm, row_mm : float
        Displacement along the detector's columns and rows, mm.
    away_mm : float, optional
        Displacement across the detector, away from it, mm.
    jump_mm : ndarray, shape (views, 3), optional
        A further displacement of every view, of the same three.
    """
    if jump_mm is None and not column_mm and not row_mm and not away_mm:
        return geometry
    vectors = geometry.by_vectors()
    by = np.array([column_mm, row_mm, away_mm]) + (0.0 if jump_mm is None else jump_mm)
    column, row, away = np.broadcast_to(by, (geometry.views, 3)).T[..., None]
    by_mm = column * vectors.column_direction + row * vectors.row_direction - away * vectors.normal
    return replace(vectors, source_mm=vectors.source_mm + by_mm)
