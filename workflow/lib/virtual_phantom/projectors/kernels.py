"""Numba kernels of the CPU engine: Joseph's forward projection, its exact transpose, and voxel-driven back-projection.

Arrays are flat float32, with one voxel or pixel of zeros around them so that interpolation needs no edge cases::

    volume       [y + 2, x + 2, z + 2, lane]
    projections  [view, column + 2, row + 2, lane]

z and the detector rows have the same direction (vectors.Upright). One detector column (or voxel column) therefore
shares its in-plane interpolation, and the inner loop reads contiguous memory.

Joseph's method is in joseph.py. The main direction of a ray is that of its projection onto the x-y plane, so cone
angles must be below 45 degrees. Voxel-driven back-projection interpolates the projection bilinearly where the line from
the source through the voxel's center meets the detector. This pair of operators is that of ASTRA's 3D algorithms [1]_.

References
----------
.. [1] W. van Aarle et al., Ultramicroscopy 157, 35, 2015.
"""

import math
from collections import namedtuple
from typing import NamedTuple

import numpy as np

from ..base.compiled import compiled
from .columns import gather_line, scatter_line
from .joseph import Shadow, planes_between
from .lanes import OPTIONS

# Tiles have this many voxel columns along x and y; all views of a call are processed per tile. With 16
# lanes and 48 slices a tile is 0.8 MB, so it stays in the L2 cache instead of being read once per view.
# With FEW lanes or fewer, tiles are WIDER.
TILE, FEW, WIDER = 16, 4, 64

# Arguments of gather_line and scatter_line (columns.py) for many pairs of lines:
# - pair: the first line of the pair; near, weight: the weights of both
# - height: the cell of the first value; slope: the increment per value
# - start, stop: the range of values
Lines = namedtuple("Lines", "pair near weight height slope start stop")


class Scan(NamedTuple):
    """Grid and scan in the form that the kernels need. Arrays have shape (views,) unless stated.

    Attributes
    ----------
    shape, spacing : tuple of 3
        Voxels and voxel size in mm of the grid (z, y, x).
    column_pitch, row_pitch : float
        Pixel size, mm.
    across, nearer : ndarray, shape (columns,)
        Positions of the columns, mm: from column 0 along the column direction, and from the plane through the
        detector's reference point towards the source.
    arc : float
        Radius of a cylindrical detector, mm; 0: flat.
    first_angle : float
        Angle of column 0 about the focus of the arc, radians.
    cosine, sine, distance, first_column, first_row : ndarray
        See vectors.Upright.
    depth, beside, source_z : ndarray
        See vectors.Upright, but from the center of the grid.
    radius : ndarray
        Depth of the isocenter, mm, for the weights of back-projected views.
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


def empty_lines() -> Lines:
    """Return work arrays of one thread."""
    pair, start, stop = np.empty((3, WIDER), np.int32)
    return Lines(pair, *np.empty((4, WIDER), np.float32), start, stop)


@compiled(**OPTIONS)
def tile_width(lanes):
    """Return the width of a tile in voxel columns."""
    return TILE if len(lanes) > FEW else WIDER


@compiled(**OPTIONS)
def _ray(view, column, scan):
    """Return the in-plane source position from the center of the grid, and the vector to the detector column."""
    s, c = scan.sine[view], scan.cosine[view]
    depth, beside, distance = scan.depth[view], scan.beside[view], scan.distance[view] - scan.nearer[column]
    along = scan.first_column[view] + scan.across[column]
    return (beside * c - depth * s, beside * s + depth * c, distance * s + along * c, -distance * c + along * s)


@compiled(**OPTIONS)
def _line_up(start, direction, start_other, direction_other, planes, spacing, cells, spacing_other, step, step_other):
    """Return a ray's shadow, and the fraction of the distance to the detector at plane 0 and from plane to plane."""
    share, share_step = ((1 - planes) * 0.5 * spacing - start) / direction, spacing / direction
    per_share = direction_other / spacing_other
    other = start_other / spacing_other + share * per_share + (cells - 1) * 0.5 + 1.0
    return Shadow(other, share_step * per_share, 0.0, planes, cells, step, step_other), share, share_step


