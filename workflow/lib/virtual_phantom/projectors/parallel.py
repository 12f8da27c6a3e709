"""The numba kernel of weighted filtered back-projection: parallel-rebinned projections onto the volume.

Layout and interpolation are those of kernels.py, angles in place of views and distances t in place of columns.
"""

import math

import numpy as np
from numba import njit

from .kernels import OPTIONS, TILE, span
from .lanes import gather_bilinear


@njit(inline="always", **OPTIONS)
def _row_weight(height, rows, full):
    """1 in the middle share `full` of the rows, falling smoothly to 0 at the outermost rows' centres; padded rows.

    One row counts to half its height off its centre.
    """
    off_centre = abs(height - np.float32((rows + 1) * 0.5)) / np.float32(max(rows - 1, 1) * 0.5)
    s = min(np.float32(1.0), max(np.float32(0.0), (np.float32(1.0) - off_centre) / np.float32(1.0 - full)))
    return s * s * (np.float32(3.0) - np.float32(2.0) * s)


@njit(**OPTIONS)
def back_project_parallel(
    volume,
    seen,
    projections,
    first_y,
    last_y,
    shape,
    spacing,
    columns,
    rows,
    half_turn,
    sine,
    cosine,
    view_of_angle,
    source_z0,
    source_step,
    view_step,
    geometry,
    first_t,
    t_pitch,
    full,
    lanes,
):
    """Add parallel-rebinned projections [angle, t + 2, row + 2, lane] to rows first_y to last_y - 1 of the volume.

    Every voxel takes each direction of rays once: views of the same direction, half turns apart, share it in the ratio
    of their row weights. `seen` [y, x, z] counts the directions that any view gave.
    half_turn   angles per half turn
    view_of_angle   fractional view whose central ray has the angle
    """
    count = len(lanes)
    nz, ny, nx = shape
    dz, dy, dx = spacing
    radius, distance, first_row, row_pitch = geometry[0], geometry[1], geometry[4], geometry[5]
    angles = len(sine)
    step = (rows + 2) * count
    total = np.zeros(nz, dtype=np.float32)
    for y0 in range(first_y, last_y, TILE):
        for x0 in range(0, nx, TILE):
            for direction in range(half_turn):
                for y in range(y0, min(y0 + TILE, last_y)):
                    position_y = (y - (ny - 1) * 0.5) * dy
                    for x in range(x0, min(x0 + TILE, nx)):
                        position_x = (x - (nx - 1) * 0.5) * dx
                        voxel = (((y + 1) * (nx + 2) + x + 1) * (nz + 2) + 1) * count
                        total[:] = 0
                        for summing in (True, False):
                            for i in range(direction, angles, half_turn):
                                s, c = sine[i], cosine[i]
                                t = position_x * c + position_y * s
                                across = (t - first_t) / t_pitch + 1.0
                                if across < 1.0 or across > columns or abs(t) >= radius:
                                    continue
                                fan = math.asin(t / radius)
                                view = view_of_angle[i] - fan / view_step
                                depth = radius * math.cos(fan) + position_x * s - position_y * c
                                magnification = distance / (math.cos(fan) * depth)
                                source_z = source_z0 + view * source_step
                                slope = np.float32(magnification * dz / row_pitch)
                                first = np.float32(
                                    ((-(nz - 1) * 0.5 * dz - source_z) * magnification - first_row) / row_pitch + 1.0
                                )
                                start, stop = span(first, slope, rows, nz)
                                if summing:
                                    for z in range(start, stop):
                                        total[z] += _row_weight(first + slope * np.float32(z), rows, full)
                                    continue
                                j = int(across)
                                weight = np.float32(across - j)
                                base = (i * (columns + 2) + j) * step
                                for z in range(start, stop):
                                    if total[z] <= np.float32(0.0):
                                        continue
                                    height = first + slope * np.float32(z)
                                    share = _row_weight(height, rows, full) / total[z]
                                    # Only a single row is ever read off its centre.
                                    height = min(max(height, np.float32(1.0)), np.float32(rows))
                                    k = np.int32(height)
                                    up = (height - np.float32(k)) * share
                                    low = share - up
                                    near = np.float32(1.0) - weight
                                    at = base + k * count
                                    gather_bilinear(
                                        volume,
                                        voxel + z * count,
                                        projections,
                                        at,
                                        at + step,
                                        near * low,
                                        near * up,
                                        weight * low,
                                        weight * up,
                                        lanes,
                                    )
                        for z in range(nz):
                            if total[z] > np.float32(0.0):
                                seen[y, x, z] += np.float32(1.0)
