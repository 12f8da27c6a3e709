"""Exact chord lengths of rays in convex shapes; later shapes replace earlier ones.

A shape is the intersection of half-spaces and at most one quadric: all points x with

    normal . x <= offset                        for every plane
    x . Q x + 2 b . x + c <= 0                  for the quadric

A ray therefore has one interval in a shape. Ellipsoids, cylinders and cones have a quadric; planes bound boxes and the
ends of cylinders and cones.

The rays of a bundle differ only in the rise of their end, so shapes that the bundle misses are excluded once. The
coefficients of a ray's quadratic equations are polynomials in its rise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..base.compiled import compiled
from .lanes import OPTIONS

EXACT = OPTIONS | {"fastmath": False}  # avoids cancellation in the roots of quadratics
PARALLEL = 1e-12  # smaller direction components and leading coefficients are rounding errors


class Shapes(NamedTuple):
    """Convex shapes as arrays. A later shape replaces earlier ones where they overlap.

    Attributes
    ----------
    planes : ndarray, shape (planes, 4)
        Normal (x, y, z) and offset, mm.
    first_plane : ndarray of int, shape (shapes + 1,)
        Shape i has the planes first_plane[i] to first_plane[i + 1] - 1.
    quadrics : ndarray, shape (shapes, 10)
        Q as xx, yy, zz, xy, xz, yz, then b, then c.
    curved : ndarray of bool, shape (shapes,)
        Whether a shape has a quadric.
    material : ndarray of int, shape (shapes,)
        Index of the material; -1: vacuum.
    around : ndarray, shape (shapes, 5)
        Upright bounding cylinder: x, y, radius, lowest z, highest z, mm. All but x and y may be infinite.
    """

    planes: np.ndarray
    first_plane: np.ndarray
    quadrics: np.ndarray
    curved: np.ndarray
    material: np.ndarray
    around: np.ndarray


class Workspace(NamedTuple):
    """Work arrays of one thread.

    Attributes
    ----------
    passed, near, far : ndarray, shape (shapes,)
        Shapes that the bundle's projection crosses, and where it enters and leaves them.
    planes : ndarray, shape (planes, 3)
        Planes of a shape: normal . way of the ray without rise, the same per rise, and the distance of the source from
        the plane.
    quadrics : ndarray, shape (shapes, 9)
        Coefficients of a t^2 + 2 h t + c <= 0 on a ray: a, then h, then c, each for powers 0 to 2 of the rise.
    first, last : ndarray, shape (rows,)
        Part of each ray that lies in a shape.
    parts : ndarray, shape (rows,)
        Number of parts of each ray that lie in later shapes.
    begin, end : ndarray, shape (rows, shapes)
        These parts, which are disjoint.
    shares : ndarray, shape (rows, materials)
        Fraction of each ray in each material.
    """

    passed: np.ndarray
    near: np.ndarray
    far: np.ndarray
    planes: np.ndarray
    quadrics: np.ndarray
    first: np.ndarray
    last: np.ndarray
    parts: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    shares: np.ndarray

    @classmethod
    def of(cls, shapes: Shapes, rows: int) -> Workspace:
        """Allocate work arrays for these shapes and bundles of this many rays."""
        count = len(shapes.material)
        near, far = np.empty((2, count))
        planes, quadrics = np.empty((len(shapes.planes), 3)), np.empty((count, 9))
        first, last = np.empty((2, rows))
        begin, end = np.empty((2, rows, count))
        shares = np.empty((rows, 1 + shapes.material.max(initial=-1)))
        passed, parts = np.empty(count, np.int64), np.empty(rows, np.int64)
        return cls(passed, near, far, planes, quadrics, first, last, parts, begin, end, shares)


@compiled(inline="always", **EXACT)
def _passed(shapes, source, to_x, to_y, workspace):
    """Store the shapes that the bundle's projection crosses, with entry and exit, and return their number."""
    square, found = to_x * to_x + to_y * to_y, 0
    for i in range(len(shapes.material)):
        around = shapes.around[i]
        near, far = 0.0, 1.0
        if around[2] < np.inf:
            x, y = around[0] - source[0], around[1] - source[1]
            across = x * to_y - y * to_x
            left = around[2] * around[2] * square - across * across
            if left < 0:
                continue
            if square > 0:
                middle, half = (x * to_x + y * to_y) / square, np.sqrt(left) / square
                near, far = max(near, middle - half), min(far, middle + half)
                if near > far:
                    continue
        workspace.passed[found], workspace.near[found], workspace.far[found] = i, near, far
        found += 1
    return found


