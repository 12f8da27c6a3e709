"""Rays at which the path length in a convex shape has no derivative: along the outline of the shape and its edges.

These rays are zeros of functions that are quadratic in the direction of the ray. A ray touches the surface where the
discriminant of ray and quadric is zero. It meets a rim where the quadric is zero at the crossing of a plane. It meets
an edge where the crossings of two planes are at one place.

A function is therefore a parabola along the columns or rows of a flat detector, and nearly so across a pixel of an arc.
"""

from __future__ import annotations

import numpy as np

from ..base.compiled import compiled
from .chords import EXACT, crossing, insert, larger_sum, nearest_to_isocenter, on_ray
from .lanes import OPTIONS

LAST_BIT = 62  # of an int64 with one bit per shape
MOST_KINKS = 8  # within a pixel along a line; further ones are ignored


@compiled(inline="always", **EXACT)
def _functions(shapes, i, source, way, point, values):
    """Write the functions of a ray for shape i, which are zero at its kinks, and return their number."""
    nearest_to_isocenter(source, way, point)
    first, last, count = shapes.first_plane[i], shapes.first_plane[i + 1], 0
    if shapes.curved[i]:
        a, half, c = on_ray(shapes.quadrics[i], point, way)
        values[0], count = half * half - a * c, 1
        for one in range(first, last):
            left, along = crossing(shapes.planes[one], point, way)
            values[count] = along * along * c + 2.0 * left * along * half + left * left * a
            count += 1
    for one in range(first, last):
        left, along = crossing(shapes.planes[one], point, way)
        for other in range(one + 1, last):
            left_of_other, along_other = crossing(shapes.planes[other], point, way)
            values[count] = left * along_other - left_of_other * along
            count += 1
    return count


@compiled(inline="always", **EXACT)
def _insert_inside(found, count, place):
    """Insert a place in (0, 1) into a sorted array of `count` places, unless it is full; return the new count."""
    if not 0.0 < place < 1.0 or count == len(found):
        return count
    insert(found, count, place)
    return count + 1


@compiled(inline="always", **EXACT)
def _insert_roots(first, middle, last, found, count):
    """Insert the roots in (0, 1) of the parabola through values at 0, 1/2 and 1; return the new count."""
    square, half = 2.0 * (first + last - 2.0 * middle), 0.5 * (4.0 * middle - 3.0 * first - last)
    root = half * half - square * first
    if root <= 0.0:
        return count
    sum_ = larger_sum(half, root)
    if square != 0.0:
        count = _insert_inside(found, count, sum_ / square)
    if sum_ != 0.0:
        count = _insert_inside(found, count, first / sum_)
    return count


@compiled(**EXACT)
def kinks_in_pixels(shapes, sources, ways, seen, found, counts, point, values):
    """Find the kinks on a line through each of some pixels.

    Parameters
    ----------
    shapes : chords.Shapes
    sources : ndarray, shape (lines, 3)
        Start of the rays, mm.
    ways : ndarray, shape (lines, 3, 3)
        Vectors (x, y, z) from the source to the start, middle and end of the line, mm.
    seen : ndarray of int, shape (lines,)
        Shapes that may have kinks there, as bits (see `pixels_with_kinks`).
    found : ndarray, shape (lines, MOST_KINKS)
        Output: places of the kinks along the line, from 0 to 1, ascending.
    counts : ndarray of int, shape (lines,)
        Output: number of kinks.
    point, values : ndarray, shape (3,) and (3, functions)
        Work arrays.
    """
    for line in range(len(sources)):
        count = 0
        for i in range(len(shapes.material)):
            if not seen[line] >> min(i, LAST_BIT) & 1:
                continue
            functions = 0
            for place in range(3):
                functions = _functions(shapes, i, sources[line], ways[line, place], point, values[place])
            for one in range(functions):
                count = _insert_roots(values[0, one], values[1, one], values[2, one], found[line], count)
        counts[line] = count


@compiled(**EXACT)
def pixels_with_kinks(shapes, sources, ways, offsets, step, there, way, point, found, values):
    """Find the pixels that have a kink on one of some parallel lines through the detector.

    On an arc, the parabolas through three rays of a segment are approximate, and a kink may be found in a neighbor.

    Parameters
    ----------
    shapes : chords.Shapes
    sources : ndarray, shape (views, 3)
        Start of the rays, mm.
    ways : ndarray, shape (views, 2 segments + 1, 3)
        Vectors from the source to the borders and centers of segments of a line, in turn, mm.
    offsets : ndarray, shape (views, lines, 3)
        Vectors by which the lines are displaced, mm.
    step : int
        Pixels per segment.
    there : ndarray of int, shape (views, lines, step * segments)
        Output: the shapes that have a kink, as bits. Shapes from LAST_BIT on share a bit.
    way, point, found, values : ndarray, shape (3,), (3,), (MOST_KINKS,) and (2 segments + 1, functions)
        Work arrays.
    """
    segments = ways.shape[1] // 2
    for view in range(len(sources)):
        for line in range(offsets.shape[1]):
            there[view, line] = 0
            for i in range(len(shapes.material)):
                functions = 0
                for place in range(2 * segments + 1):
                    for axis in range(3):
                        way[axis] = ways[view, place, axis] + offsets[view, line, axis]
                    functions = _functions(shapes, i, sources[view], way, point, values[place])
                for segment in range(segments):
                    start, middle, end = values[2 * segment], values[2 * segment + 1], values[2 * segment + 2]
                    for one in range(functions):
                        for kink in range(_insert_roots(start[one], middle[one], end[one], found, 0)):
                            there[view, line, step * segment + int(step * found[kink])] |= 1 << min(i, LAST_BIT)


@compiled(**OPTIONS)
def add_vectors(views, amounts, vectors, found):
    """Add multiples of vectors of a view to its vectors from the source to the detector.

    Parameters
    ----------
    views : ndarray of int, shape (lines,)
    amounts : ndarray, shape (vectors, lines, places)
    vectors : ndarray, shape (1 + vectors, views, 3)
        The first one is added once.
    found : ndarray, shape (lines, places, 3)
        Output.
    """
    count, lines, places = amounts.shape
    for line in range(lines):
        view = views[line]
        for place in range(places):
            for axis in range(3):
                total = vectors[0, view, axis]
                for one in range(count):
                    total += amounts[one, line, place] * vectors[1 + one, view, axis]
                found[line, place, axis] = total


def most_functions(shapes) -> int:
    """Return the largest number of functions of a shape."""
    planes = np.diff(shapes.first_plane)
    return int((shapes.curved * (1 + planes) + planes * (planes - 1) // 2).max())
