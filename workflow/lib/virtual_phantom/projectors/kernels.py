"""Numba kernels of the CPU engine: Joseph's forward projection, its exact transpose, and voxel-driven back-projection.

Flat float32 arrays, laid out with one voxel or pixel of zeros around them so that interpolation needs no edge cases::

    volume       [y + 2, x + 2, z + 2, lane]
    projections  [view, column + 2, row + 2, lane]

z and the detector rows run along the same line in space (vectors.Upright), so for one detector column (or one voxel
column) the in-plane interpolation is common to all of them and the inner loop walks through contiguous memory.

Joseph's method [1]_: step through the planes across the ray's main direction, interpolate bilinearly in each, scale by
the path between planes. The ray's main direction is taken in the x-y plane, which asks for cone angles under 45
degrees. Voxel-driven back-projection interpolates the projection bilinearly where the line from the source through the
voxel's centre meets the detector. Joseph forward with voxel-driven back is the pair of ASTRA's 3D algorithms [2]_.

References
----------
.. [1] P. M. Joseph, IEEE Trans. Med. Imaging 1, 192, 1982.
.. [2] W. van Aarle et al., Ultramicroscopy 157, 35, 2015.
"""

import math
from collections import namedtuple
from typing import NamedTuple

import numpy as np

from ..base.compiled import compiled
from .columns import empty_line, gather_line, scatter_line
from .lanes import OPTIONS

# The volume is walked through in tiles of this many voxel columns along x and y, all views of a call for each: at 16
# lanes and 48 slices a tile is 0.8 MB, so it stays in the L2 cache instead of coming from memory once per view.
# FEW lanes and less have wider tiles.
TILE, FEW, WIDER = 16, 4, 64

# How a kernel takes one line of voxels or pixels after another (columns.py), entry by entry: which pair of lines, and
# the shares of both; the first value's cell along them, and what is added from value to value; the values to take.
# Last, room for one.
Lines = namedtuple("Lines", "pair near weight height slope start stop one")


class Scan(NamedTuple):
    """Grid and scan as the kernels take them. Arrays have shape (views,).

    Attributes
    ----------
    shape : tuple of 3 int
        Of the grid, (z, y, x).
    spacing : tuple of 3 float
        Of the grid, (z, y, x), mm.
    columns, rows : int
        Of the detector.
    column_pitch, row_pitch : float
        Of the detector, mm.
    across, nearer : ndarray, shape (columns,)
        Where columns are: from column 0 along the column direction, and from the plane through the detector's reference
        point towards the source, mm.
    arc : float
        Radius of a cylindrical detector, mm; 0 of a flat one.
    first_angle : float
        Of column 0 about the focus of the arc, radians.
    cosine, sine, distance, first_column, first_row : ndarray
        As vectors.Upright has them.
    depth, beside, source_z : ndarray
        The same, but from the grid's centre.
    radius : ndarray
        Depth of the isocentre, mm: what back-projected views are weighed by.
    """

    shape: tuple[int, int, int]
    spacing: tuple[float, float, float]
    columns: int
    rows: int
    column_pitch: float
    row_pitch: float
    across: np.ndarray
    nearer: np.ndarray
    arc: float
    first_angle: float
    cosine: np.ndarray
    sine: np.ndarray
    depth: np.ndarray
    beside: np.ndarray
    radius: np.ndarray
    distance: np.ndarray
    first_column: np.ndarray
    source_z: np.ndarray
    first_row: np.ndarray


def empty_lines(scan: Scan) -> Lines:
    """Room for what a kernel works out at once, for each thread its own."""
    pair, start, stop = np.empty((3, WIDER), np.int32)
    return Lines(pair, *np.empty((4, WIDER), np.float32), start, stop, empty_line(max(scan.rows, scan.shape[0])))


@compiled(**OPTIONS)
def tile_width(lanes):
    """In voxel columns."""
    return TILE if len(lanes) > FEW else WIDER


@compiled(**OPTIONS)
def _ray(view, column, scan):
    """In-plane source position, from the grid's centre, and direction to the detector column (all the way to it)."""
    s, c = scan.sine[view], scan.cosine[view]
    depth, beside, distance = scan.depth[view], scan.beside[view], scan.distance[view] - scan.nearer[column]
    along = scan.first_column[view] + scan.across[column]
    return (
        beside * c - depth * s,
        beside * s + depth * c,
        distance * s + along * c,
        -distance * c + along * s,
    )


@compiled(**OPTIONS)
def _crossings(start, direction, start_other, direction_other, n, spacing, n_other, spacing_other):
    """Where the ray meets plane 0 and what is added from plane to plane.

    Returns
    -------
    share, share_step : float
        Share of the way to the detector.
    other, other_step : float
        Padded index along the other in-plane axis.
    """
    share, share_step = ((1 - n) * 0.5 * spacing - start) / direction, spacing / direction
    per_share = direction_other / spacing_other
    other = start_other / spacing_other + share * per_share + (n_other - 1) * 0.5 + 1.0
    return share, share_step, other, share_step * per_share


