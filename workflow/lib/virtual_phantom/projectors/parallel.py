"""The numba kernel of weighted filtered back-projection: parallel-rebinned projections onto the volume.

Layout and interpolation are those of kernels.py, angles in place of views and distances t in place of columns.
"""

import math

import numpy as np
from numba import njit

from .columns import gather_line
from .kernels import span, tile_width
from .lanes import OPTIONS


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
    total,
    shares,
    rays,
    lanes,
):
    """Add parallel-rebinned projections [angle, t + 2, row + 2, lane] to rows first_y to last_y - 1 of the volume.

    Every voxel takes each direction of rays once: views of the same direction, half turns apart, share it in the ratio
    of their row weights. `seen` [y, x, z] counts the directions that any view gave.
    half_turn   angles per half turn
    view_of_angle   fractional view whose central ray has the angle
    total (z,), shares (view, z) and rays, four times (view,)   room for sums, for as many views as have one direction
    """
    count = len(lanes)
    nz, ny, nx = shape
    dz, dy, dx = spacing
    radius, distance, first_row, row_pitch = geometry[0], geometry[1], geometry[4], geometry[5]
    angles = len(sine)
    step = (rows + 2) * count
    near, at, height, slope = rays
    width = tile_width(lanes)
    for y0 in range(first_y, last_y, width):
        for x0 in range(0, nx, width):
            for direction in range(half_turn):
                for y in range(y0, min(y0 + width, last_y)):
                    position_y = (y - (ny - 1) * 0.5) * dy
                    for x in range(x0, min(x0 + width, nx)):
                        position_x = (x - (nx - 1) * 0.5) * dx
                        total[:] = 0
                        views = 0
                        for i in range(direction, angles, half_turn):
                            s, c = sine[i], cosine[i]
                            t = position_x * c + position_y * s
                            across = (t - first_t) / t_pitch + 1.0
                            if across < 1.0 or across > columns or abs(t) >= radius:
                                continue
                            fan = math.asin(t / radius)
                            view = view_of_angle[i] - fan / view_step
                            cosine_fan = math.sqrt(1.0 - (t / radius) ** 2)
                            depth = radius * cosine_fan + position_x * s - position_y * c
                            magnification = distance / (cosine_fan * depth)
                            source_z = source_z0 + view * source_step
                            bottom = (-(nz - 1) * 0.5 * dz - source_z) * magnification
                            slope[views] = magnification * dz / row_pitch
                            height[views] = (bottom - first_row) / row_pitch + 1.0
                            for z in range(nz):
                                share = _row_weight(height[views] + slope[views] * np.float32(z), rows, full)
                                shares[views, z] = share
                                total[z] += share
                            j = int(across)
                            near[views] = 1.0 - (across - j)
                            at[views] = (i * (columns + 2) + j) * step
                            views += 1
                        for z in range(nz):
                            if total[z] > np.float32(0.0):
                                seen[y, x, z] += np.float32(1.0)
                                total[z] = np.float32(1.0) / total[z]
                        voxel = (((y + 1) * (nx + 2) + x + 1) * (nz + 2) + 1) * count
                        for i in range(views):
                            for z in range(nz):
                                shares[i, z] *= total[z]
                            start, stop = span(height[i], slope[i], rows, nz)
                            if rows == 1:  # It counts to half its height off its centre.
                                height[i], slope[i] = 1.0, 0.0
                            gather_line(
                                volume,
                                voxel,
                                projections,
                                at[i],
                                at[i] + step,
                                rows + 2,
                                near[i],
                                np.float32(1.0) - near[i],
                                height[i],
                                slope[i],
                                start,
                                stop,
                                shares[i],
                                lanes,
                            )
