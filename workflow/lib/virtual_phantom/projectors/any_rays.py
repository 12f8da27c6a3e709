"""Joseph's sums along any rays, and what they change when the rays are displaced: derivatives by the rays' coordinates.

A ray steps through the planes across its in-plane main direction. With t the plane's number from the grid's middle, it
meets a plane at the padded voxel index a + b t along the other in-plane axis and c + d t along z. Interpolation is
bilinear, so the derivatives of a sum by a, b, c and d are sums of differences between neighbouring voxels.

rows.py has the same for bundles of many rows, and kernels.py for many realisations, with the transpose.
"""

import math
from typing import NamedTuple

import numpy as np

from ..base.compiled import compiled
from .lanes import OPTIONS

COORDINATES = 4  # a, b, c and d


class Bundles(NamedTuple):
    """Rays in the coordinates of a grid, in bundles whose rays differ in c and d alone (ScanGeometry.bundles).

    A ray's rise v is that from the source to the detector: c = level + climb[0] v, d = climb[1] v.

    Attributes
    ----------
    along_x : ndarray of bool, shape (views, bundles)
        Whether planes across x are stepped through, else those across y.
    across : ndarray, shape (views, bundles, 2)
        a and b.
    level : ndarray, shape (views,)
        Padded voxel index of the source along z.
    climb : ndarray, shape (views, bundles, 2)
        Change along z per mm of rise, to the middle plane, and from plane to plane.
    lift_mm : ndarray, shape (views, bundles)
    rows_mm : ndarray, shape (rows,)
        The rise is their sum.
    between : ndarray, shape (views, bundles, 2)
        Share of the way to the detector between two planes, and the square of that way in the plane, mm^2.
    """

    along_x: np.ndarray
    across: np.ndarray
    level: np.ndarray
    climb: np.ndarray
    lift_mm: np.ndarray
    rows_mm: np.ndarray
    between: np.ndarray


@compiled(inline="always", **OPTIONS)
def planes_between(a, b, n, low, high):
    """Planes [first, last) of n outside of which a + b t lies outside of [low, high)."""
    if abs(b) < 1e-6:
        return 0, n
    one, another = (low - a) / b + (n - 1) * 0.5, (high - a) / b + (n - 1) * 0.5
    first = max(0.0, math.floor(min(one, another)))
    last = min(float(n), math.ceil(max(one, another)) + 1.0)
    return int(first), int(max(first, last))


@compiled(inline="always", **OPTIONS)
def axes(along_x, shape):
    """Planes, voxels along the other in-plane axis, and voxel columns from one to the next along both."""
    _, ny, nx = shape
    return (nx, ny, 1, nx + 2) if along_x else (ny, nx, nx + 2, 1)


@compiled(**OPTIONS)
def trace_sums(volumes, occupied, sums, first_view, shape, rays, apart):
    """Add what interpolation meets in the planes along every bundle's first ray.

    Parameters
    ----------
    volumes : ndarray of float32, shape (lanes, voxels)
        Each flat [y + 2, x + 2, z + 2].
    occupied : ndarray of bool, shape (lanes, voxel columns)
        Whether any voxel of a column is not zero, flat [y + 2, x + 2].
    sums : ndarray, shape (lanes, views, bundles)
        What is added to.
    first_view : int
        Of the rays, that of the sums' first view.
    shape : tuple of 3 int
        (z, y, x) of the grid without its border.
    apart : int
        From one bundle to that which is traced next, which had better meet much the same voxels: the columns of a
        detector that is not upright, else 1.
    """
    nz = shape[0]
    lanes, views, bundles = sums.shape
    together = bundles // apart
    for lane in range(lanes):
        volume = volumes[lane]
        for i in range(views):
            view = first_view + i
            for turn in range(bundles):
                bundle = turn if apart == 1 else turn % together * apart + turn // together
                n, n_other, step, step_other = axes(rays.along_x[view, bundle], shape)
                a, b = rays.across[view, bundle, 0], rays.across[view, bundle, 1]
                rise = rays.lift_mm[view, bundle] + rays.rows_mm[0]
                c = rays.level[view] + rays.climb[view, bundle, 0] * rise
                d = rays.climb[view, bundle, 1] * rise
                start, stop = planes_between(a, b, n, 0, n_other + 1)
                if d == 0.0 and (c < 0.0 or c >= nz + 1.0):
                    continue
                k, up = int(c), np.float32(c - int(c))
                total = 0.0
                for plane in range(start, stop):
                    middle = plane - (n - 1) * 0.5
                    other = a + b * middle
                    if other < 0.0 or other >= n_other + 1.0:
                        continue
                    j = int(other)
                    first = (plane + 1) * step + j * step_other
                    if not (occupied[lane, first] or occupied[lane, first + step_other]):
                        continue
                    if d != 0.0:  # else all in one height, as in prisms
                        z = c + d * middle
                        if z < 0.0 or z >= nz + 1.0:
                            continue
                        k, up = int(z), np.float32(z - int(z))
                    weight = np.float32(other - j)
                    near = first * (nz + 2) + k
                    far = near + step_other * (nz + 2)
                    low = volume[near] + weight * (volume[far] - volume[near])
                    if up > np.float32(0.0):
                        high = volume[near + 1] + weight * (volume[far + 1] - volume[near + 1])
                        low += up * (high - low)
                    total += low
                sums[lane, i, bundle] += total


