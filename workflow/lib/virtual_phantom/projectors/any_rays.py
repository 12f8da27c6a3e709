"""Sums along single rays by Joseph's method (joseph.py), and their derivatives with respect to the rays' coordinates.

The coordinates are a, b, c and d of a ray (joseph.Bundles). Interpolation is bilinear, so the derivatives are sums of
differences between neighboring voxels. Bundles of many rows use rows.py instead.
"""

import math

import numpy as np

from ..base.compiled import compiled
from .joseph import bundle_shadow, cross, planes_between
from .lanes import OPTIONS


@compiled(**OPTIONS)
def trace_sums(volumes, occupied, sums, first_view, shape, rays, apart):
    """Add the sum of the interpolated values along the first ray of every bundle.

    Parameters
    ----------
    volumes : ndarray of float32, shape (lanes, voxels)
        Each flat [y + 2, x + 2, z + 2].
    occupied : ndarray of bool, shape (lanes, voxel columns)
        Whether a voxel column has a nonzero voxel, flat [y + 2, x + 2].
    sums : ndarray, shape (lanes, views, bundles)
        Output, added to.
    first_view : int
        Number of the view, among those of the rays, that is the first of `sums`.
    shape : tuple of 3 int
        (z, y, x) of the grid without padding.
    apart : int
        Step from one traced bundle to the next, so that both read the same voxels: the number of columns if the
        detector is not upright, otherwise 1.
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
                shadow = bundle_shadow(rays, view, bundle, shape)
                rise = rays.lift_mm[view, bundle] + rays.rows_mm[0]
                c = rays.level[view] + rays.climb[view, bundle, 0] * rise
                d = rays.climb[view, bundle, 1] * rise
                start, stop = planes_between(shadow, 0, shadow.cells + 1)
                if d == 0.0 and (c < 0.0 or c >= nz + 1.0):
                    continue
                k, up = int(c), np.float32(c - int(c))
                total = 0.0
                for plane in range(start, stop):
                    number, cell, share = cross(shadow, plane)
                    if cell < 0 or cell > shadow.cells:
                        continue
                    first = (plane + 1) * shadow.step + cell * shadow.step_other
                    if not (occupied[lane, first] or occupied[lane, first + shadow.step_other]):
                        continue
                    if d != 0.0:  # otherwise the height is constant, as in prisms
                        z = c + d * number
                        if z < 0.0 or z >= nz + 1.0:
                            continue
                        k, up = int(z), np.float32(z - int(z))
                    weight = np.float32(share)
                    near = first * (nz + 2) + k
                    far = near + shadow.step_other * (nz + 2)
                    low = volume[near] + weight * (volume[far] - volume[near])
                    if up > np.float32(0.0):
                        high = volume[near + 1] + weight * (volume[far + 1] - volume[near + 1])
                        low += up * (high - low)
                    total += low
                sums[lane, i, bundle] += total


@compiled(**OPTIONS)
def trace_slopes(volumes, occupied, slopes, first_view, shape, rays):
    """Add the derivatives of the sums of all rays with respect to their coordinates.

    Parameters
    ----------
    volumes, occupied, first_view, shape
        See `trace_sums`.
    slopes : ndarray, shape (views, bundles, lanes, 4, rows)
        Output, added to; coordinates in the order a, c, b, d.
    """
    nz = shape[0]
    views, bundles, lanes, _, rows = slopes.shape
    for lane in range(lanes):
        volume = volumes[lane]
        for i in range(views):
            view = first_view + i
            for bundle in range(bundles):
                shadow = bundle_shadow(rays, view, bundle, shape)
                lift, level = rays.lift_mm[view, bundle], rays.level[view]
                start, stop = planes_between(shadow, 0, shadow.cells + 1)
                for plane in range(start, stop):
                    number, cell, share = cross(shadow, plane)
                    if cell < 0 or cell > shadow.cells:
                        continue
                    first = (plane + 1) * shadow.step + cell * shadow.step_other
                    if not (occupied[lane, first] or occupied[lane, first + shadow.step_other]):
                        continue
                    weight, t = np.float32(share), np.float32(number)
                    rise = rays.climb[view, bundle, 0] + rays.climb[view, bundle, 1] * number
                    for row in range(rows):
                        z = level + rise * (lift + rays.rows_mm[row])
                        if z < 0.0 or z >= nz + 1.0:
                            continue
                        k = int(z)
                        up = np.float32(z - k)
                        near, far = first * (nz + 2) + k, (first + shadow.step_other) * (nz + 2) + k
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
    """Write path lengths in mm, [lanes, views, rows, bundles]: sums times the distance between two planes on the ray.

    `sums` are the result of rows.trace_rows, and `place` has the index of each row among its padded rows.
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
def extrapolate_lengths(paths, slopes, traced, rays, result):
    """Write path lengths of displaced rays to first order.

    The new sum is the traced sum plus its derivatives times the change of the coordinates. Sums are multiplied by the
    new distance between two planes.

    Parameters
    ----------
    paths : ndarray, shape (lanes, views, rows, bundles)
        Path lengths of the traced rays, mm.
    slopes : ndarray, shape (views, bundles, lanes, 4, rows)
        Result of `trace_slopes`; may have more rows.
    traced, rays : Bundles
        Traced and displaced rays.
    result : ndarray, shape (lanes, views, rows, bundles)
        Output, mm.
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