@compiled(inline="always", **EXACT)
def _at_heights(around, z, low, high, near, far):
    """Return whether rays between two rises reach the heights of a shape between two fractions of their length."""
    low, high = min(low, high), max(low, high)
    return z + max(near * high, far * high) >= around[3] and z + min(near * low, far * low) <= around[4]


@compiled(inline="always", **EXACT)
def _prepare(shapes, i, source, way, lowest, highest, near, far, closest, workspace):
    """Store a shape's planes and quadric in terms of the rise of the rays of a bundle, and return the number of planes.

    Planes that no ray crosses between the fractions `near` and `far`, which bound the shape, are skipped. Quadratic
    equations start at the fraction `closest` of a ray, near the isocenter: the source may be far away.
    """
    u, v, w, count = way[0], way[1], way[2], 0
    for p in range(shapes.first_plane[i], shapes.first_plane[i + 1]):
        plane, cut = shapes.planes[p], workspace.planes[count]
        cut[0], cut[1] = plane[0] * u + plane[1] * v + plane[2] * w, plane[2]
        cut[2] = plane[3] - (plane[0] * source[0] + plane[1] * source[1] + plane[2] * source[2])
        low, high = cut[0] + lowest * cut[1], cut[0] + highest * cut[1]
        if max(near * low, near * high, far * low, far * high) > cut[2]:
            count += 1
    if not shapes.curved[i]:
        return count
    q, found = shapes.quadrics[i], workspace.quadrics[i]
    x, y, z = source[0] + closest * u, source[1] + closest * v, source[2] + closest * w
    # Q . way, and the gradient Q . x + b at the start; a rise r displaces the start by closest r along z.
    qx, qy, qz = q[0] * u + q[3] * v + q[4] * w, q[3] * u + q[1] * v + q[5] * w, q[4] * u + q[5] * v + q[2] * w
    gx = q[0] * x + q[3] * y + q[4] * z + q[6]
    gy = q[3] * x + q[1] * y + q[5] * z + q[7]
    gz = q[4] * x + q[5] * y + q[2] * z + q[8]
    found[0], found[1], found[2] = qx * u + qy * v + qz * w, 2.0 * qz, q[2]
    found[3], found[4], found[5] = gx * u + gy * v + gz * w, gz + closest * qz, closest * q[2]
    found[6] = (gx + q[6]) * x + (gy + q[7]) * y + (gz + q[8]) * z + q[9]
    found[7], found[8] = 2.0 * closest * gz, closest * closest * q[2]
    return count


# The compiler vectorizes the loops of the next two functions, which therefore have no branches.
@compiled(**EXACT)
def _behind_planes(planes, rises, near, far, first, last):
    """Write the parts of [near, far] of the rays of a bundle behind planes, which are rows of Workspace.planes."""
    for row in range(rises.size):
        first[row], last[row] = near, far
    for p in range(len(planes)):
        start, per_rise, left = planes[p, 0], planes[p, 1], planes[p, 2]
        for row in range(rises.size):
            along = start + rises[row] * per_rise
            at, low, high = left / along, first[row], last[row]
            first[row] = at if (along <= -PARALLEL) & (at > low) else low
            high = at if (along >= PARALLEL) & (at < high) else high
            last[row] = -1.0 if (abs(along) < PARALLEL) & (left < 0) else high


@compiled(**EXACT)
def _cut_by_convex(q, rises, closest, first, last):
    """Reduce [first, last] to the parts within a quadric `q`, a row of Workspace.quadrics, where `_is_convex` holds."""
    for row in range(rises.size):
        rise = rises[row]
        a = q[0] + rise * (q[1] + rise * q[2])
        half = q[3] + rise * (q[4] + rise * q[5])
        c = q[6] + rise * (q[7] + rise * q[8])
        root = half * half - a * c
        low, high = first[row], last[row]
        # Avoid cancellation: one root from the sum of equal signs, the other from their product.
        size = np.sqrt(max(root, 0.0))
        sum_ = -half - size if half > 0 else -half + size
        one, another = sum_ / a + closest, c / sum_ + closest
        near, far = (one, another) if one < another else (another, one)
        first[row] = near if near > low else low
        high = far if far < high else high
        last[row] = high if root > 0 else -1.0


