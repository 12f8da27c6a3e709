"""Exact chord lengths of rays in convex shapes; later shapes replace earlier ones.

A shape is the intersection of half-spaces and at most one quadric: all points x with

    normal . x <= offset                        for every plane
    x . Q x + 2 b . x + c <= 0                  for the quadric

A ray therefore has one interval in a shape. Ellipsoids, cylinders and cones have a quadric; planes bound boxes and the
ends of cylinders and cones.

The rays of a bundle share their projection onto the plane z = 0, so shapes that they miss are excluded once per bundle.
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


@compiled(inline="always", **EXACT)
def nearest_to_isocenter(source, way, point):
    """Write the point of a ray that is nearest to the isocenter, and return its fraction of the ray.

    Equations start there, because the source may be far away.
    """
    closest = 0.0
    for axis in range(3):
        closest -= source[axis] * way[axis]
    closest /= way[0] * way[0] + way[1] * way[1] + way[2] * way[2]
    for axis in range(3):
        point[axis] = source[axis] + closest * way[axis]
    return closest


@compiled(inline="always", **EXACT)
def crossing(plane, point, way):
    """Return (left, along): a ray from a point crosses a plane at the fraction left / along of its length."""
    along = plane[0] * way[0] + plane[1] * way[1] + plane[2] * way[2]
    return plane[3] - (plane[0] * point[0] + plane[1] * point[1] + plane[2] * point[2]), along


@compiled(inline="always", **EXACT)
def on_ray(q, point, way):
    """Return (a, half, c) of a quadric along a ray from a point: a t^2 + 2 half t + c."""
    x, y, z = point[0], point[1], point[2]
    u, v, w = way[0], way[1], way[2]
    qx, qy, qz = q[0] * u + q[3] * v + q[4] * w, q[3] * u + q[1] * v + q[5] * w, q[4] * u + q[5] * v + q[2] * w
    c = (
        (q[0] * x + q[3] * y + q[4] * z) * x
        + (q[3] * x + q[1] * y + q[5] * z) * y
        + (q[4] * x + q[5] * y + q[2] * z) * z
        + 2.0 * (q[6] * x + q[7] * y + q[8] * z)
        + q[9]
    )
    return qx * u + qy * v + qz * w, qx * x + qy * y + qz * z + q[6] * u + q[7] * v + q[8] * w, c


@compiled(inline="always", **EXACT)
def larger_sum(half, root):
    """Return the sum without cancellation, s, of the roots s / a and c / s of a t^2 + 2 half t + c.

    `root` is half^2 - a c.
    """
    return -half - np.sqrt(root) if half > 0 else -half + np.sqrt(root)


@compiled(inline="always", **EXACT)
def insert(values, count, value):
    """Insert a value into a sorted array of `count` values."""
    place = count
    while place > 0 and values[place - 1] > value:
        values[place] = values[place - 1]
        place -= 1
    values[place] = value


@compiled(inline="always", **EXACT)
def _behind_planes(shapes, i, source, way):
    """Return the part [first, last] of a ray, as fractions of its length, that lies behind the planes of a shape."""
    first, last = 0.0, 1.0
    for p in range(shapes.first_plane[i], shapes.first_plane[i + 1]):
        left, along = crossing(shapes.planes[p], source, way)
        if abs(along) < PARALLEL:
            if left < 0:
                last = -1.0
        elif along > 0:
            last = min(last, left / along)
        else:
            first = max(first, left / along)
    return first, last


@compiled(inline="always", **EXACT)
def _within_quadric(q, source, way, first, last):
    """Return the part of [first, last] within a quadric. A ray may cross both halves of a cone; planes exclude one."""
    a, half, c = on_ray(q, source, way)
    length = way[0] * way[0] + way[1] * way[1] + way[2] * way[2]
    if abs(a) < PARALLEL * length:
        if abs(half) < PARALLEL * length:
            return (first, last) if c <= 0 else (0.0, -1.0)
        edge = -0.5 * c / half
        return (first, min(last, edge)) if half > 0 else (max(first, edge), last)
    root = half * half - a * c
    if root <= 0:
        return (first, last) if a < 0 else (0.0, -1.0)
    sum_ = larger_sum(half, root)
    one, another = sum_ / a, c / sum_ if sum_ != 0 else 0.0
    low, high = min(one, another), max(one, another)
    if a > 0:
        return max(first, low), min(last, high)
    before, after = min(last, low) - first, last - max(first, high)
    return (first, min(last, low)) if before > after else (max(first, high), last)


class Workspace(NamedTuple):
    """Work arrays of one thread.

    Attributes
    ----------
    begin, end, met : ndarray, shape (shapes,)
        Entry and exit of the ray in the shapes that it meets, and the indices of these shapes.
    edges : ndarray, shape (2 shapes,)
        All entries and exits in order.
    way, nearest : ndarray, shape (3,)
        Vector from source to detector, and the point of the ray that is nearest to the isocenter.
    passed, near, far : ndarray, shape (shapes,)
        Shapes that the bundle's projection crosses, and where it enters and leaves them.
    shares : ndarray, shape (materials,)
        Fraction of the ray in each material.
    """

    begin: np.ndarray
    end: np.ndarray
    met: np.ndarray
    edges: np.ndarray
    way: np.ndarray
    nearest: np.ndarray
    passed: np.ndarray
    near: np.ndarray
    far: np.ndarray
    shares: np.ndarray

    @classmethod
    def of(cls, shapes: Shapes) -> Workspace:
        """Allocate work arrays for these shapes."""
        count = len(shapes.material)
        begin, end, near, far = np.empty((4, count))
        met, passed = np.empty((2, count), np.int64)
        shares = np.empty(1 + shapes.material.max(initial=-1))
        return cls(begin, end, met, np.empty(2 * count), np.empty(3), np.empty(3), passed, near, far, shares)


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
    views, bundles = ways.shape[0], ways.shape[1]
    begin, end, met, edges, way, nearest = (
        workspace.begin,
        workspace.end,
        workspace.met,
        workspace.edges,
        workspace.way,
        workspace.nearest,
    )
    shares = workspace.shares
    for view in range(views):
        source = sources[view]
        for bundle in range(bundles):
            way[0], way[1] = ways[view, bundle, 0], ways[view, bundle, 1]
            count = _passed(shapes, source, way[0], way[1], workspace)
            if count == 0:
                continue
            for row in range(len(rises)):
                way[2] = ways[view, bundle, 2] + rises[row]
                found = 0
                closest = nearest_to_isocenter(source, way, nearest)
                for place in range(count):
                    i = workspace.passed[place]
                    if not _at_height(shapes.around[i], source[2], way[2], workspace.near[place], workspace.far[place]):
                        continue
                    first, last = _behind_planes(shapes, i, source, way)
                    if first < last and shapes.curved[i]:
                        low, high = first - closest, last - closest
                        low, high = _within_quadric(shapes.quadrics[i], nearest, way, low, high)
                        first, last = low + closest, high + closest
                    if first < last:
                        begin[found], end[found], met[found] = first, last, i
                        insert(edges, 2 * found, first)
                        insert(edges, 2 * found + 1, last)
                        found += 1
                if found == 0:
                    continue
                shares[:] = 0.0
                for part in range(2 * found - 1):
                    middle = 0.5 * (edges[part] + edges[part + 1])
                    for k in range(found - 1, -1, -1):
                        if begin[k] < middle < end[k]:
                            material = shapes.material[met[k]]
                            if material >= 0:
                                shares[material] += edges[part + 1] - edges[part]
                            break
                whole = size * np.sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2])
                for material in range(shares.size):
                    lengths[material, view, row, bundle] = shares[material] * whole
