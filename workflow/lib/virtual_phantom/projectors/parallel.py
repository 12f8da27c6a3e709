"""Numba kernel of weighted filtered back-projection: parallel-rebinned projections onto the volume.

Layout and interpolation are as in kernels.py, with angles for views and distances t for columns.
"""

import math
from collections import namedtuple
from typing import NamedTuple

import numpy as np

from ..base.compiled import compiled
from .columns import gather_line
from .kernels import span, tile_width
from .lanes import OPTIONS


@compiled(inline="always", **OPTIONS)
def _row_weight(height, rows, full):
    """Return 1 in the central fraction `full` of the rows, with a smooth decrease to 0 at the outermost rows' centers.

    `height` counts padded rows. The weight of a single row reaches 0 at half its height from its center.
    """
    off_centre = abs(height - np.float32((rows + 1) * 0.5)) / np.float32(max(rows - 1, 1) * 0.5)
    s = min(np.float32(1.0), max(np.float32(0.0), (np.float32(1.0) - off_centre) / np.float32(1.0 - full)))
    return s * s * (np.float32(3.0) - np.float32(2.0) * s)


class ParallelScan(NamedTuple):
    """Grid and rebinned scan in the form that the kernel needs; lengths in mm.

    Attributes
    ----------
    shape, spacing : tuple of 3
        Voxels and voxel size of the grid (z, y, x).
    centre : tuple of 3 float
        Center of the grid relative to the isocenter (z, y, x).
    columns : int
        Number of distances t per angle.
    half_turn : int
        Angles per half turn.
    view_of_angle : ndarray, shape (angles,)
        Fractional view whose central ray has the angle.
    view_step : float
        Radians per view, signed.
    source_z, source_step : float
        Height of the focal center in view 0, and its change per view.
    level_z, level_radius, level_turn : ndarray, shape (levels,)
        See ParallelRays.
    level_ahead : ndarray, shape (levels, columns)
        See ParallelRays.
    first_row, row_pitch : float
        Height of row 0 on the detector, and distance between rows.
    first_t, t_pitch : float
        First distance t, and its increment.
    full : float
        Central fraction of the rows with full weight.
    """

    shape: tuple[int, int, int]
    spacing: tuple[float, float, float]
    centre: tuple[float, float, float]
    columns: int
    rows: int
    half_turn: int
    sine: np.ndarray
    cosine: np.ndarray
    view_of_angle: np.ndarray
    view_step: float
    source_z: float
    source_step: float
    level_z: np.ndarray
    level_radius: np.ndarray
    level_turn: np.ndarray
    level_ahead: np.ndarray
    first_row: float
    row_pitch: float
    first_t: float
    t_pitch: float
    full: float


# Work arrays of one thread, for all views of one direction: total (z,), shares (view, z), four arrays (view,).
Workspace = namedtuple("Workspace", "total shares near at height slope")


def empty_workspace(slices: int, views: int) -> Workspace:
    """Return work arrays of one thread."""
    near, height, slope = np.empty((3, views), np.float32)
    shares = np.empty((views, slices), np.float32)
    return Workspace(np.empty(slices, np.float32), shares, near, np.empty(views, np.intp), height, slope)


