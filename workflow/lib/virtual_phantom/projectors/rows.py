"""Joseph's sums for bundles of many rows, and their derivatives: all rows of a bundle at once.

In each plane the two lines of voxels next to the bundle's shadow (joseph.py) are interpolated once, and rows look up
their values in the result. The lookup uses x86 instructions (x86.py) if the processor has them, otherwise loops. Rows
may have any heights, in ascending order. Single rays use any_rays.py instead.
"""

import math

import numpy as np
from numba import uintp

from ..base.compiled import compiled
from .joseph import Bundles, bundle_shadow, cross, planes_between
from .lanes import OPTIONS
from .processors import ANY, PROCESSOR
from .x86 import WIDTH, add_rows

USE_X86 = PROCESSOR != ANY
BORDER = 3  # padding of a line: one cell below, two above
BEYOND = 2 * WIDTH  # the x86 code reads beyond the end of a line
MOST_CELLS = 2 * WIDTH - 3  # span of the rows of one register, which look up in two registers
TILE_BYTES = 800_000  # part of the volume that stays in the L2 cache


def packed(amounts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Convert volumes, shape (lanes, z, y, x), to the layout of `trace_rows`.

    Returns
    -------
    volume : ndarray of float32, flat
        [y + 2, x + 2, lane, z + BORDER].
    occupied : ndarray of bool, flat
        Whether a line has a nonzero voxel, [y + 2, x + 2, lane].
    """
    lanes, nz, ny, nx = amounts.shape
    shape = (ny + 2, nx + 2, lanes, nz + BORDER)
    flat = np.zeros(math.prod(shape) + BEYOND, np.float32)
    volume, occupied = flat[: math.prod(shape)].reshape(shape), np.zeros(shape[:3], bool)
    for y in range(ny):  # planes that fit into the cache: four times as fast as all at once
        plane = amounts[:, :, y].transpose(2, 0, 1)
        volume[y + 1, 1:-1, :, 1 : nz + 1] = plane
        occupied[y + 1, 1:-1] = (plane != 0).any(axis=2)
    return flat, occupied.ravel()


def distribute_rows(rays: Bundles, shape: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Distribute rows over registers. A register holds as many rows as it can look up, and then repeats the last one.

    Returns
    -------
    heights : ndarray of float32, shape (padded rows,)
        rows_mm of the padded rows.
    place : ndarray of int, shape (rows,)
        Index of each row among them.
    """
    rows, climb = rays.rows_mm, np.abs(rays.climb)
    steepest = float((climb[..., 0] + climb[..., 1] * max(shape[1:]) / 2).max())
    together = min(WIDTH, rows.size)
    while together > 1 and steepest * (rows[together - 1 :] - rows[: rows.size - together + 1]).max() > MOST_CELLS:
        together -= 1
    first = np.arange(0, rows.size, together)[:, None]
    taken = np.minimum(first + np.minimum(np.arange(WIDTH), together - 1), rows.size - 1)
    number = np.arange(rows.size)
    return rows[taken.ravel()].astype(np.float32), number // together * WIDTH + number % together


def tile_width(lanes: int, shape: tuple[int, int, int]) -> int:
    """Return the width of a tile in voxel columns along x and y."""
    return max(8, int(math.sqrt(TILE_BYTES / (4 * lanes * (shape[0] + BORDER)))))


def empty_lines(shape: tuple[int, int, int]) -> np.ndarray:
    """Return work arrays of one thread."""
    return np.zeros((2, shape[0] + BORDER), np.float32)


@compiled(**OPTIONS)
def trace_rows(volume, occupied, sums, slopes, first_view, shape, rays, heights, width, workspace):
    """Add the sums of interpolated values along all rays, and their derivatives.

    A sample belongs to the tile of the first voxel column that it is interpolated from.

    Parameters
    ----------
    volume, occupied : ndarray
        Result of `packed`.
    sums : ndarray of float32, shape (views, bundles, lanes, padded rows)
        Output, added to.
    slopes : ndarray of float32, shape (views, bundles, lanes, 4, padded rows), or None
        Output, added to; coordinates in the order a, c, b, d.
    first_view : int
        Number of the view, among those of the rays, that is the first of `sums`.
    shape : tuple of 3 int
        (z, y, x) of the grid without padding.
    heights : ndarray of float32, shape (padded rows,)
        Result of `distribute_rows`.
    width : int
        Width of a tile.
    workspace : ndarray
        Work arrays of `empty_lines`.
    """
    views, bundles = sums.shape[:2]
    for first_y in range(0, shape[1] + 1, width):
        for first_x in range(0, shape[2] + 1, width):
            for i in range(views):
                for bundle in range(bundles):
                    _trace_bundle(
                        volume, occupied, sums, slopes, i, first_view + i, bundle, shape, rays, heights,
                        first_x, first_y, width, workspace,
                    )  # fmt: skip


@compiled(inline="always", **OPTIONS)
def _trace_bundle(
    volume, occupied, sums, slopes, i, view, bundle, shape, rays, heights, first_x, first_y, width, workspace
):
    """Do the work of trace_rows for one bundle in one tile."""
    nz = shape[0]
    lanes, rows = sums.shape[2], sums.shape[3]
    top, length = np.float32(nz + 1), nz + BORDER
    along_x = rays.along_x[view, bundle]
    shadow = bundle_shadow(rays, view, bundle, shape)
    # Plane numbers exclude padding, voxel columns include it.
    low, low_other = (first_x - 1, first_y) if along_x else (first_y - 1, first_x)
    high_other = min(low_other + width, shadow.cells + 1)
    start, stop = planes_between(shadow, low_other, high_other)
    lift, level = rays.lift_mm[view, bundle], rays.level[view]
    climb, climbing = rays.climb[view, bundle, 0], rays.climb[view, bundle, 1]
    for plane in range(max(start, low), min(stop, low + width)):
        number, cell, share = cross(shadow, plane)
        if cell < low_other or cell >= high_other:
            continue
        near = ((plane + 1) * shadow.step + cell * shadow.step_other) * lanes
        far = near + shadow.step_other * lanes
        rise = climb + climbing * number
        lowest, slope = np.float32(level + rise * lift), np.float32(rise)
        if lowest + slope * heights[0] >= top or lowest + slope * heights[rows - 1] < np.float32(0.0):
            continue
        weight, t = np.float32(share), np.float32(number)
        for lane in range(lanes):
            if not (occupied[near + lane] or occupied[far + lane]):
                continue
            one, another = (near + lane) * length, (far + lane) * length
            if USE_X86:
                at = ((i * sums.shape[1] + bundle) * lanes + lane) * rows
                for row in range(0, rows, WIDTH):
                    add_rows(
                        sums, slopes, at, row, rows, volume, one, another, weight, t, heights, lowest, slope, top,
                    )  # fmt: skip
            else:
                _by_loops(
                    sums[i, bundle, lane], None if slopes is None else slopes[i, bundle, lane],
                    volume, one, another, weight, t, heights, lowest, slope, top, workspace,
                )  # fmt: skip


@compiled(inline="always", **OPTIONS)
def _by_loops(sums, slopes, volume, one, another, weight, t, heights, lowest, slope, top, workspace):
    """Do the work of trace_rows for one lane in one plane."""
    rows = len(heights)
    line, step = workspace[0], workspace[1]
    first = uintp(max(lowest + slope * heights[0], np.float32(0.0)))
    last = uintp(min(lowest + slope * heights[rows - 1], top)) + uintp(2)
    for k in range(first, min(last, uintp(len(line)))):
        low = volume[uintp(one) + k]
        step[k] = volume[uintp(another) + k] - low
        line[k] = low + weight * step[k]
    for row in range(rows):
        z = lowest + slope * heights[row]
        if z >= np.float32(0.0) and z < top:
            k = uintp(np.int32(z))
            up = z - np.float32(np.int32(z))
            low, high = line[k], line[k + uintp(1)]
            sums[row] += low + up * (high - low)
            if slopes is not None:
                by_other, by_z = step[k] + up * (step[k + uintp(1)] - step[k]), high - low
                slopes[0, row] += by_other
                slopes[1, row] += by_z
                slopes[2, row] += t * by_other
                slopes[3, row] += t * by_z
