"""What Joseph's sums change when their rays are displaced: the derivatives of kernels.trace by the rays' coordinates.

A ray steps through the planes across its in-plane main direction. With t the plane's number from the grid's middle, it
meets a plane at the padded voxel index a + b t along the other in-plane axis and c + d t along z. Interpolation is
bilinear, so the derivatives of a sum by a, b, c and d are sums of differences between neighbouring voxels.
"""

import math

import numpy as np
from numba import njit

from .lanes import OPTIONS

COORDINATES = 4  # a, b, c and d


@njit(**OPTIONS)
def trace_slopes(volumes, occupied, slopes, first_view, shape, along_x, across, level, climb, rows_mm):
    """Add to `slopes` the derivatives of the sums of every ray, all views from `first_view` on.

    volumes    [lane, voxel], each flat [y + 2, x + 2, z + 2]
    occupied   [lane, voxel column], whether any voxel of it is not zero, flat [y + 2, x + 2]
    slopes     [lane, view, column, row, coordinate], coordinates in the order a, c, b, d
    shape      (z, y, x) of the grid without its border
    along_x    (view, column) whether the main direction is x
    across     (view, column, 2): a and b
    level      (view,), climb (view, column, 2), rows_mm (row,): c = level + climb[0] v and d = climb[1] v of a row at v
    """
    nz, ny, nx = shape
    lanes, views, columns, rows = slopes.shape[0], slopes.shape[1], slopes.shape[2], slopes.shape[3]
    for lane in range(lanes):
        volume = volumes[lane]
        for i in range(views):
            view = first_view + i
            for column in range(columns):
                if along_x[view, column]:
                    n, n_other, step, step_other = nx, ny, 1, nx + 2
                else:
                    n, n_other, step, step_other = ny, nx, nx + 2, 1
                a, b = across[view, column, 0], across[view, column, 1]
                for plane in range(n):
                    middle = plane - (n - 1) * 0.5
                    other = a + b * middle
                    j = int(math.floor(other))
                    if j < 0 or j > n_other:
                        continue
                    first = (plane + 1) * step + j * step_other
                    if not (occupied[lane, first] or occupied[lane, first + step_other]):
                        continue
                    weight, t = np.float32(other - j), np.float32(middle)
                    rise = climb[view, column, 0] + climb[view, column, 1] * middle
                    for row in range(rows):
                        z = level[view] + rise * rows_mm[row]
                        if z < 0.0 or z >= nz + 1.0:
                            continue
                        k = int(z)
                        up = np.float32(z - k)
                        near, far = first * (nz + 2) + k, (first + step_other) * (nz + 2) + k
                        low, high = volume[near], volume[near + 1]
                        low_step, high_step = volume[far] - low, volume[far + 1] - high
                        by_other = low_step + up * (high_step - low_step)
                        by_z = high - low + weight * (high_step - low_step)
                        # Side by side, so that one vector instruction adds all four.
                        slopes[lane, i, column, row, 0] += by_other
                        slopes[lane, i, column, row, 1] += by_z
                        slopes[lane, i, column, row, 2] += t * by_other
                        slopes[lane, i, column, row, 3] += t * by_z


@njit(**OPTIONS)
def follow(paths, slopes, traced, traced_between, rays, rays_between, result):
    """Path lengths of displaced rays: the sums of those traced and their slopes times the change of the coordinates,
    times the new length between two planes.

    paths, result   [lane, view, row, column], mm
    slopes          as trace_slopes makes them
    ..._between     (view, column, 2): share of the way to the detector between two planes, and the square of that way
                    in the plane
    traced, rays    across, level, climb and rows_mm as trace_slopes takes them, of the rays traced and those displaced
    """
    across, level, climb, rows_mm = traced
    new_across, new_level, new_climb, new_rows_mm = rays
    lanes, views, rows, columns = paths.shape
    for view in range(views):
        for column in range(columns):
            da = new_across[view, column, 0] - across[view, column, 0]
            db = new_across[view, column, 1] - across[view, column, 1]
            for row in range(rows):
                v, new = rows_mm[row], new_rows_mm[row]
                dc = new_level[view] - level[view] + new_climb[view, column, 0] * new - climb[view, column, 0] * v
                dd = new_climb[view, column, 1] * new - climb[view, column, 1] * v
                length = traced_between[view, column, 0] * math.sqrt(traced_between[view, column, 1] + v * v)
                new_length = rays_between[view, column, 0] * math.sqrt(rays_between[view, column, 1] + new * new)
                for lane in range(lanes):
                    by = slopes[lane, view, column, row]
                    change = da * by[0] + dc * by[1] + db * by[2] + dd * by[3]
                    result[lane, view, row, column] = (paths[lane, view, row, column] / length + change) * new_length