@compiled(inline="always", **OPTIONS)
def _from_zero(position, n):
    """The first of the whole numbers from 0 to n that is not below a position; n beyond.

    Of 32 bits and without `ceil`, as some processors have no vectors of either 64 bits or `ceil`.

    Returns
    -------
    int32
    """
    within = min(max(position, 0.0), np.float64(n))
    below = np.int32(within)
    return np.int32(below + np.int32(within > np.float64(below)))


@compiled(inline="always", **OPTIONS)
def span(first, slope, cells, n):
    """Indices i in [0, n) whose position first + slope i lies in [0, cells + 1): those that interpolation can reach."""
    inverse = 1.0 / slope
    start = _from_zero(-first * inverse, n)
    return start, max(start, _from_zero((cells + 1.0 - first) * inverse, n))


@compiled(inline="always", **OPTIONS)
def _set_line(lines, k, position, scale, height, slope, cells, n):
    """Set entry k: n values between the two lines around a padded position, times `scale`.

    They come from cells of which `cells` are not border. Without branches, so that many are worked out at once.
    """
    below = np.int32(position)
    below = np.int32(below - np.int32(np.float64(below) > position))
    weight = position - np.float64(below)
    lines.pair[k] = below
    lines.near[k] = np.float32((1.0 - weight) * scale)
    lines.weight[k] = np.float32(weight * scale)
    lines.height[k] = np.float32(height)
    lines.slope[k] = np.float32(slope)
    lines.start[k], lines.stop[k] = span(lines.height[k], lines.slope[k], cells, n)


@compiled(inline="always", **OPTIONS)
def _on_arc(along, depth, view, scan):
    """Where a ray meets a cylindrical detector, by its in-plane direction along the columns and away from the source.

    Returns
    -------
    reach : float
        How many times as far as the direction is long.
    """
    # The source, seen from the focus.
    beside = scan.arc * math.sin(scan.first_angle) - scan.first_column[view]
    ahead = scan.arc - scan.distance[view]
    square, half = along * along + depth * depth, beside * along + ahead * depth
    left = beside * beside + ahead * ahead - scan.arc * scan.arc
    reach = (math.sqrt(half * half - square * left) - half) / square
    angle = math.atan2(beside + reach * along, ahead + reach * depth)
    return reach, (angle - scan.first_angle) * scan.arc / scan.column_pitch


@compiled(**OPTIONS)
def _columns_of_tile(view, x0, x1, y0, y1, scan):
    """Detector columns [first, last) whose rays can meet the padded voxel columns [x0, x1) x [y0, y1)."""
    _, ny, nx = scan.shape
    _, dy, dx = scan.spacing
    columns, s, c = scan.columns, scan.sine[view], scan.cosine[view]
    low, high = columns, -1
    for x in (x0 - 1, x1):
        for y in (y0 - 1, y1):
            # Padded index i is the voxel i - 1.
            at_x = (x - 1 - (nx - 1) * 0.5) * dx
            at_y = (y - 1 - (ny - 1) * 0.5) * dy
            depth = scan.depth[view] + at_x * s - at_y * c
            if depth <= 0:
                return 0, columns
            along = at_x * c + at_y * s - scan.beside[view]
            if scan.arc > 0:
                _, column = _on_arc(along, depth, view, scan)
            else:
                along = along * scan.distance[view] / depth
                column = (along - scan.first_column[view]) / scan.column_pitch
            low = min(low, int(math.floor(column)))
            high = max(high, int(math.ceil(column)))
    return max(0, low), min(columns, high + 1)


@compiled(**OPTIONS)
def trace(volume, projections, first_view, views, scan, transpose, lines, lanes):
    """Joseph projection of some views, or its exact adjoint.

    A sample belongs to the tile of the first of the voxel columns that it is interpolated from.

    Parameters
    ----------
    volume, projections : ndarray of float32, flat
        Laid out as the module's docstring says. Projection adds to `projections` what `path_lengths` must then scale;
        the adjoint adds to `volume` and needs scaled projections.
    first_view, views : int
        The first of the views that `projections` hold, and their number.
    transpose : bool
        True: the adjoint.
    lines : Lines
        Room, of `empty_lines`.
    lanes : tuple
        As long as there are realisations.
    """
    _, ny, nx = scan.shape
    width = tile_width(lanes)
    for x0 in range(0, nx + 1, width):
        for y0 in range(0, ny + 1, width):
            tile = (x0, min(x0 + width, nx + 1), y0, min(y0 + width, ny + 1))
            for i in range(views):
                first, last = _columns_of_tile(first_view + i, *tile, scan)
                for column in range(first, last):
                    _trace_ray(volume, projections, i, first_view + i, column, tile, scan, transpose, lines, lanes)