@compiled(**OPTIONS)
def trace_slopes(volumes, occupied, slopes, first_view, shape, rays):
    """Add the derivatives of the sums of every ray.

    Parameters
    ----------
    volumes : ndarray of float32, shape (lanes, voxels)
        Each flat [y + 2, x + 2, z + 2].
    occupied : ndarray of bool, shape (lanes, voxel columns)
        Whether any voxel of a column is not zero, flat [y + 2, x + 2].
    slopes : ndarray, shape (views, bundles, lanes, 4, rows)
        What is added to; coordinates in the order a, c, b, d.
    first_view : int
        Of the rays, that of the slopes' first view.
    shape : tuple of 3 int
        (z, y, x) of the grid without its border.
    """
    nz = shape[0]
    views, bundles, lanes, _, rows = slopes.shape
    for lane in range(lanes):
        volume = volumes[lane]
        for i in range(views):
            view = first_view + i
            for bundle in range(bundles):
                n, n_other, step, step_other = axes(rays.along_x[view, bundle], shape)
                a, b = rays.across[view, bundle, 0], rays.across[view, bundle, 1]
                lift, level = rays.lift_mm[view, bundle], rays.level[view]
                start, stop = planes_between(a, b, n, 0, n_other + 1)
                for plane in range(start, stop):
                    middle = plane - (n - 1) * 0.5
                    other = a + b * middle
                    j = int(math.floor(other))
                    if j < 0 or j > n_other:
                        continue
                    first = (plane + 1) * step + j * step_other
                    if not (occupied[lane, first] or occupied[lane, first + step_other]):
                        continue
                    weight, t = np.float32(other - j), np.float32(middle)
                    rise = rays.climb[view, bundle, 0] + rays.climb[view, bundle, 1] * middle
                    for row in range(rows):
                        z = level + rise * (lift + rays.rows_mm[row])
                        if z < 0.0 or z >= nz + 1.0:
                            continue
                        k = int(z)
                        up = np.float32(z - k)
                        near, far = first * (nz + 2) + k, (first + step_other) * (nz + 2) + k
                        low, high = volume[near], volume[near + 1]
                        low_step, high_step = volume[far] - low, volume[far + 1] - high
                        by_other = low_step + up * (high_step - low_step)
                        by_z = high - low + weight * (high_step - low_step)
                        slopes[i, bundle, lane, 0, row] += by_other
                        slopes[i, bundle, lane, 1, row] += by_z
                        slopes[i, bundle, lane, 2, row] += t * by_other
                        slopes[i, bundle, lane, 3, row] += t * by_z


@compiled(**OPTIONS)
def path_lengths(sums, place, rays, result):
    """Sums times the length between two planes.

    Parameters
    ----------
    sums : ndarray of float32, shape (views, bundles, lanes, padded rows)
        As trace_rows makes them.
    place : ndarray of int, shape (rows,)
        Of each row among the padded ones.
    result : ndarray of float32, shape (lanes, views, rows, bundles)
        What is written to, mm.
    """
    lanes, views, rows, bundles = result.shape
    for view in range(views):
        for row in range(rows):
            for bundle in range(bundles):
                rise = rays.lift_mm[view, bundle] + rays.rows_mm[row]
                length = rays.between[view, bundle, 0] * math.sqrt(rays.between[view, bundle, 1] + rise * rise)
                for lane in range(lanes):
                    result[lane, view, row, bundle] = sums[view, bundle, lane, place[row]] * length


@compiled(**OPTIONS)
def follow(paths, slopes, traced, rays, result):
    """Path lengths of displaced rays.

    They are the sums of those traced and their slopes times the change of the coordinates, times the new length between
    two planes.

    Parameters
    ----------
    paths : ndarray, shape (lanes, views, rows, bundles)
        Of the rays traced, mm.
    slopes : ndarray, shape (views, bundles, lanes, 4, rows)
        As trace_slopes makes them; further rows are left alone.
    traced, rays : Bundles
        The rays traced and those displaced.
    result : ndarray, shape (lanes, views, rows, bundles)
        What is written to, mm.
    """
    lanes, views, rows, bundles = paths.shape
    for view in range(views):
        for bundle in range(bundles):
            da = rays.across[view, bundle, 0] - traced.across[view, bundle, 0]
            db = rays.across[view, bundle, 1] - traced.across[view, bundle, 1]
            raised = rays.level[view] - traced.level[view]
            c, new_c = traced.climb[view, bundle, 0], rays.climb[view, bundle, 0]
            d, new_d = traced.climb[view, bundle, 1], rays.climb[view, bundle, 1]
            for row in range(rows):
                v = traced.lift_mm[view, bundle] + traced.rows_mm[row]
                new = rays.lift_mm[view, bundle] + rays.rows_mm[row]
                dc = raised + new_c * new - c * v
                dd = new_d * new - d * v
                length = traced.between[view, bundle, 0] * math.sqrt(traced.between[view, bundle, 1] + v * v)
                new_length = rays.between[view, bundle, 0] * math.sqrt(rays.between[view, bundle, 1] + new * new)
                for lane in range(lanes):
                    by = slopes[view, bundle, lane]
                    change = da * by[0, row] + dc * by[1, row] + db * by[2, row] + dd * by[3, row]
                    result[lane, view, row, bundle] = (paths[lane, view, row, bundle] / length + change) * new_length
