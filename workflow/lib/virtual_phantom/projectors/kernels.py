"""Numba kernels of the CPU engine: Joseph's forward projection, its exact transpose, and voxel-driven back-projection.

Flat float32 arrays, laid out with one voxel or pixel of zeros around them so that interpolation needs no edge cases:

    volume       [y + 2, x + 2, z + 2, lane]
    projections  [view, column + 2, row + 2, lane]

z and the detector rows run along the same line in space, so for one detector column (or one voxel column) the in-plane
interpolation is common to all of them and the inner loop walks through contiguous memory.

Joseph's method (P. M. Joseph, IEEE Trans. Med. Imaging 1, 192, 1982): step through the planes across the ray's main
direction, interpolate bilinearly in each, scale by the path between planes. The ray's main direction is taken in the
x-y plane, which asks for cone angles under 45 degrees. Voxel-driven back-projection interpolates the projection
bilinearly where the line from the source through the voxel's centre meets the detector. Joseph forward with
voxel-driven back is the pair of ASTRA's 3D algorithms (W. van Aarle et al., Ultramicroscopy 157, 35, 2015).
"""

import math
from collections import namedtuple

import numpy as np
from numba import njit

from .columns import gather_line, scatter_line
from .lanes import OPTIONS

# The volume is walked through in tiles of this many voxel columns along x and y, all views of a call for each: at 16
# lanes and 48 slices a tile is 0.8 MB, so it stays in the L2 cache instead of coming from memory once per view.
# FEW lanes and less have wider tiles.
TILE, FEW, WIDER = 16, 4, 64

# How a kernel takes one line of voxels or pixels after another (columns.py), entry by entry: which pair of lines, and
# the shares of both; the first value's cell along them, and what is added from value to value; the values to take.
Lines = namedtuple("Lines", "pair near weight height slope start stop")


def empty_lines() -> Lines:
    """Room for what a kernel works out at once, for each thread its own."""
    pair, start, stop = np.empty((3, WIDER), np.intp)
    return Lines(pair, *np.empty((4, WIDER), np.float32), start, stop)


@njit(**OPTIONS)
def tile_width(lanes):
    """In voxel columns."""
    return TILE if len(lanes) > FEW else WIDER


@njit(**OPTIONS)
def _ray(view, column, sine, cosine, geometry):
    """In-plane source position, from the grid's centre, and direction to the detector column (all the way to it)."""
    radius, distance, first_column, column_pitch = geometry[0], geometry[1], geometry[2], geometry[3]
    s, c = sine[view], cosine[view]
    along = first_column + column * column_pitch
    return (
        -radius * s - geometry[6],
        radius * c - geometry[7],
        distance * s + along * c,
        -distance * c + along * s,
    )


@njit(**OPTIONS)
def _crossings(start, direction, start_other, direction_other, n, spacing, n_other, spacing_other):
    """Where the ray meets plane 0 and what is added from plane to plane: share of the way to the detector, and padded
    index along the other in-plane axis."""
    share, share_step = ((1 - n) * 0.5 * spacing - start) / direction, spacing / direction
    per_share = direction_other / spacing_other
    other = start_other / spacing_other + share * per_share + (n_other - 1) * 0.5 + 1.0
    return share, share_step, other, share_step * per_share


@njit(inline="always", **OPTIONS)
def span(first, slope, cells, n):
    """Indices i in [0, n) whose position first + slope i lies in [0, cells + 1): those that interpolation can reach."""
    inverse = 1.0 / slope
    start = max(0, int(math.ceil(-first * inverse)))
    stop = min(n, int(math.ceil((cells + 1.0 - first) * inverse)))
    return start, max(start, stop)


@njit(inline="always", **OPTIONS)
def _set_line(lines, k, position, scale, height, slope, cells, n):
    """Entry k: between the two lines around a padded position, n values from cells of which `cells` are not border,
    times `scale`.

    Without branches, so that many are worked out at once.
    """
    below = math.floor(position)
    weight = position - below
    lines.pair[k] = int(below)
    lines.near[k] = np.float32((1.0 - weight) * scale)
    lines.weight[k] = np.float32(weight * scale)
    lines.height[k] = np.float32(height)
    lines.slope[k] = np.float32(slope)
    lines.start[k], lines.stop[k] = span(lines.height[k], lines.slope[k], cells, n)