@compiled(**EXACT)
def _cut_by_any(q, rises, across, up, closest, first, last):
    """As `_cut_by_convex` for any quadric. A ray may cross both halves of a cone; planes exclude one."""
    for row in range(rises.size):
        rise, low, high = rises[row], first[row] - closest, last[row] - closest
        square = across + (up + rise) ** 2
        a = q[0] + rise * (q[1] + rise * q[2])
        half = q[3] + rise * (q[4] + rise * q[5])
        c = q[6] + rise * (q[7] + rise * q[8])
        root = half * half - a * c
        if abs(a) < PARALLEL * square:
            if abs(half) >= PARALLEL * square:
                edge = -0.5 * c / half
                low, high = (low, min(high, edge)) if half > 0 else (max(low, edge), high)
            elif c > 0:
                high = low - 1.0
        elif root <= 0:
            high = high if a < 0 else low - 1.0
        else:
            # Avoid cancellation: one root from the sum of equal signs, the other from their product.
            sum_ = -half - np.sqrt(root) if half > 0 else -half + np.sqrt(root)
            one, another = sum_ / a, c / sum_ if sum_ != 0 else 0.0
            near, far = min(one, another), max(one, another)
            if a > 0:
                low, high = max(low, near), min(high, far)
            else:
                before, after = min(high, near) - low, high - max(low, far)
                low, high = (low, min(high, near)) if before > after else (max(low, far), high)
        first[row], last[row] = low + closest, high + closest


@compiled(inline="always", **EXACT)
def _is_convex(q, rises, across, up):
    """Return whether the leading coefficient of a row of Workspace.quadrics is positive for all rays of a bundle."""
    for row in range(rises.size):
        rise = rises[row]
        if q[0] + rise * (q[1] + rise * q[2]) < PARALLEL * (across + (up + rise) ** 2):
            return False
    return True


@compiled(inline="always", **EXACT)
def _cover(workspace, row, first, last):
    """Add a part of a ray to those in later shapes, and return the length that is in none of them."""
    begin, end = workspace.begin[row], workspace.end[row]
    low, high, uncovered, left = first, last, last - first, 0
    for j in range(workspace.parts[row]):
        if begin[j] < last and first < end[j]:  # they overlap: one part takes their place
            uncovered -= min(end[j], last) - max(begin[j], first)
            low, high = min(low, begin[j]), max(high, end[j])
        else:
            begin[left], end[left] = begin[j], end[j]
            left += 1
    begin[left], end[left] = low, high
    workspace.parts[row] = left + 1
    return max(uncovered, 0.0)


@compiled(**EXACT)
def chords(shapes, sources, ways, rises, size, lengths, workspace):
    """Write the length of rays in every material, mm.

    Parameters
    ----------
    sources : ndarray, shape (views, 3)
        Start of the rays, mm.
    ways : ndarray, shape (views, bundles, 3)
        Vector from the source to the detector for a rise of 0, mm.
    rises : ndarray, shape (rows,)
        Ascending or descending; added to the z component in each row, mm.
    size : float
        Factor for all lengths.
    lengths : ndarray of float32, shape (materials, views, rows, bundles)
        Output; must be zeros.
    """
    views, bundles, rows = ways.shape[0], ways.shape[1], len(rises)
    first, last, shares = workspace.first, workspace.last, workspace.shares
    for view in range(views):
        source = sources[view]
        for bundle in range(bundles):
            way = ways[view, bundle]
            count = _passed(shapes, source, way[0], way[1], workspace)
            if count == 0:
                continue
            across = way[0] * way[0] + way[1] * way[1]
            closest = -(source[0] * way[0] + source[1] * way[1] + source[2] * way[2]) / (across + way[2] * way[2])
            for row in range(rows):
                workspace.parts[row] = 0
                for material in range(shares.shape[1]):
                    shares[row, material] = 0.0
            for place in range(count - 1, -1, -1):
                i, near, far = workspace.passed[place], workspace.near[place], workspace.far[place]
                if not _at_heights(shapes.around[i], source[2], way[2] + rises[0], way[2] + rises[-1], near, far):
                    continue
                planes = _prepare(shapes, i, source, way, rises[0], rises[-1], near, far, closest, workspace)
                _behind_planes(workspace.planes[:planes], rises, near, far, first, last)
                if shapes.curved[i]:
                    q = workspace.quadrics[i]
                    if _is_convex(q, rises, across, way[2]):
                        _cut_by_convex(q, rises, closest, first, last)
                    else:
                        _cut_by_any(q, rises, across, way[2], closest, first, last)
                material = shapes.material[i]
                for row in range(rows):
                    if first[row] < last[row]:
                        uncovered = _cover(workspace, row, first[row], last[row])
                        if material >= 0:
                            shares[row, material] += uncovered
            for row in range(rows):
                if workspace.parts[row] > 0:
                    up = way[2] + rises[row]
                    whole = size * np.sqrt(across + up * up)
                    for material in range(shares.shape[1]):
                        if shares[row, material] > 0.0:
                            lengths[material, view, row, bundle] = shares[row, material] * whole
