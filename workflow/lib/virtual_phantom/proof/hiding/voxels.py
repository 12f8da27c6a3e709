"""Stated objects on voxels: HU and labels for the diagnosis."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...base.geometry import Grid
from ...phantom.shapes import coverage
from .objects import ScannedObject
from .orbits import Orbit

STATED_PER_PIXEL = 3  # stated voxels per detector pixel at the isocenter
REACH = 1.3  # height of the cone beam at the object's far side over its height at the isocenter
# Additional height for displaced rows. Rays through the end faces would differ between the simulators.
BEYOND_MM = 6.0
AIR_HU = -1000.0
CONSTANT_SLICES = 4  # of an object that is constant along z


def grid_of(scanned: ScannedObject, orbits: Sequence[Orbit]) -> Grid:
    """Return a grid around the object with STATED_PER_PIXEL voxels per pixel, cut to the height of the beams."""
    pixel = scanned.pixel_mm(orbits[0].columns)
    height = max(
        orbit.rows * pixel * REACH + abs(orbit.feed_mm) * orbit.views / orbit.views_per_rotation for orbit in orbits
    )
    along = plane = pixel / STATED_PER_PIXEL
    if all(np.isinf(part.semi_axes_mm[2]) for part in (*scanned.parts, *scanned.outside)):
        along = (height + 2 * BEYOND_MM) / CONSTANT_SLICES
    low, high = np.array([part.shape.bounds_mm() for part in (scanned.parts[0], *scanned.outside)]).transpose(1, 0, 2)
    half = np.maximum(-low.min(axis=0), high.max(axis=0))[:2] + plane
    slices = 2 * int(np.ceil((height + 2 * BEYOND_MM) / along / 2))
    x, y = (2 * int(np.ceil(side / plane)) for side in half)
    return Grid((slices, y, x), (along, plane, plane))


def stated_hu(scanned: ScannedObject, grid: Grid) -> np.ndarray:
    """Return the CT numbers of an object of tissues, HU, float32 of shape (z, y, x)."""
    parts, inner = (*scanned.parts, *scanned.outside), len(scanned.parts)
    shares = [coverage(part.shape, grid.axes_mm(), grid.spacing) for part in parts]
    shares[0] = np.maximum(shares[0] - sum(shares[1:inner], np.float32(0)), 0)
    hu = np.full(grid.shape, AIR_HU, np.float32)
    for part, share in zip(parts, shares, strict=True):
        hu += np.float32((AIR_HU if part.material == "air" else part.hu) - AIR_HU) * share
    return hu


def labels(scanned: ScannedObject, grid: Grid) -> np.ndarray:
    """Return 1 + the index of the part at the center of each voxel, or 0, int16 of shape (z, y, x)."""
    found = np.zeros(grid.shape, np.int16)
    z, y, x = np.ix_(*grid.axes_mm())
    for number, part in enumerate(scanned.parts, start=1):
        found[np.broadcast_to(part.shape.level(z, y, x) < 0, grid.shape)] = number
    return found