@compiled(inline="always", **OPTIONS)
def _trace_ray(volume, projections, i, view, column, tile, scan, transpose, lines, lanes):
    """The part of one detector column's rays, all rows, that lies in a tile."""
    count = len(lanes)
    nz, ny, nx = scan.shape
    dz, dy, dx = scan.spacing
    columns, rows = scan.columns, scan.rows
    sx, sy, rx, ry = _ray(view, column, scan)
    pixel = ((i * (columns + 2) + column + 1) * (rows + 2) + 1) * count
    step_x, step_y = (nz + 2) * count, (nx + 2) * (nz + 2) * count
    # In slices.
    row_pitch, first_row = scan.row_pitch / dz, scan.first_row[view] / dz
    middle = scan.source_z[view] / dz + (nz - 1) * 0.5 + 1.0
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
        plane = np.float64(np.int32(first_plane + k))
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
                lines.height[k], lines.slope[k], lines.start[k], lines.stop[k], lines.one, lanes,
            )  # fmt: skip
        else:
            gather_line(
                projections, pixel, volume, base, base + step_other, nz + 2, lines.near[k], lines.weight[k],
                lines.height[k], lines.slope[k], lines.start[k], lines.stop[k], None, lines.one, lanes,
            )  # fmt: skip


@compiled(**OPTIONS)
def path_lengths(projections, first_view, views, scan, lanes):
    """Multiply each pixel by the length of its ray between two planes, mm: the last factor of Joseph's sum."""
    count = len(lanes)
    columns, rows = scan.columns, scan.rows
    for i in range(views):
        first_row = scan.first_row[first_view + i]
        for column in range(columns):
            _, _, rx, ry = _ray(first_view + i, column, scan)
            per_length = scan.spacing[2] / abs(rx) if abs(rx) >= abs(ry) else scan.spacing[1] / abs(ry)
            pixel = ((i * (columns + 2) + column + 1) * (rows + 2) + 1) * count
            for row in range(rows):
                rz = first_row + row * scan.row_pitch
                length = np.float32(per_length * math.sqrt(rx * rx + ry * ry + rz * rz))
                for lane in range(count):
                    projections[pixel + row * count + lane] *= length


@compiled(**OPTIONS)
def back_project(volume, projections, first_view, views, first_y, last_y, scan, lines, lanes):
    """Add the voxel-driven back-projection of some views to rows first_y to last_y - 1 of the volume.

    Each view counts by (source to isocentre / depth)^2: the weight of FDK, and how densely rays lie, which the
    transpose of a forward projection has by itself. In place of the depth, an arc takes the in-plane distance from the
    source. ASTRA's BP3D_CUDA does the same, but for a constant (github.com/astra-toolbox/astra-toolbox/issues/594).
    Arguments are those of `trace`.
    """
    count = len(lanes)
    nz, ny, nx = scan.shape
    dz, dy, dx = scan.spacing
    columns, rows = scan.columns, scan.rows
    step = (rows + 2) * count
    width = tile_width(lanes)
    for y0 in range(first_y, last_y, width):
        for x0 in range(0, nx, width):
            for i in range(views):
                view = first_view + i
                s, c = scan.sine[view], scan.cosine[view]
                depth, beside, radius = scan.depth[view], scan.beside[view], scan.radius[view]
                # In pixels: what lies 1 mm off at a depth of 1 mm, and where the detector's zero is.
                across_pitch = scan.distance[view] / scan.column_pitch
                across_middle = 1.0 - scan.first_column[view] / scan.column_pitch
                up_pitch = scan.distance[view] / scan.row_pitch
                up_middle = 1.0 - scan.first_row[view] / scan.row_pitch
                lowest = -(nz - 1) * 0.5 * dz - scan.source_z[view]
                for y in range(y0, min(y0 + width, last_y)):
                    position_y = (y - (ny - 1) * 0.5) * dy
                    if scan.arc > 0:
                        for k in range(min(width, nx - x0)):
                            position_x = (np.float64(np.int32(x0 + k)) - (nx - 1) * 0.5) * dx
                            along = position_x * c + position_y * s - beside
                            ahead = depth + position_x * s - position_y * c
                            reach, column = _on_arc(along, ahead, view, scan)
                            reach /= scan.row_pitch
                            weight = radius * radius / (along * along + ahead * ahead)
                            _set_line(lines, k, column + 1.0, weight, lowest * reach + up_middle, dz * reach, rows, nz)
                    for k in range(min(width, nx - x0) if scan.arc == 0 else 0):
                        position_x = (np.float64(np.int32(x0 + k)) - (nx - 1) * 0.5) * dx
                        closer = 1.0 / (depth + position_x * s - position_y * c)
                        _set_line(
                            lines,
                            k,
                            (position_x * c + position_y * s - beside) * closer * across_pitch + across_middle,
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
                            lines.height[k], lines.slope[k], lines.start[k], lines.stop[k], None, lines.one, lanes,
                        )  # fmt: skip
