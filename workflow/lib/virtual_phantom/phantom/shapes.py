"""Solid shapes in mm and the share of each voxel that they fill.

A shape has `bounds_mm()`, the corners of its bounding box as (low, high) in (x, y, z), and `level(z, y, x)`:
mm, negative inside, and in magnitude never more than the distance to the surface. The last property makes the
coverage exact away from the edge, and leaves only the few voxels at the edge to be subdivided. `pieces()`
gives the parts whose union the shape is.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Ellipsoid:
    """|x/a|^n + |y/b|^n + |z/c|^n < 1 about a centre, turned about +z.

    Attributes
    ----------
    centre_mm : tuple of 3 float
        (x, y, z), mm.
    semi_axes_mm : tuple of 3 float
        (a, b, c) along x, y, z, mm; c may be infinite: a column along the table.
    rotation_deg : float
        Degrees.
    exponent : float
        n >= 2; 2 is the ellipsoid, more is squarer.

    Raises
    ------
    ValueError
        For a length that is not positive, or an exponent under 2.
    """

    centre_mm: tuple[float, float, float]
    semi_axes_mm: tuple[float, float, float]
    rotation_deg: float = 0.0
    exponent: float = 2.0

    def __post_init__(self):
        if len(self.centre_mm) != 3 or len(self.semi_axes_mm) != 3 or not min(self.semi_axes_mm) > 0:
            raise ValueError("centre_mm and semi_axes_mm are three lengths each (x, y, z), the latter positive")
        if not self.exponent >= 2:
            raise ValueError(f"exponent {self.exponent} must be at least 2")

    def bounds_mm(self) -> tuple[np.ndarray, np.ndarray]:
        """Corners (low, high) of its bounding box, (x, y, z), mm."""
        a, b, c = self.semi_axes_mm
        cos, sin = (
            abs(math.cos(math.radians(self.rotation_deg))),
            abs(math.sin(math.radians(self.rotation_deg))),
        )
        if self.exponent == 2:
            half = np.array([math.hypot(a * cos, b * sin), math.hypot(a * sin, b * cos), c])
        else:  # the box around the turned box
            half = np.array([a * cos + b * sin, a * sin + b * cos, c])
        return np.array(self.centre_mm) - half, np.array(self.centre_mm) + half

    def pieces(self) -> tuple[Ellipsoid, ...]:
        """The ellipsoid itself."""
        return (self,)

    def level(self, z, y, x):
        """Distance to the surface or less, mm, negative inside: see the module's docstring."""
        cx, cy, cz = self.centre_mm
        a, b, c = self.semi_axes_mm
        cos, sin = math.cos(math.radians(self.rotation_deg)), math.sin(math.radians(self.rotation_deg))
        u = ((x - cx) * cos + (y - cy) * sin) / a
        v = ((y - cy) * cos - (x - cx) * sin) / b
        n = self.exponent
        power = u * u + v * v if n == 2 else np.abs(u) ** n + np.abs(v) ** n
        if math.isfinite(c):  # a column is the same at every z
            power = power + np.abs((z - cz) / c) ** n
        norm = np.sqrt(power) if n == 2 else power ** (1 / n)
        # the norm grows by at most 1/min(semi-axes) per mm, so this never overstates the distance
        return (norm - 1) * min(self.semi_axes_mm)


@dataclass(frozen=True)
class Tube:
    """A polyline as thick as the radii interpolated along it.

    Attributes
    ----------
    points_mm : tuple of tuple of 3 float
        Corners (x, y, z) of the polyline, two at least, mm.
    radii_mm : tuple of float
        One for each point, mm.

    Raises
    ------
    ValueError
        For fewer points, or a radius that is missing or not positive.
    """

    points_mm: tuple[tuple[float, float, float], ...]
    radii_mm: tuple[float, ...]

    def __post_init__(self):
        if len(self.points_mm) < 2 or any(len(p) != 3 for p in self.points_mm):
            raise ValueError("points_mm needs at least two points of three coordinates (x, y, z)")
        if len(self.radii_mm) != len(self.points_mm) or not min(self.radii_mm) > 0:
            raise ValueError("radii_mm needs one positive radius per point")

    def bounds_mm(self) -> tuple[np.ndarray, np.ndarray]:
        """Corners (low, high) of its bounding box, (x, y, z), mm."""
        points, radii = np.array(self.points_mm, float), np.array(self.radii_mm, float)[:, None]
        return (points - radii).min(axis=0), (points + radii).max(axis=0)

    def pieces(self) -> tuple[Tube, ...]:
        """One tube per segment: each has a small bounding box of its own."""
        return tuple(
            Tube(p, r)
            for p, r in zip(itertools.pairwise(self.points_mm), itertools.pairwise(self.radii_mm), strict=True)
        )

    def level(self, z, y, x):
        """Distance to the surface or less, mm, negative inside: see the module's docstring."""
        if len(self.points_mm) > 2:
            return np.minimum.reduce([piece.level(z, y, x) for piece in self.pieces()])
        (p, q), (r, s) = np.array(self.points_mm, float), self.radii_mm
        d = q - p
        along = np.clip(((x - p[0]) * d[0] + (y - p[1]) * d[1] + (z - p[2]) * d[2]) / (d @ d), 0, 1)
        gap = np.sqrt((x - p[0] - along * d[0]) ** 2 + (y - p[1] - along * d[1]) ** 2 + (z - p[2] - along * d[2]) ** 2)
        # dividing by the slope of the cone keeps this from overstating the distance
        return (gap - r - along * (s - r)) / math.hypot(1, (s - r) / math.sqrt(d @ d))


