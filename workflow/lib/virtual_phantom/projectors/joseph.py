"""Joseph's method: the steps that all projectors of the CPU engine share.

A ray steps through the planes across its main direction in the x-y plane and interpolates bilinearly in each [1]_. Rays
above each other along z have the same shadow (projection onto the x-y plane). The shadow meets plane p of the grid at
the padded voxel index ``position + slope (p - origin)`` along the other in-plane axis, between a cell and the next.

References
----------
.. [1] P. M. Joseph, IEEE Trans. Med. Imaging 1, 192, 1982.
"""

import math
from typing import NamedTuple

import numpy as np

from ..base.compiled import compiled
from .lanes import OPTIONS

COORDINATES = 4  # a, b, c and d of Bundles


class Bundles(NamedTuple):
    """Rays in the coordinates of a grid, in bundles of rays with one shadow (ScanGeometry.bundles).

    Let t be the number of a plane, counted from the middle of the grid. A ray meets the plane at the padded voxel index
    a + b t along the other in-plane axis and c + d t along z. If the ray rises by v from the source to the detector,
    c = level + climb[0] v and d = climb[1] v.

    Attributes
    ----------
    along_x : ndarray of bool, shape (views, bundles)
        True: the ray steps through planes across x. False: across y.
    across : ndarray, shape (views, bundles, 2)
        a and b.
    level : ndarray, shape (views,)
        Padded voxel index of the source along z.
    climb : ndarray, shape (views, bundles, 2)
        Slices per mm of rise: up to the middle plane, and from plane to plane.
    lift_mm : ndarray, shape (views, bundles)
    rows_mm : ndarray, shape (rows,)
        The rise v is lift_mm + rows_mm.
    between : ndarray, shape (views, bundles, 2)
        Fraction of the distance to the detector between two planes, and the squared in-plane distance, mm^2.
    """

    along_x: np.ndarray
    across: np.ndarray
    level: np.ndarray
    climb: np.ndarray
    lift_mm: np.ndarray
    rows_mm: np.ndarray
    between: np.ndarray


class Shadow(NamedTuple):
    """Projection of rays onto the x-y plane, in the coordinates of a grid.

    Attributes
    ----------
    position, slope : float
        Padded voxel index in plane `origin`, and its change from plane to plane.
    planes, cells : int
        Number of planes, and of voxels along the other in-plane axis.
    step, step_other : int
        Offset in memory from plane to plane, and from cell to cell.
    """

    position: float
    slope: float
    origin: float
    planes: int
    cells: int
    step: int
    step_other: int


@compiled(inline="always", **OPTIONS)
def bundle_shadow(rays, view, bundle, shape):
    """Return the Shadow of a bundle; offsets count the voxel columns of a padded grid of `shape` (z, y, x)."""
    _, ny, nx = shape
    planes, cells, step, step_other = (nx, ny, 1, nx + 2) if rays.along_x[view, bundle] else (ny, nx, nx + 2, 1)
    a, b = rays.across[view, bundle, 0], rays.across[view, bundle, 1]
    return Shadow(a, b, (planes - 1) * 0.5, planes, cells, step, step_other)


@compiled(inline="always", **OPTIONS)
def planes_between(shadow, low, high):
    """Return a range of planes (first, last + 1) that contains all in which the position is in [low, high)."""
    if abs(shadow.slope) < 1e-6:
        return 0, shadow.planes
    enters = (low - shadow.position) / shadow.slope + shadow.origin
    leaves = (high - shadow.position) / shadow.slope + shadow.origin
    first = max(0.0, math.floor(min(enters, leaves)))
    last = min(float(shadow.planes), math.ceil(max(enters, leaves)) + 1.0)
    return int(first), int(max(first, last))


@compiled(inline="always", **OPTIONS)
def cross(shadow, plane):
    """Return the plane's number from the origin, the cell in which the shadow meets it, and the next cell's weight."""
    number = plane - shadow.origin
    position = shadow.position + shadow.slope * number
    cell = int(math.floor(position))
    return number, cell, position - cell
