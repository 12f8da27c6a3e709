"""Interpolation along z or the detector rows, of one line of voxels or pixels after another.

Realisations fill vector registers where there are many (lanes.py). For one alone, both lines are made one first, and
neighbours along it fill them: by instructions of x86 processors (x86.py) where these have them and slices and rows lie
about as dense, otherwise by loops that the compiler makes vectors of, on any processor.
"""

from collections import namedtuple

import numpy as np
from numba import uintp

from ..base.compiled import compiled
from .lanes import OPTIONS, gather_bilinear, scatter_bilinear
from .processors import ANY, PROCESSOR
from .x86 import FLATTEST, STEEPEST, WIDTH, gather_neighbours, scatter_neighbours

BY_HAND = PROCESSOR != ANY
# At a step of s cells from row to row, at most 2 / s rows, rounded up, lie less than a cell away from one: two from
# ONE_CELL on, three from TWO_THIRDS, four from FLATTEST, as many as the tuples are long.
ONE_CELL, TWO_THIRDS = np.float32(1.0), np.float32(2 / 3)
TWO, THREE, FOUR = (0,) * 2, (0,) * 3, (0,) * 4

# Room for one line, for each thread its own: its cells' values, and of each position along it, in cells, the whole and
# the remaining part.
Line = namedtuple("Line", "values whole part")


def empty_line(cells: int) -> Line:
    """Room for lines of at most so many cells or positions, their borders not counted."""
    size = cells + 5  # two of the border, and what positions at its end may round up to
    return Line(np.zeros(size, np.float32), np.empty(size, np.int32), np.empty(size, np.float32))


@compiled(inline="always", **OPTIONS)
def gather_line(out, at, source, first, second, length, near, weight, height, slope, start, stop, shares, line, lanes):
    """Add to out[at + i lanes], i from start to stop - 1, what two lines hold at the cell height + slope i.

    Heights must lie from 0 to under length - 1.

    Parameters
    ----------
    out, source : ndarray of float32, flat
        What is added to, and what is read.
    at : int
        Offset of value 0 in `out`.
    first, second : int
        Offsets of the two lines in `source`.
    length : int
        Cells of each line.
    near, weight : float32
        Shares of the two lines.
    height, slope : float32
        Cell of value 0, and what is added from value to value.
    start, stop : int
        Which values.
    shares : ndarray of float32 or None
        By which each value i is multiplied.
    line : Line
        Room, of `empty_line`.
    lanes : tuple
        As long as there are realisations.
    """
    count = len(lanes)
    # What is written by hand reads beyond the line, but must not read beyond the array.
    if BY_HAND and count == 1 and slope <= STEEPEST and max(first, second) + length + 2 * WIDTH <= source.size:
        gather_neighbours(out, at, source, first, second, near, weight, height, slope, start, stop, shares)
    elif count == 1:
        _gather_by_loops(out, at, source, first, second, near, weight, height, slope, start, stop, shares, line)
    else:
        for i in range(start, stop):
            h = height + slope * np.float32(i)
            k = np.int32(h)
            up = h - np.float32(k)
            low = np.float32(1.0) - up
            if shares is not None:
                up *= shares[i]
                low *= shares[i]
            cell = k * count
            gather_bilinear(
                out, at + i * count, source, first + cell, second + cell,
                near * low, near * up, weight * low, weight * up, lanes,
            )  # fmt: skip