@compiled(inline="always", **OPTIONS)
def _from_zero(position, n):
    """Return the first integer (int32) from 0 to n that is not below a position.

    Uses neither 64-bit integers nor `ceil`, because some processors have no vector instructions for them.
    """
    within = min(max(position, 0.0), np.float64(n))
    below = np.int32(within)
    return np.int32(below + np.int32(within > np.float64(below)))


@compiled(inline="always", **OPTIONS)
def span(first, slope, cells, n):
    """Return the range of i in [0, n) with first + slope i in [0, cells + 1), where interpolation is nonzero."""
    inverse = 1.0 / slope
    start = _from_zero(-first * inverse, n)
    return start, max(start, _from_zero((cells + 1.0 - first) * inverse, n))


@compiled(inline="always", **OPTIONS)
def _split(position):
    """Return the cell below a position (int32) and the next cell's weight, without branches so that it vectorizes."""
    cell = np.int32(position)
    cell = np.int32(cell - np.int32(np.float64(cell) > position))
    return cell, position - np.float64(cell)


@compiled(inline="always", **OPTIONS)
def _set_line(lines, k, cell, weight, scale, height, slope, cells, n):
    """Set entry k: n values from lines `cell` and `cell` + 1, where `weight` is the share of the second, times `scale`.

    `cells` excludes padding. The function has no branches, so that it vectorizes over k.
    """
    lines.pair[k] = cell
    lines.near[k] = np.float32((1.0 - weight) * scale)
    lines.weight[k] = np.float32(weight * scale)
    lines.height[k] = np.float32(height)
    lines.slope[k] = np.float32(slope)
    lines.start[k], lines.stop[k] = span(lines.height[k], lines.slope[k], cells, n)


@compiled(inline="always", **OPTIONS)
def _on_arc(along, depth, view, scan):
    """Return where a ray meets a cylindrical detector: the distance, in lengths of the given vector, and the column.

    The vector has the in-plane components `along` the columns and `depth` away from the source.
    """
    # Position of the source relative to the focus.
    beside = scan.arc * math.sin(scan.first_angle) - scan.first_column[view]
    ahead = scan.arc - scan.distance[view]
    square, half = along * along + depth * depth, beside * along + ahead * depth
    left = beside * beside + ahead * ahead - scan.arc * scan.arc
    reach = (math.sqrt(half * half - square * left) - half) / square
    angle = math.atan2(beside + reach * along, ahead + reach * depth)
    return reach, (angle - scan.first_angle) * scan.arc / scan.column_pitch


@compiled(**OPTIONS)
def _columns_of_tile(view, x0, x1, y0, y1, scan):
    """Return detector columns [first, last) whose rays can meet the padded voxel columns [x0, x1) x [y0, y1)."""
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
def trace(volume, projections, first_view, views, scan, transpose, lines, line, lanes):
    """Compute Joseph's projection of some views, or its exact adjoint.

    A sample belongs to the tile of the first voxel column that it is interpolated from.

    Parameters
    ----------
    volume, projections : ndarray of float32, flat
        See the module's docstring. Projection adds to `projections`, which `path_lengths` must scale afterwards; the
        adjoint adds to `volume` and needs scaled projections.
    first_view, views : int
        First view of `projections`, and number of views.
    transpose : bool
        True: the adjoint.
    lines : Lines
        Work arrays of `empty_lines`.
    line : Line or None
        See `gather_line`.
    lanes : tuple
        One item per realization.
    """
    _, ny, nx = scan.shape
    width = tile_width(lanes)
    for x0 in range(0, nx + 1, width):
        for y0 in range(0, ny + 1, width):
            tile = (x0, min(x0 + width, nx + 1), y0, min(y0 + width, ny + 1))
            for i in range(views):
                first, last = _columns_of_tile(first_view + i, *tile, scan)
                for column in range(first, last):
                    _trace_ray(
                        volume, projections, i, first_view + i, column, tile, scan, transpose, lines, line, lanes
                    )


