"""Exact chord lengths of rays in convex shapes; later shapes replace earlier ones.

A shape is the intersection of half-spaces and at most one quadric: all points x with

    normal . x <= offset                        for every plane
    x . Q x + 2 b . x + c <= 0                  for the quadric

A ray therefore has one interval in a shape. Ellipsoids, cylinders and cones have a quadric; planes bound boxes and the
ends of cylinders and cones.

The rays of a bundle differ only in the rise of their end, so shapes that the bundle misses are excluded once, and the
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
        Of the planes of all shapes: normal . way of the ray without rise, the same per rise, and the distance of the
        source from the plane.
    quadrics : ndarray, shape (shapes, 9)
        Coefficients of a t^2 + 2 h t + c <= 0 on a ray: a, then h, then c, each for powers 0 to 2 of the rise.
    begin, end : ndarray, shape (shapes,)
        Disjoint parts of the ray that lie in later shapes.
    shares : ndarray, shape (materials,)
        Fraction of the ray in each material.
    """

    passed: np.ndarray
    near: np.ndarray
    far: np.ndarray
    planes: np.ndarray
    quadrics: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    shares: np.ndarray

    @classmethod
    def of(cls, shapes: Shapes) -> Workspace:
        """Allocate work arrays for these shapes."""
        count = len(shapes.material)
        near, far, begin, end = np.empty((4, count))
        planes, quadrics = np.empty((len(shapes.planes), 3)), np.empty((count, 9))
        shares = np.empty(1 + shapes.material.max(initial=-1))
        return cls(np.empty(count, np.int64), near, far, planes, quadrics, begin, end, shares)


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
def _at_height(around, z, rise, near, far):
    """Return whether a ray between two fractions of its length reaches the heights of a shape."""
    one, another = z + near * rise, z + far * rise
    return max(one, another) >= around[3] and min(one, another) <= around[4]


@compiled(inline="always", **EXACT)
def _prepare(shapes, i, source, way, closest, workspace):
    """Store a shape's planes and quadric in terms of the rise of the rays of a bundle.

    Quadratic equations start at the fraction `closest` of a ray, near the isocenter: the source may be far away.
    """
    u, v, w = way[0], way[1], way[2]
    for p in range(shapes.first_plane[i], shapes.first_plane[i + 1]):
        plane, found = shapes.planes[p], workspace.planes[p]
        found[0], found[1] = plane[0] * u + plane[1] * v + plane[2] * w, plane[2]
        found[2] = plane[3] - (plane[0] * source[0] + plane[1] * source[1] + plane[2] * source[2])
    if not shapes.curved[i]:
        return
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


@compiled(inline="always", **EXACT)
def _behind_planes(shapes, i, rise, workspace):
    """Return the part [first, last] of a ray, as fractions of its length, that lies behind the planes of a shape."""
    first, last = 0.0, 1.0
    for p in range(shapes.first_plane[i], shapes.first_plane[i + 1]):
        plane = workspace.planes[p]
        along, left = plane[0] + rise * plane[1], plane[2]
        if abs(along) < PARALLEL:
            if left < 0:
                last = -1.0
        elif along > 0:
            last = min(last, left / along)
        else:
            first = max(first, left / along)
    return first, last


@compiled(inline="always", **EXACT)
def _within_quadric(q, rise, square, first, last):
    """Return the part of [first, last] within a quadric. A ray may cross both halves of a cone; planes exclude one.

    `q` is a row of Workspace.quadrics, `square` the squared length of the ray.
    """
    a = q[0] + rise * (q[1] + rise * q[2])
    half = q[3] + rise * (q[4] + rise * q[5])
    c = q[6] + rise * (q[7] + rise * q[8])
    if abs(a) < PARALLEL * square:
        if abs(half) < PARALLEL * square:
            return (first, last) if c <= 0 else (0.0, -1.0)
        edge = -0.5 * c / half
        return (first, min(last, edge)) if half > 0 else (max(first, edge), last)
    root = half * half - a * c
    if root <= 0:
        return (first, last) if a < 0 else (0.0, -1.0)
    # Avoid cancellation: one root from the sum of equal signs, the other from their product.
    sum_ = -half - np.sqrt(root) if half > 0 else -half + np.sqrt(root)
    one, another = sum_ / a, c / sum_ if sum_ != 0 else 0.0
    low, high = min(one, another), max(one, another)
    if a > 0:
        return max(first, low), min(last, high)
    before, after = min(last, low) - first, last - max(first, high)
    return (first, min(last, low)) if before > after else (max(first, high), last)


@compiled(inline="always", **EXACT)
def _cover(workspace, count, first, last):
    """Add a part of the ray to `count` covered ones; return the new number of parts, and the length not yet covered."""
    low, high, uncovered, left = first, last, last - first, 0
    for j in range(count):
        begin, end = workspace.begin[j], workspace.end[j]
        if begin < last and first < end:  # they overlap: one part takes their place
            uncovered -= min(end, last) - max(begin, first)
            low, high = min(low, begin), max(high, end)
        else:
            workspace.begin[left], workspace.end[left] = begin, end
            left += 1
    workspace.begin[left], workspace.end[left] = low, high
    return left + 1, max(uncovered, 0.0)


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
        Added to the z component in each row, mm.
    size : float
        Factor for all lengths.
    lengths : ndarray of float32, shape (materials, views, rows, bundles)
        Output; must be zeros.
    """
    views, bundles, shares = ways.shape[0], ways.shape[1], workspace.shares
    for view in range(views):
        source = sources[view]
        for bundle in range(bundles):
            way = ways[view, bundle]
            count = _passed(shapes, source, way[0], way[1], workspace)
            if count == 0:
                continue
            across = way[0] * way[0] + way[1] * way[1]
            closest = -(source[0] * way[0] + source[1] * way[1] + source[2] * way[2]) / (across + way[2] * way[2])
            for place in range(count):
                _prepare(shapes, workspace.passed[place], source, way, closest, workspace)
            for row in range(len(rises)):
                rise, parts = rises[row], 0
                up = way[2] + rise
                square = across + up * up
                shares[:] = 0.0
                for place in range(count - 1, -1, -1):
                    i = workspace.passed[place]
                    if not _at_height(shapes.around[i], source[2], up, workspace.near[place], workspace.far[place]):
                        continue
                    first, last = _behind_planes(shapes, i, rise, workspace)
                    if first < last and shapes.curved[i]:
                        low, high = first - closest, last - closest
                        low, high = _within_quadric(workspace.quadrics[i], rise, square, low, high)
                        first, last = low + closest, high + closest
                    if first < last:
                        parts, uncovered = _cover(workspace, parts, first, last)
                        if shapes.material[i] >= 0:
                            shares[shapes.material[i]] += uncovered
                if parts == 0:
                    continue
                whole = size * np.sqrt(square)
                for material in range(shares.size):
                    lengths[material, view, row, bundle] = shares[material] * whole