@compiled(inline="always", **OPTIONS)
def _gather_by_loops(out, at, source, first, second, near, weight, height, slope, start, stop, shares, line):
    """Of gather_line what one realisation needs.

    Indices are unsigned, as numba takes negative ones from the end, and what asks for that is not made a vector.
    """
    if start >= stop:
        return
    begin = height + slope * np.float32(start)
    lowest = np.int64(begin)
    cells = uintp(np.int64(height + slope * np.float32(stop - 1)) + 2 - lowest)
    one, other = uintp(first + lowest), uintp(second + lowest)
    for k in range(cells):
        line.values[k] = near * source[one + k] + weight * source[other + k]
    # Rounded up, the last value may lie beyond the last cell by as much as that.
    line.values[cells] = np.float32(0.0)
    begin -= np.float32(lowest)
    count, to, given = uintp(stop - start), uintp(at + start), uintp(start)
    for i in range(count):
        h = begin + slope * np.float32(np.int32(i))
        k = np.int32(h)
        line.whole[i] = k
        line.part[i] = h - np.float32(k)
    for i in range(count):
        k = uintp(np.uint32(line.whole[i]))
        low = line.values[k]
        found = low + line.part[i] * (line.values[k + uintp(1)] - low)
        if shares is not None:
            found *= shares[given + i]
        out[to + i] += found


@compiled(inline="always", **OPTIONS)
def scatter_line(out, first, second, source, at, length, near, weight, height, slope, start, stop, line, lanes):
    """The transpose of gather_line: add what source[at + i lanes] holds to two lines at the cell height + slope i.

    The first and the last of the `length` cells are the border, of which a caller makes zeros: they may be left out.
    """
    count = len(lanes)
    # What is written by hand reads beyond the values, but must not read beyond the array.
    if BY_HAND and count == 1 and FLATTEST <= slope and at + stop + 2 * WIDTH <= source.size:
        if slope >= ONE_CELL:
            _scatter_cells(out, first, second, source, at, length, near, weight, height, slope, start, stop, TWO)
        elif slope >= TWO_THIRDS:
            _scatter_cells(out, first, second, source, at, length, near, weight, height, slope, start, stop, THREE)
        else:
            _scatter_cells(out, first, second, source, at, length, near, weight, height, slope, start, stop, FOUR)
    elif count == 1:
        _scatter_by_loops(out, first, second, source, at, near, weight, height, slope, start, stop, line)
    else:
        for i in range(start, stop):
            h = height + slope * np.float32(i)
            k = np.int32(h)
            up = h - np.float32(k)
            low = np.float32(1.0) - up
            cell = k * count
            scatter_bilinear(
                out, first + cell, second + cell, source, at + i * count,
                near * low, near * up, weight * low, weight * up, lanes,
            )  # fmt: skip


@compiled(inline="always", **OPTIONS)
def _scatter_by_loops(out, first, second, source, at, near, weight, height, slope, start, stop, line):
    """Of scatter_line what one realisation needs."""
    if start >= stop:
        return
    begin = height + slope * np.float32(start)
    lowest = np.int64(begin)
    cells = uintp(np.int64(height + slope * np.float32(stop - 1)) + 2 - lowest)
    for k in range(cells + uintp(1)):
        line.values[k] = np.float32(0.0)
    begin -= np.float32(lowest)
    count, taken = uintp(stop - start), uintp(at + start)
    for i in range(count):
        h = begin + slope * np.float32(np.int32(i))
        k = np.int32(h)
        line.whole[i] = k
        line.part[i] = h - np.float32(k)
    for i in range(count):
        k, value = uintp(np.uint32(line.whole[i])), source[taken + i]
        up = line.part[i] * value
        line.values[k] += value - up
        line.values[k + uintp(1)] += up
    one, other = uintp(first + lowest), uintp(second + lowest)
    for k in range(cells):
        out[one + k] += near * line.values[k]
    for k in range(cells):
        out[other + k] += weight * line.values[k]


@compiled(inline="always", **OPTIONS)
def _scatter_cells(out, first, second, source, at, length, near, weight, height, slope, start, stop, rows):
    """Of scatter_line, WIDTH cells at a time."""
    if start < stop:
        lowest = max(np.int64(height + slope * np.float32(start)), 1)
        end = min(np.int64(height + slope * np.float32(stop - 1)) + 2, length - 1)
        scatter_neighbours(
            out, first, second, source, at, start, stop, near, weight, height, slope, lowest, end, rows
        )  # fmt: skip
