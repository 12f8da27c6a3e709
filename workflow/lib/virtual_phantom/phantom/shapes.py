"""Solid shapes in mm, and the fraction of each voxel that they fill.

A shape has three methods:

* `bounds_mm()`: corners (low, high) of its bounding box, in (x, y, z)
* `level(z, y, x)`: lower bound of the distance to the surface, mm, negative inside. Only voxels at the edge need to be
  subdivided to find the coverage.
* `pieces()`: parts whose union is the shape
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Ellipsoid:
    """Superellipsoid |x/a|^n + |y/b|^n + |z/c|^n < 1, rotated about +z; ValueError for invalid values.

    Attributes
    ----------
    centre_mm : tuple of 3 float
        (x, y, z).
    semi_axes_mm : tuple of 3 float
        (a, b, c); c may be infinite, for a column along z.
    exponent : float
        n >= 2; 2 for an ellipsoid.
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
        angle = math.radians(self.rotation_deg)
        cos, sin = abs(math.cos(angle)), abs(math.sin(angle))
        if self.exponent == 2:
            half = np.array([math.hypot(a * cos, b * sin), math.hypot(a * sin, b * cos), c])
        else:  # the box around the rotated box
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
        # the norm grows by at most 1 / min(semi-axes) per mm, so this is a lower bound of the distance
        return (norm - 1) * min(self.semi_axes_mm)

    def change(self, steps_mm: tuple[float, float, float]) -> float:
        """Upper limit of the change of `level` by a displacement (z, y, x) of this size or less along each axis, mm."""
        z, y, x = steps_mm
        a, b, c = self.semi_axes_mm
        # A Euclidean norm is the largest for all exponents.
        return math.hypot(z / c, y / min(a, b), x / min(a, b)) * min(self.semi_axes_mm)


@dataclass(frozen=True)
class Tube:
    """Polyline of two or more points (x, y, z) with interpolated radii; ValueError for invalid values."""

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
        """Return a tube per segment, with small bounding boxes."""
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
        # divided by the slope of the cone, so this is a lower bound of the distance
        return (gap - r - along * (s - r)) / math.hypot(1, (s - r) / math.sqrt(d @ d))

    def change(self, steps_mm: tuple[float, float, float]) -> float:
        """As Ellipsoid.change: a lower bound of the distance changes by the length of the displacement at most."""
        return math.hypot(*steps_mm)


def window(shape, axes: tuple[np.ndarray, ...], spacing: tuple[float, ...]) -> tuple[slice, slice, slice]:
    """Return the index ranges (z, y, x) of the voxels in the bounding box of a shape; parameters as in `coverage`."""
    low, high = shape.bounds_mm()
    return tuple(
        slice(*np.searchsorted(axis, [low[i] - step / 2, high[i] + step / 2]))
        for axis, step, i in zip(axes, spacing, (2, 1, 0), strict=True)
    )


def coverage(shape, axes: tuple[np.ndarray, ...], spacing: tuple[float, ...], subdivisions: int = 4) -> np.ndarray:
    """Return the fraction of each voxel inside the shape, float32 [z, y, x].

    Parameters
    ----------
    axes : tuple of 3 ndarray
        Voxel centers along z, y and x, mm.
    spacing : tuple of 3 float
        Voxel size (z, y, x), mm.
    subdivisions : int, optional
        Sample points along each axis of voxels at the edge.
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
    half_voxel = tuple(step / 2 for step in spacing)
    index = np.nonzero(np.abs(level) <= max(piece.change(half_voxel) for piece in shape.pieces()))
    if index[0].size == 0:
        return np.broadcast_to(share, full)
    points = [axis[i] for axis, i in zip(axes, index, strict=True)]
    steps = (np.arange(subdivisions) + 0.5) / subdivisions - 0.5
    # Each axis has its own dimension, so that a shape computes terms of one or two axes only once.
    offsets = np.ix_(*(steps * wide for wide in spacing))
    inside = np.zeros((index[0].size, *[subdivisions] * 3), bool)
    for piece in shape.pieces():
        low, high = piece.bounds_mm()
        near = np.all(
            [(p >= low[i] - s) & (p <= high[i] + s) for p, s, i in zip(points, spacing, (2, 1, 0), strict=True)],
            axis=0,
        )
        fine = (p[near].reshape(-1, 1, 1, 1) + o for p, o in zip(points, offsets, strict=True))
        inside[near] |= piece.level(*fine) < 0
    share[index] = inside.mean(axis=(1, 2, 3))
    return np.broadcast_to(share, full)


def fade(shape, axes: tuple[np.ndarray, ...], width_mm: float) -> np.ndarray:
    """Return a weight, float32 [z, y, x], that rises smoothly from 0 at the surface to 1 at depth `width_mm`."""
    z, y, x = np.ix_(*axes)
    depth = np.clip(-shape.level(z, y, x) / width_mm, 0, 1)
    return (depth * depth * (3 - 2 * depth)).astype(np.float32)