@compiled(**OPTIONS)
def back_project_parallel(volume, seen, projections, first_y, last_y, scan, workspace, line, lanes):
    """Add parallel-rebinned projections to rows first_y to last_y - 1 of the volume.

    Each direction of rays contributes once to a voxel. Views of one direction, half turns apart, are averaged with
    their row weights.

    Parameters
    ----------
    volume : ndarray of float32, flat
        Layout as in kernels.py.
    seen : ndarray of float32, shape (y, x, z)
        Number of directions that contributed; added to.
    projections : ndarray of float32, flat
        [level, angle, t + 2, row + 2, lane].
    workspace : Workspace
        Work arrays of `empty_workspace`.
    line : Line or None
        See `gather_line`.
    lanes : tuple
        One item per realization.
    """
    count = len(lanes)
    nz, ny, nx = scan.shape
    dz, dy, dx = scan.spacing
    cz, cy, cx = scan.centre
    first_row, row_pitch = scan.first_row, scan.row_pitch
    columns, rows, half_turn, full = scan.columns, scan.rows, scan.half_turn, scan.full
    sine, cosine, view_of_angle, view_step = scan.sine, scan.cosine, scan.view_of_angle, scan.view_step
    first_t, t_pitch, source_z0, source_step = scan.first_t, scan.t_pitch, scan.source_z, scan.source_step
    total, shares, near, at, height, slope = workspace
    angles, levels = len(sine), len(scan.level_z)
    same = -(-angles // half_turn)
    step = (rows + 2) * count
    width = tile_width(lanes)
    for y0 in range(first_y, last_y, width):
        for x0 in range(0, nx, width):
            for direction in range(half_turn):
                for y in range(y0, min(y0 + width, last_y)):
                    position_y = (y - (ny - 1) * 0.5) * dy + cy
                    for x in range(x0, min(x0 + width, nx)):
                        position_x = (x - (nx - 1) * 0.5) * dx + cx
                        total[:] = 0
                        views = 0
                        for image in range(levels * same):
                            level = image // same
                            i = direction + (image - level * same) * half_turn
                            if i >= angles:
                                continue
                            radius, up = scan.level_radius[level], scan.level_z[level]
                            s, c = sine[i], cosine[i]
                            t = position_x * c + position_y * s
                            across = (t - first_t) / t_pitch + 1.0
                            if across < 1.0 or across > columns or abs(t) >= radius:
                                continue
                            j = int(across)
                            near[views] = 1.0 - (across - j)
                            ahead = scan.level_ahead[level, j - 1]
                            ahead += (across - j) * (scan.level_ahead[level, min(j, columns - 1)] - ahead)
                            fan = math.asin(t / radius) + scan.level_turn[level]
                            view = view_of_angle[i] - fan / view_step
                            cosine_fan = math.sqrt(1.0 - (t / radius) ** 2)
                            depth = radius * cosine_fan + position_x * s - position_y * c
                            magnification = ahead / (cosine_fan * depth)
                            source_z = source_z0 + up + view * source_step
                            bottom = (cz - (nz - 1) * 0.5 * dz - source_z) * magnification + up
                            slope[views] = magnification * dz / row_pitch
                            height[views] = (bottom - first_row) / row_pitch + 1.0
                            for z in range(nz):
                                share = _row_weight(height[views] + slope[views] * np.float32(z), rows, full)
                                shares[views, z] = share
                                total[z] += share
                            at[views] = ((level * angles + i) * (columns + 2) + j) * step
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
                            if rows == 1:  # no interpolation across rows
                                height[i], slope[i] = 1.0, 0.0
                            gather_line(
                                volume, voxel, projections, at[i], at[i] + step, rows + 2, near[i],
                                np.float32(1.0) - near[i], height[i], slope[i], start, stop, shares[i], line, lanes,
                            )  # fmt: skip


@compiled(**OPTIONS)
def back_project_plane(image, projections, sine, cosine, across_0, across_x, across_y, first_y, last_y):
    """Add parallel projections of one slice to rows first_y to last_y - 1 of an image, interpolated linearly.

    Parameters
    ----------
    image : ndarray of float32, shape (y, x)
    projections : ndarray of float32, shape (angles, t)
    sine, cosine : ndarray of float32, shape (angles,)
    across_0, across_x, across_y : float
        Sample of the voxel (0, 0) is across_0 + cosine x0 + sine y0; steps along x and y are in samples.
    """
    columns = image.shape[1]
    last = np.float32(projections.shape[1] - 1.001)
    (start, x_0, y_0), (x_step, y_step) = across_0, (across_x, across_y)
    for y in range(first_y, last_y):
        row = image[y]
        for angle in range(len(sine)):
            values, c = projections[angle], cosine[angle] * x_step
            begin = start + cosine[angle] * x_0 + sine[angle] * (y_0 + np.float32(y) * y_step)
            for x in range(columns):
                across = min(max(begin + np.float32(x) * c, np.float32(0.0)), last)
                j = int(across)
                right = across - np.float32(j)
                row[x] += values[j] * (np.float32(1.0) - right) + values[j + 1] * right