@compiled(inline="always", **OPTIONS)
def _trace_ray(volume, projections, i, view, column, tile, scan, transpose, lines, line, lanes):
    """Trace the part of one detector column's rays, for all rows, that is in a tile."""
    count = len(lanes)
    nz, ny, nx = scan.shape
    dz, dy, dx = scan.spacing
    columns, rows = scan.columns, scan.rows
    sx, sy, rx, ry = _ray(view, column, scan)
    pixel = ((i * (columns + 2) + column + 1) * (rows + 2) + 1) * count
    step_x, step_y = (nz + 2) * count, (nx + 2) * (nz + 2) * count
    # Unit: slices.
    row_pitch, first_row = scan.row_pitch / dz, scan.first_row[view] / dz
    middle = scan.source_z[view] / dz + (nz - 1) * 0.5 + 1.0
    if abs(rx) >= abs(ry):
        first_plane, last_plane, first_other, last_other = tile[0], tile[1], tile[2], tile[3]
        shadow, share0, share_step = _line_up(sx, rx, sy, ry, nx, dx, ny, dy, step_x, step_y)
    else:
        first_plane, last_plane, first_other, last_other = tile[2], tile[3], tile[0], tile[1]
        shadow, share0, share_step = _line_up(sy, ry, sx, rx, ny, dy, nx, dx, step_y, step_x)
    # planes_between skips most planes that the ray meets in other tiles; the loop below skips the others.
    start, stop = planes_between(shadow, first_other, last_other)
    first_plane, last_plane = max(first_plane - 1, start), min(min(last_plane - 1, shadow.planes), stop)
    for k in range(last_plane - first_plane):
        plane = np.float64(np.int32(first_plane + k))
        cell, weight = _split(shadow.position + shadow.slope * plane)
        share = share0 + share_step * plane
        _set_line(lines, k, cell, weight, 1.0, middle + share * first_row, share * row_pitch, nz, rows)
    for k in range(last_plane - first_plane):
        if lines.pair[k] < first_other or lines.pair[k] >= last_other:
            continue
        base = (first_plane + k + 1) * shadow.step + lines.pair[k] * shadow.step_other
        following = base + shadow.step_other
        if transpose:
            scatter_line(
                volume, base, following, projections, pixel, nz + 2, lines.near[k], lines.weight[k],
                lines.height[k], lines.slope[k], lines.start[k], lines.stop[k], line, lanes,
            )  # fmt: skip
        else:
            gather_line(
                projections, pixel, volume, base, following, nz + 2, lines.near[k], lines.weight[k],
                lines.height[k], lines.slope[k], lines.start[k], lines.stop[k], None, line, lanes,
            )  # fmt: skip


@compiled(**OPTIONS)
def path_lengths(projections, first_view, views, scan, lanes):
    """Multiply each pixel by the distance between two planes along its ray, mm: the last factor of Joseph's method."""
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
def back_project(volume, projections, first_view, views, first_y, last_y, scan, lines, line, lanes):
    """Add the voxel-driven back-projection of some views to rows first_y to last_y - 1 of the volume.

    Each view has the weight (source to isocenter / depth)^2 of FDK, which the transpose of a forward projection
    contains implicitly. For a cylindrical detector, the in-plane distance from the source replaces the depth. ASTRA's
    BP3D_CUDA differs by a constant (github.com/astra-toolbox/astra-toolbox/issues/594). Arguments are those of `trace`.
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
                # In pixels: the projection of 1 mm at a depth of 1 mm, and the detector's zero.
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
                            pair, share = _split(column + 1.0)
                            height = lowest * reach + up_middle
                            _set_line(lines, k, pair, share, weight, height, dz * reach, rows, nz)
                    for k in range(min(width, nx - x0) if scan.arc == 0 else 0):
                        position_x = (np.float64(np.int32(x0 + k)) - (nx - 1) * 0.5) * dx
                        closer = 1.0 / (depth + position_x * s - position_y * c)
                        along = (position_x * c + position_y * s - beside) * closer
                        pair, share = _split(along * across_pitch + across_middle)
                        height, slope = lowest * closer * up_pitch + up_middle, dz * closer * up_pitch
                        _set_line(lines, k, pair, share, (radius * closer) ** 2, height, slope, rows, nz)
                    for k in range(min(width, nx - x0)):
                        if lines.pair[k] < 0 or lines.pair[k] > columns:
                            continue
                        voxel = (((y + 1) * (nx + 2) + x0 + k + 1) * (nz + 2) + 1) * count
                        base = (i * (columns + 2) + lines.pair[k]) * step
                        gather_line(
                            volume, voxel, projections, base, base + step, rows + 2, lines.near[k], lines.weight[k],
                            lines.height[k], lines.slope[k], lines.start[k], lines.stop[k], None, line, lanes,
                        )  # fmt: skip
