"""Interpolation along z or the detector rows, for one line of voxels or pixels after the other.

Interpolation is bilinear between two neighboring lines. If there are several realizations, they fill the vector
registers (lanes.py). For a single realization, both lines are first combined into one, and neighbors along this line
fill the registers. The code is in x86 instructions (x86.py) if the processor has them and slices and rows are about
equally dense. Otherwise it is in loops that LLVM vectorizes on any processor.
"""

from collections import namedtuple

import numpy as np
from numba import uintp

from ..base.compiled import compiled
from .lanes import OPTIONS, gather_bilinear, scatter_bilinear
from .processors import ANY, PROCESSOR
from .x86 import FLATTEST, STEEPEST, WIDTH, gather_neighbours, scatter_neighbours

USE_X86 = PROCESSOR != ANY
# With a step of s cells per row, at most ceil(2 / s) rows are less than one cell away from a cell. These are two
# rows from ONE_CELL on, three from TWO_THIRDS, four from FLATTEST. The lengths of the tuples are these numbers.
ONE_CELL, TWO_THIRDS = np.float32(1.0), np.float32(2 / 3)
TWO, THREE, FOUR = (0,) * 2, (0,) * 3, (0,) * 4

# Work arrays of one thread for one line: the values of its cells, and the integer and fractional part of each
# position along it, in cells.
Line = namedtuple("Line", "values whole part")


def empty_line(cells: int) -> Line:
    """Return work arrays for lines with at most `cells` cells or positions, not counting padding."""
    size = cells + 5  # padding, and rounding at the end of the line
    return Line(np.zeros(size, np.float32), np.empty(size, np.int32), np.empty(size, np.float32))


@compiled(inline="always", **OPTIONS)
def gather_line(out, at, source, first, second, length, near, weight, height, slope, start, stop, shares, line, lanes):
    """Add two weighted lines, interpolated at cell height + slope i, to out[at + i lanes] for i in [start, stop).

    Heights must be in [0, length - 1).

    Parameters
    ----------
    out, source : ndarray of float32, flat
        Output and input.
    at : int
        Offset of value 0 in `out`.
    first, second : int
        Offsets of the two lines in `source`.
    length : int
        Cells of each line.
    near, weight : float32
        Weights of the two lines.
    height, slope : float32
        Cell of value 0, and the increment per value.
    start, stop : int
        Range of values.
    shares : ndarray of float32 or None
        Factor of each value i.
    line : Line or None
        Work arrays of `empty_line` for a single realization; None for several, so that Numba compiles only their code.
    lanes : tuple
        One item per realization.
    """
    if line is None:
        count = len(lanes)
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
    # The x86 code reads beyond the line but must stay within the array.
    elif USE_X86 and slope <= STEEPEST and max(first, second) + length + 2 * WIDTH <= source.size:
        gather_neighbours(out, at, source, first, second, near, weight, height, slope, start, stop, shares)
    else:
        _gather_by_loops(out, at, source, first, second, near, weight, height, slope, start, stop, shares, line)


@compiled(inline="always", **OPTIONS)
def _gather_by_loops(out, at, source, first, second, near, weight, height, slope, start, stop, shares, line):
    """Do the work of gather_line for one realization; unsigned indices avoid numba's wraparound and thus vectorize."""
    if start >= stop:
        return
    begin = height + slope * np.float32(start)
    lowest = np.int64(begin)
    cells = uintp(np.int64(height + slope * np.float32(stop - 1)) + 2 - lowest)
    one, other = uintp(first + lowest), uintp(second + lowest)
    for k in range(cells):
        line.values[k] = near * source[one + k] + weight * source[other + k]
    # Rounding may move the last position into this cell.
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
    """Apply the transpose of gather_line: add source[at + i lanes] to two lines at the cell height + slope i.

    The first and last of the `length` cells are padding, which the caller sets to zero; they may be skipped.
    """
    if line is None:
        count = len(lanes)
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
    # The x86 code reads beyond the values but must stay within the array.
    elif USE_X86 and FLATTEST <= slope and at + stop + 2 * WIDTH <= source.size:
        if slope >= ONE_CELL:
            _scatter_cells(out, first, second, source, at, length, near, weight, height, slope, start, stop, TWO)
        elif slope >= TWO_THIRDS:
            _scatter_cells(out, first, second, source, at, length, near, weight, height, slope, start, stop, THREE)
        else:
            _scatter_cells(out, first, second, source, at, length, near, weight, height, slope, start, stop, FOUR)
    else:
        _scatter_by_loops(out, first, second, source, at, near, weight, height, slope, start, stop, line)


@compiled(inline="always", **OPTIONS)
def _scatter_by_loops(out, first, second, source, at, near, weight, height, slope, start, stop, line):
    """Do the work of scatter_line for one realization."""
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
    """Do the work of scatter_line for WIDTH cells at a time."""
    if start < stop:
        lowest = max(np.int64(height + slope * np.float32(start)), 1)
        end = min(np.int64(height + slope * np.float32(stop - 1)) + 2, length - 1)
        scatter_neighbours(
            out, first, second, source, at, start, stop, near, weight, height, slope, lowest, end, rows
        )  # fmt: skip