@njit(**OPTIONS)
def _columns_of_tile(view, x0, x1, y0, y1, shape, spacing, columns, sine, cosine, geometry):
    """Detector columns [first, last) whose rays can meet the padded voxel columns [x0, x1) x [y0, y1)."""
    _, ny, nx = shape
    _, dy, dx = spacing
    radius, distance, first_column, column_pitch = geometry[0], geometry[1], geometry[2], geometry[3]
    low, high = columns, -1
    for x in (x0 - 1, x1):
        for y in (y0 - 1, y1):
            # Padded index i is the voxel i - 1.
            at_x = (x - 1 - (nx - 1) * 0.5) * dx + geometry[6]
            at_y = (y - 1 - (ny - 1) * 0.5) * dy + geometry[7]
            depth = radius + at_x * sine[view] - at_y * cosine[view]
            if depth <= 0:
                return 0, columns
            column = ((at_x * cosine[view] + at_y * sine[view]) * distance / depth - first_column) / column_pitch
            low = min(low, int(math.floor(column)))
            high = max(high, int(math.ceil(column)))
    return max(0, low), min(columns, high + 1)


@njit(**OPTIONS)
def trace(
    volume, projections, first_view, shape, spacing, detector, sine, cosine, source_z, geometry, transpose, lines, lanes
):
    """Joseph projection of every view from `first_view` on, or (transpose) its exact adjoint.

    shape (z, y, x), spacing (z, y, x) mm, detector (views in `projections`, columns, rows), geometry
    (source to isocentre, source to detector, first column, column pitch, first row, row pitch, x and y of the grid's
    centre) mm; source_z from the grid's centre, mm.
    Adds to `projections` what `path_lengths` must then scale; transpose adds to `volume` and needs scaled projections.
    A sample belongs to the tile of the first of the voxel columns that it is interpolated from. `lines`: see Lines.
    """
    _, ny, nx = shape
    width = tile_width(lanes)
    for x0 in range(0, nx + 1, width):
        for y0 in range(0, ny + 1, width):
            tile = (x0, min(x0 + width, nx + 1), y0, min(y0 + width, ny + 1))
            for i in range(detector[0]):
                view = first_view + i
                first, last = _columns_of_tile(view, *tile, shape, spacing, detector[1], sine, cosine, geometry)
                for column in range(first, last):
                    _trace_ray(
                        volume,
                        projections,
                        i,
                        view,
                        column,
                        tile,
                        shape,
                        spacing,
                        detector,
                        sine,
                        cosine,
                        source_z,
                        geometry,
                        transpose,
                        lines,
                        lanes,
                    )


@njit(inline="always", **OPTIONS)
def _trace_ray(
    volume,
    projections,
    i,
    view,
    column,
    tile,
    shape,
    spacing,
    detector,
    sine,
    cosine,
    source_z,
    geometry,
    transpose,
    lines,
    lanes,
):
    """The part of one detector column's rays, all rows, that lies in a tile."""
    count = len(lanes)
    nz, ny, nx = shape
    dz, dy, dx = spacing
    _, columns, rows = detector
    sx, sy, rx, ry = _ray(view, column, sine, cosine, geometry)
    pixel = ((i * (columns + 2) + column + 1) * (rows + 2) + 1) * count
    step_x, step_y = (nz + 2) * count, (nx + 2) * (nz + 2) * count
    # In slices.
    row_pitch, first_row, middle = geometry[5] / dz, geometry[4] / dz, source_z[view] / dz + (nz - 1) * 0.5 + 1.0
    if abs(rx) >= abs(ry):
        first_plane, last_plane, first_other, last_other = tile[0], tile[1], tile[2], tile[3]
        n, step, step_other = nx, step_x, step_y
        share0, share_step, other0, other_step = _crossings(sx, rx, sy, ry, nx, dx, ny, dy)
    else:
        first_plane, last_plane, first_other, last_other = tile[2], tile[3], tile[0], tile[1]
        n, step, step_other = ny, step_y, step_x
        share0, share_step, other0, other_step = _crossings(sy, ry, sx, rx, ny, dy, nx, dx)
    first_plane, last_plane = max(first_plane - 1, 0), min(last_plane - 1, n)
    # Most planes that the ray meets in other tiles are left out here, one by one those that remain.
    if abs(other_step) > 1e-6:
        one, another = (first_other - other0) / other_step, (last_other - other0) / other_step
        first_plane = max(first_plane, int(math.floor(min(one, another))))
        last_plane = min(last_plane, int(math.ceil(max(one, another))) + 1)
    for k in range(last_plane - first_plane):
        plane = np.float64(first_plane + k)
        share = share0 + share_step * plane
        _set_line(
            lines, k, other0 + other_step * plane, 1.0, middle + share * first_row, share * row_pitch, nz, rows
        )  # fmt: skip
    for k in range(last_plane - first_plane):
        if lines.pair[k] < first_other or lines.pair[k] >= last_other:
            continue
        base = (first_plane + k + 1) * step + lines.pair[k] * step_other
        if transpose:
            scatter_line(
                volume, base, base + step_other, projections, pixel, nz + 2, lines.near[k], lines.weight[k],
                lines.height[k], lines.slope[k], lines.start[k], lines.stop[k], lanes,
            )  # fmt: skip
        else:
            gather_line(
                projections, pixel, volume, base, base + step_other, nz + 2, lines.near[k], lines.weight[k],
                lines.height[k], lines.slope[k], lines.start[k], lines.stop[k], None, lanes,
            )  # fmt: skip