def window(shape, axes: tuple[np.ndarray, ...], spacing: tuple[float, ...]) -> tuple[slice, slice, slice]:
    """Index ranges (z, y, x) of the voxels that the shape can touch; an empty range if it misses the grid.

    Parameters
    ----------
    axes : tuple of 3 ndarray
        Voxel centres along z, y and x, mm.
    spacing : tuple of 3 float
        Voxel size (z, y, x), mm.

    Returns
    -------
    tuple of 3 slice
    """
    low, high = shape.bounds_mm()
    return tuple(
        slice(*np.searchsorted(axis, [low[i] - step / 2, high[i] + step / 2]))
        for axis, step, i in zip(axes, spacing, (2, 1, 0), strict=True)
    )


def coverage(shape, axes: tuple[np.ndarray, ...], spacing: tuple[float, ...], subdivisions: int = 4) -> np.ndarray:
    """Share of each voxel that lies inside the shape.

    Parameters
    ----------
    axes : tuple of 3 ndarray
        Voxel centres along z, y and x, mm.
    spacing : tuple of 3 float
        Voxel size (z, y, x), mm.
    subdivisions : int, optional
        Voxels at the edge are divided into this many along each axis; the inside ones are counted.

    Returns
    -------
    ndarray of float32, shape (z, y, x)
        From 0 to 1.
    """
    full = tuple(map(len, axes))
    if np.isinf(shape.bounds_mm()[0][2]):  # a column: every slice is like the first
        axes = (axes[0][:1], *axes[1:])
    level = np.full(tuple(map(len, axes)), np.inf)
    for piece in shape.pieces():
        box = window(piece, axes, spacing)
        part = tuple(axis[extent] for axis, extent in zip(axes, box, strict=True))
        level[box] = np.minimum(level[box], piece.level(*np.ix_(*part)))
    share = (level < 0).astype(np.float32)
    index = np.nonzero(np.abs(level) <= 0.5 * math.hypot(*spacing))
    if index[0].size == 0:
        return np.broadcast_to(share, full)
    points = [axis[i] for axis, i in zip(axes, index, strict=True)]
    steps = (np.arange(subdivisions) + 0.5) / subdivisions - 0.5
    offsets = np.array(list(itertools.product(steps, repeat=3))) * spacing
    inside = np.zeros((index[0].size, len(offsets)), bool)
    for piece in shape.pieces():
        low, high = piece.bounds_mm()
        near = np.all(
            [(p >= low[i] - s) & (p <= high[i] + s) for p, s, i in zip(points, spacing, (2, 1, 0), strict=True)],
            axis=0,
        )
        inside[near] |= piece.level(*(p[near, None] + o for p, o in zip(points, offsets.T, strict=True))) < 0
    share[index] = inside.mean(axis=1)
    return np.broadcast_to(share, full)


def fade(shape, axes: tuple[np.ndarray, ...], width_mm: float) -> np.ndarray:
    """Weight that rises smoothly from 0 at the surface to 1 inside.

    Parameters
    ----------
    axes : tuple of 3 ndarray
        Voxel centres along z, y and x, mm.
    width_mm : float
        How far inside the weight is 1.

    Returns
    -------
    ndarray of float32, shape (z, y, x)
    """
    z, y, x = np.ix_(*axes)
    depth = np.clip(-shape.level(z, y, x) / width_mm, 0, 1)
    return (depth * depth * (3 - 2 * depth)).astype(np.float32)
