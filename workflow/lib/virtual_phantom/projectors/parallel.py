"""Numba kernels of weighted filtered back-projection: rebinning to parallel rays, and from these onto the volume.

Layout and interpolation are as in kernels.py, with angles for views and distances t for columns.
"""

import math
from collections import namedtuple
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numba import uintp

from ..base.compiled import compiled
from ..base.parallel_rays import ParallelRays
from .columns import gather_line
from .kernels import WIDER, span, tile_width
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


# Samples that are interpolated at a time. Neighboring angles read the same pixels, which then are in the cache.
SAMPLES_AT_ONCE = 1 << 19


def rebin(rays: ParallelRays, stack: np.ndarray) -> Iterator[np.ndarray]:
    """Weight projections by the cosine of the cone angle, and interpolate them linearly to parallel rays.

    Parameters
    ----------
    stack : ndarray of float32, shape (views, rows, columns)

    Yields
    ------
    ndarray of float32, shape (angles, rows, t)
        Projections of the next angles, level after level; 0 where unknown.
    """
    cosine = rays.cone_cosine
    for samples in rays.interleaved:
        columns, shares = np.stack(samples.column).astype(np.uint32), (1 - samples.right_share, samples.right_share)
        weights = np.empty((2, rays.geometry.rows, columns.shape[1]), np.float32)
        for sample, (spot, column) in enumerate(zip(samples.spot, samples.column, strict=True)):
            weights[sample] = np.where(samples.known, shares[sample] * cosine[spot, :, column].T, 0)
        together = max(1, SAMPLES_AT_ONCE // weights[0].size)
        for first in range(0, len(rays.view_of_angle), together):
            central = rays.view_of_angle[first : first + together, None]
            views = np.empty((2, 2, len(central), columns.shape[1]), np.uint32)
            later_share = np.empty(views.shape[1:], np.float32)
            for sample, (spot, fan) in enumerate(zip(samples.spot, samples.fan_rad, strict=True)):
                about = rays.views_about(spot, central - fan / rays.view_step)
                views[0, sample], views[1, sample], later_share[sample] = about
            images = np.empty((len(central), *weights.shape[1:]), np.float32)
            _interpolate(images, stack, views, later_share, columns, weights)
            yield images


@compiled(**OPTIONS)
def _interpolate(images, stack, views, later_share, columns, weights):
    """Set images [angle, row, t] to the sum of two samples, each interpolated between two views.

    Parameters
    ----------
    views : ndarray of uint32, shape (2, samples, angles, t)
        Views before and after.
    later_share : ndarray of float32, shape (samples, angles, t)
    columns : ndarray of uint32, shape (samples, t)
    weights : ndarray of float32, shape (samples, rows, t)
    """
    angles, rows, width = images.shape
    before, after = views
    for row in range(rows):
        for angle in range(angles):
            for k in range(uintp(width)):
                total = np.float32(0.0)
                for sample in range(2):
                    column = columns[sample, k]
                    early = stack[before[sample, angle, k], row, column]
                    late = stack[after[sample, angle, k], row, column]
                    total += weights[sample, row, k] * (early + later_share[sample, angle, k] * (late - early))
                images[angle, row, k] = total


# Work arrays of one thread, for the views of one direction and a row of voxel columns.
# - total: sum of row weights, (z,); shares: row weight of each view, (view, z); image: level and angle of each view
# - pair, near, height, slope: arguments of gather_line (columns.py), (view, column), `pair` as the number of the line
# - start, stop: range of slices that a view sees, (view, column)
# - inside, ahead: values of one view, (column,); see `_set_lines`
Workspace = namedtuple("Workspace", "total shares image pair near height slope start stop inside ahead")


def empty_workspace(slices: int, views: int) -> Workspace:
    """Return work arrays of one thread."""
    near, height, slope = np.empty((3, views, WIDER), np.float32)
    pair, start, stop = np.empty((3, views, WIDER), np.int32)
    total, shares, image = np.empty(slices, np.float32), np.empty((views, slices), np.float32), np.empty(views, np.intp)
    return Workspace(
        total, shares, image, pair, near, height, slope, start, stop, np.empty(WIDER, np.bool_), np.empty(WIDER)
    )


@compiled(inline="always", **OPTIONS)
def _arcsine(sine):
    """Return the arcsine with a relative error below 3e-7, without branches or a call, so that a loop vectorizes.

    Polynomial of `asinf` in Moshier's Cephes library (1992).
    """
    size = abs(sine)
    large = size > 0.5
    square = (1.0 - size) * 0.5 if large else size * size
    root = math.sqrt(square) if large else size
    series = 0.042163199048 * square + 0.024181311049
    series = ((series * square + 0.045470025998) * square + 0.074953002686) * square + 0.16666752422
    angle = root + root * square * series
    angle = 0.5 * math.pi - 2.0 * angle if large else angle
    return angle if sine >= 0.0 else -angle


@compiled(inline="always", **OPTIONS)
def _set_lines(workspace, view, count, level, angle, first_x, position_y, scan):
    """Set row `view` of the workspace: the arguments of gather_line for `count` voxel columns.

    The loop in the middle looks up lengths. The others have neither look-ups nor branches, so that they vectorize.
    """
    inside, ahead = workspace.inside, workspace.ahead
    pair, near, start, stop = workspace.pair[view], workspace.near[view], workspace.start[view], workspace.stop[view]
    height, slope = workspace.height[view], workspace.slope[view]
    nz, _, nx = scan.shape
    dz, _, dx = scan.spacing
    cz, _, cx = scan.centre
    sine, cosine, columns = scan.sine[angle], scan.cosine[angle], np.float64(scan.columns)
    radius, up, turn = scan.level_radius[level], scan.level_z[level], scan.level_turn[level]
    lengths = scan.level_ahead[level]
    rows_per_mm, per_mm, per_radius = 1.0 / scan.row_pitch, 1.0 / scan.t_pitch, 1.0 / radius
    rise = scan.source_step / scan.view_step
    # Weights are above zero between the centers of the outermost rows; for a single row, in the whole row.
    seen_rows = np.float64(max(scan.rows - 1, 1))
    lowest = (scan.rows + 1 - seen_rows) * 0.5
    left = (first_x - (nx - 1) * 0.5) * dx + cx
    left_t = left * cosine + position_y * sine
    left_depth = left * sine - position_y * cosine
    bottom = cz - (nz - 1) * 0.5 * dz - (scan.source_z + up + scan.view_of_angle[angle] * scan.source_step)
    for k in range(count):
        t = left_t + np.float64(np.int32(k)) * dx * cosine
        across = (t - scan.first_t) * per_mm + 1.0
        inside[k] = (across >= 1.0) & (across <= columns) & (abs(t) < radius)
        across = min(max(across, 1.0), columns)
        pair[k] = np.int32(across)
        near[k] = np.float32(1.0 - (across - np.float64(pair[k])))
    for k in range(count):
        own, following = pair[k] - 1, min(pair[k], scan.columns - 1)
        ahead[k] = lengths[following] + near[k] * (lengths[own] - lengths[following])
    for k in range(count):
        x = np.float64(np.int32(k)) * dx
        fan_sine = min(max((left_t + x * cosine) * per_radius, -1.0), 1.0)
        fan_cosine = math.sqrt(1.0 - fan_sine * fan_sine)
        depth = radius * fan_cosine + left_depth + x * sine
        rows_per_height = ahead[k] / (fan_cosine * depth) * rows_per_mm
        # The view of a ray precedes that of the central ray of its angle.
        above = bottom + (_arcsine(fan_sine) + turn) * rise
        at_bottom = above * rows_per_height + (up - scan.first_row) * rows_per_mm + 1.0
        begin, end = span(at_bottom - lowest, rows_per_height * dz, seen_rows - 1.0, nz)
        height[k] = np.float32(at_bottom)
        slope[k] = np.float32(rows_per_height * dz)
        start[k] = begin if inside[k] else 0
        stop[k] = end if inside[k] else 0


@compiled(**OPTIONS)
def back_project_parallel(volumes, seen, projections, first_y, last_y, scan, workspace, line, lanes):
    """Add parallel-rebinned projections to rows first_y to last_y - 1 of volumes, one for each filter.

    Each direction of rays contributes once to a voxel. Views of one direction, half turns apart, are averaged with
    their row weights.

    Parameters
    ----------
    volumes : ndarray of float32, shape (filters, voxels x lanes)
        Layout as in kernels.py.
    seen : ndarray of float32, shape (y, x, z)
        Number of directions that contributed; added to.
    projections : ndarray of float32, shape (filters, samples)
        Each [level, angle, t + 2, row + 2, lane].
    workspace : Workspace
        Work arrays of `empty_workspace`.
    line : Line or None
        See `gather_line`.
    lanes : tuple
        One item per realization.
    """
    count = len(lanes)
    nz, ny, nx = scan.shape
    rows, half_turn, full, angles, levels = scan.rows, scan.half_turn, scan.full, len(scan.sine), len(scan.level_z)
    total, shares, image, pair, near, height, slope, start, stop = workspace[:9]
    step = (rows + 2) * count
    width = tile_width(lanes)
    for y0 in range(first_y, last_y, width):
        for x0 in range(0, nx, width):
            across = min(width, nx - x0)
            for direction in range(half_turn):
                for y in range(y0, min(y0 + width, last_y)):
                    position_y = (y - (ny - 1) * 0.5) * scan.spacing[1] + scan.centre[1]
                    views = 0
                    for level in range(levels):
                        for angle in range(direction, angles, half_turn):
                            _set_lines(workspace, views, across, level, angle, x0, position_y, scan)
                            image[views] = level * angles + angle
                            views += 1
                    for k in range(across):
                        total[:] = 0
                        for i in range(views):
                            bottom, by_slice, own = height[i, k], slope[i, k], shares[i]
                            for z in range(uintp(start[i, k]), uintp(stop[i, k])):
                                own[z] = _row_weight(bottom + by_slice * np.float32(np.int32(z)), rows, full)
                                total[z] += own[z]
                        for z in range(nz):
                            if total[z] > np.float32(0.0):
                                seen[y, x0 + k, z] += np.float32(1.0)
                                total[z] = np.float32(1.0) / total[z]
                        voxel = (((y + 1) * (nx + 2) + x0 + k + 1) * (nz + 2) + 1) * count
                        for i in range(views):
                            bottom, by_slice, own = height[i, k], slope[i, k], shares[i]
                            for z in range(uintp(start[i, k]), uintp(stop[i, k])):
                                own[z] *= total[z]
                            if rows == 1:  # no interpolation across rows
                                bottom, by_slice = np.float32(1.0), np.float32(0.0)
                            at = (image[i] * (scan.columns + 2) + pair[i, k]) * step
                            for one in range(len(volumes)):
                                gather_line(
                                    volumes[one], voxel, projections[one], at, at + step, rows + 2,
                                    near[i, k], np.float32(1.0) - near[i, k], bottom, by_slice,
                                    start[i, k], stop[i, k], own, line, lanes,
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