@njit(**OPTIONS)
def path_lengths(projections, first_view, spacing, detector, sine, cosine, geometry, lanes):
    """Multiply each pixel by the length of its ray between two planes, mm: the last factor of Joseph's sum."""
    count = len(lanes)
    views, columns, rows = detector
    for i in range(views):
        for column in range(columns):
            _, _, rx, ry = _ray(first_view + i, column, sine, cosine, geometry)
            per_length = spacing[2] / abs(rx) if abs(rx) >= abs(ry) else spacing[1] / abs(ry)
            pixel = ((i * (columns + 2) + column + 1) * (rows + 2) + 1) * count
            for row in range(rows):
                rz = geometry[4] + row * geometry[5]
                length = np.float32(per_length * math.sqrt(rx * rx + ry * ry + rz * rz))
                for lane in range(count):
                    projections[pixel + row * count + lane] *= length


@njit(**OPTIONS)
def back_project(
    volume,
    projections,
    first_view,
    first_y,
    last_y,
    shape,
    spacing,
    detector,
    sine,
    cosine,
    source_z,
    geometry,
    lines,
    lanes,
):
    """Add the voxel-driven back-projection of some views to rows first_y to last_y - 1 of the volume.

    Each view counts by (source to isocentre / depth)^2: the weight of FDK, and how densely rays lie, which the
    transpose of a forward projection has by itself. ASTRA's BP3D_CUDA does the same, but for a constant
    (github.com/astra-toolbox/astra-toolbox/issues/594).
    """
    count = len(lanes)
    nz, ny, nx = shape
    dz, dy, dx = spacing
    views, columns, rows = detector
    radius, distance, first_column, column_pitch, first_row, row_pitch, centre_x, centre_y = geometry
    step = (rows + 2) * count
    # In pixels: what lies 1 mm off at a depth of 1 mm, and where the detector's zero is.
    across_pitch, across_middle = distance / column_pitch, 1.0 - first_column / column_pitch
    up_pitch, up_middle = distance / row_pitch, 1.0 - first_row / row_pitch
    width = tile_width(lanes)
    for y0 in range(first_y, last_y, width):
        for x0 in range(0, nx, width):
            for i in range(views):
                view = first_view + i
                s, c = sine[view], cosine[view]
                lowest = -(nz - 1) * 0.5 * dz - source_z[view]
                for y in range(y0, min(y0 + width, last_y)):
                    position_y = (y - (ny - 1) * 0.5) * dy + centre_y
                    for k in range(min(width, nx - x0)):
                        position_x = (x0 + k - (nx - 1) * 0.5) * dx + centre_x
                        closer = 1.0 / (radius + position_x * s - position_y * c)
                        _set_line(
                            lines,
                            k,
                            (position_x * c + position_y * s) * closer * across_pitch + across_middle,
                            (radius * closer) ** 2,
                            lowest * closer * up_pitch + up_middle,
                            dz * closer * up_pitch,
                            rows,
                            nz,
                        )
                    for k in range(min(width, nx - x0)):
                        if lines.pair[k] < 0 or lines.pair[k] > columns:
                            continue
                        voxel = (((y + 1) * (nx + 2) + x0 + k + 1) * (nz + 2) + 1) * count
                        base = (i * (columns + 2) + lines.pair[k]) * step
                        gather_line(
                            volume, voxel, projections, base, base + step, rows + 2, lines.near[k], lines.weight[k],
                            lines.height[k], lines.slope[k], lines.start[k], lines.stop[k], None, lanes,
                        )  # fmt: skip
