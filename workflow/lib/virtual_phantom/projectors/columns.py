"""Interpolation along z or the detector rows, of one line of voxels or pixels after another.

Realisations fill vector registers where there are many (lanes.py). One alone fills them with sixteen neighbours along
the line instead, on processors with AVX-512: a register pair holds 32 values of the line that is read, and one
instruction looks sixteen of them up. Elsewhere, and where more than 32 are needed, values are taken one by one.
"""

import numpy as np
from llvmlite import ir
from numba import config, njit
from numba.core import types
from numba.core.codegen import get_host_cpu_features
from numba.extending import intrinsic

from .lanes import OPTIONS, gather_bilinear, scatter_bilinear

WIDTH = 16
FEATURES = get_host_cpu_features() if config.CPU_FEATURES is None else config.CPU_FEATURES
WIDE = "+avx512f" in FEATURES.split(",")
# Steps along the line that is read, from one value to the next, so that sixteen read from no more than 32.
STEEPEST = np.float32(30 / WIDTH)
# At a step of s cells from row to row, at most 2 / s rows, rounded up, lie less than a cell away from one: two from
# ONE_CELL on, three from TWO_THIRDS, four from FLATTEST, as many as the tuples are long. On flatter lines sixteen
# cells would read more than 32 rows: there rows are added one by one.
ONE_CELL, TWO_THIRDS, FLATTEST = np.float32(1.0), np.float32(2 / 3), np.float32(0.6)
TWO, THREE, FOUR = (0,) * 2, (0,) * 3, (0,) * 4

FLOAT, INT = ir.FloatType(), ir.IntType(32)
FLOATS, INTS, FLAGS = (ir.VectorType(one, WIDTH) for one in (FLOAT, INT, ir.IntType(1)))
FAST = ("fast",)


class _Sixteen:
    """Emits operations on sixteen float32 or int32."""

    def __init__(self, context, builder):
        self.context, self.builder = context, builder

    def everywhere(self, scalar):
        undefined = ir.Constant(ir.VectorType(scalar.type, WIDTH), ir.Undefined)
        first = self.builder.insert_element(undefined, scalar, INT(0))
        return self.builder.shuffle_vector(first, undefined, ir.Constant(INTS, [0] * WIDTH))

    def counted(self, start):
        """start, start + 1, ..."""
        return self.builder.add(self.everywhere(self.narrow(start)), ir.Constant(INTS, list(range(WIDTH))))

    def apart(self, start, step):
        """start, start + step, ..."""
        steps = self.multiply(self.everywhere(step), ir.Constant(FLOATS, [float(i) for i in range(WIDTH)]))
        return self.add(self.everywhere(start), steps)

    def narrow(self, integer):
        return self.builder.trunc(integer, INT)

    def below(self, count):
        """The first `count` of sixteen, (int32)."""
        return self.builder.icmp_signed("<", ir.Constant(INTS, list(range(WIDTH))), self.everywhere(count))

    def pointer(self, array_type, array, offset):
        data = self.context.make_array(array_type)(self.context, self.builder, array).data
        return self.builder.bitcast(self.builder.gep(data, [offset]), FLOATS.as_pointer())

    def load(self, pointer, mask=None):
        """Zero where the mask is not set: nothing is read there. Without one: all, which is much faster."""
        if mask is None:
            value = self.builder.load(pointer)
            value.align = 4
            return value
        function = self._declared("llvm.masked.load.v16f32.p0", FLOATS, [FLOATS.as_pointer(), INT, FLAGS, FLOATS])
        return self.builder.call(function, [pointer, INT(4), mask, ir.Constant(FLOATS, [0.0] * WIDTH)])

    def store(self, values, pointer, mask):
        if mask is None:
            self.builder.store(values, pointer).align = 4
            return
        arguments = [FLOATS, FLOATS.as_pointer(), INT, FLAGS]
        function = self._declared("llvm.masked.store.v16f32.p0", ir.VoidType(), arguments)
        self.builder.call(function, [values, pointer, INT(4), mask])

    def accumulate(self, values, pointer, mask):
        """Add to what stands there."""
        self.store(self.add(self.load(pointer, mask), values), pointer, mask)

    def look_up(self, low, high, index):
        """Of 32 values in two registers those at sixteen indices."""
        function = self._declared("llvm.x86.avx512.vpermi2var.ps.512", FLOATS, [FLOATS, INTS, FLOATS])
        return self.builder.call(function, [low, index, high])

    def floor(self, values):
        return self.builder.call(self._declared("llvm.floor.v16f32", FLOATS, [FLOATS]), [values])

    def larger(self, one, other):
        return self.builder.select(self.builder.fcmp_ordered(">", one, other), one, other)

    def absolute(self, values):
        return self.builder.call(self._declared("llvm.fabs.v16f32", FLOATS, [FLOATS]), [values])

    def add(self, one, other):
        return self.builder.fadd(one, other, flags=FAST)

    def subtract(self, one, other):
        return self.builder.fsub(one, other, flags=FAST)

    def multiply(self, one, other):
        return self.builder.fmul(one, other, flags=FAST)

    def _declared(self, name, result, arguments):
        function = self.builder.module.globals.get(name)
        return function or ir.Function(self.builder.module, ir.FunctionType(result, arguments), name)


@intrinsic
def _gather_sixteen(typingctx, out, at, source, first, second, near, weight, height, slope, index, count, shares):
    """Of gather_line the `count` values, at most sixteen (None: sixteen), from `index` on. Reads 32 of both lines."""
    whole, real = types.intp, types.float32
    signature = types.void(out, whole, source, *[whole] * 2, *[real] * 4, whole, count, shares)

    def generate(context, builder, signature, arguments):
        out, at, source, first, second, near, weight, height, slope, index, count, given = arguments
        emit, of_all = _Sixteen(context, builder), signature.args[-2] == types.none
        start = emit.add(height, emit.multiply(slope, builder.sitofp(index, FLOAT)))
        lowest = builder.fptosi(start, INT)
        # From the lowest cell that is read.
        heights = emit.apart(emit.subtract(start, builder.sitofp(lowest, FLOAT)), slope)
        cells = builder.fptosi(heights, INTS)
        up = emit.subtract(heights, builder.sitofp(cells, FLOATS))
        offset = builder.sext(lowest, first.type)
        halves = []
        for half in (0, WIDTH):
            parts = []
            for line, factor in ((first, near), (second, weight)):
                place = builder.add(builder.add(line, offset), first.type(half))
                values = emit.load(emit.pointer(signature.args[2], source, place))
                parts.append(emit.multiply(emit.everywhere(factor), values))
            halves.append(emit.add(*parts))
        below = emit.look_up(*halves, cells)
        above = emit.look_up(*halves, builder.add(cells, ir.Constant(INTS, [1] * WIDTH)))
        found = emit.add(below, emit.multiply(up, emit.subtract(above, below)))
        wanted = None if of_all else emit.below(emit.narrow(count))
        if shares != types.none:
            found = emit.multiply(found, emit.load(emit.pointer(shares, given, index), wanted))
        emit.accumulate(found, emit.pointer(signature.args[0], out, builder.add(at, index)), wanted)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def _scatter_sixteen(
    typingctx, out, first, second, source, at, start, stop, near, weight, height, slope, index, count, rows
):
    """Of scatter_line what `count` cells, at most sixteen (None: sixteen), from `index` on receive.

    Reads 32 values, from three before `start` on. Each cell gathers from the values that may lie less than a cell away,
    so that no two are added to one place at once; as many as `rows` is long.
    """
    whole, real = types.intp, types.float32
    signature = types.void(out, *[whole] * 2, source, *[whole] * 3, *[real] * 4, whole, count, rows)

    def generate(context, builder, signature, arguments):
        out, first, second, source, at, start, stop, near, weight, height, slope, index, count, _ = arguments
        emit, of_all = _Sixteen(context, builder), signature.args[-2] == types.none
        cells = builder.sitofp(emit.counted(index), FLOATS)
        one, zero = (ir.Constant(FLOATS, [value] * WIDTH) for value in (1.0, 0.0))
        # The first row less than a cell away.
        before = emit.subtract(emit.subtract(cells, one), emit.everywhere(height))
        inverse = builder.fdiv(FLOAT(1.0), slope)
        row = emit.add(emit.floor(emit.multiply(before, emit.everywhere(inverse))), one)
        whole_row = builder.fptosi(row, INTS)
        earliest = builder.extract_element(whole_row, INT(0))
        halves = []
        for half in (0, WIDTH):
            numbers = builder.add(emit.everywhere(earliest), ir.Constant(INTS, list(range(half, half + WIDTH))))
            there = builder.and_(
                builder.icmp_signed(">=", numbers, emit.everywhere(emit.narrow(start))),
                builder.icmp_signed("<", numbers, emit.everywhere(emit.narrow(stop))),
            )
            place = builder.add(builder.add(at, builder.sext(earliest, at.type)), at.type(half))
            halves.append(builder.select(there, emit.load(emit.pointer(signature.args[3], source, place)), zero))
        off = emit.subtract(emit.add(emit.multiply(emit.everywhere(slope), row), emit.everywhere(height)), cells)
        place, total = builder.sub(whole_row, emit.everywhere(earliest)), zero
        for _ in range(len(rows)):
            share = emit.larger(emit.subtract(one, emit.absolute(off)), zero)
            total = emit.add(total, emit.multiply(share, emit.look_up(*halves, place)))
            off = emit.add(off, emit.everywhere(slope))
            place = builder.add(place, ir.Constant(INTS, [1] * WIDTH))
        wanted = None if of_all else emit.below(emit.narrow(count))
        for line, factor in ((first, near), (second, weight)):
            target = emit.pointer(signature.args[0], out, builder.add(line, index))
            emit.accumulate(emit.multiply(emit.everywhere(factor), total), target, wanted)
        return context.get_dummy_value()

    return signature, generate


@njit(inline="always", **OPTIONS)
def gather_line(out, at, source, first, second, length, near, weight, height, slope, start, stop, shares, lanes):
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
    lanes : tuple
        As long as there are realisations.
    """
    count = len(lanes)
    # Sixteen at once read beyond the line, but must not read beyond the array.
    if WIDE and count == 1 and slope <= STEEPEST and max(first, second) + length + 2 * WIDTH <= source.size:
        last = start + (stop - start) // WIDTH * WIDTH
        for i in range(start, last, WIDTH):
            _gather_sixteen(out, at, source, first, second, near, weight, height, slope, i, None, shares)
        if last < stop:
            _gather_sixteen(out, at, source, first, second, near, weight, height, slope, last, stop - last, shares)
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


@njit(inline="always", **OPTIONS)
def scatter_line(out, first, second, source, at, length, near, weight, height, slope, start, stop, lanes):
    """The transpose of gather_line: add what source[at + i lanes] holds to two lines at the cell height + slope i.

    The first and the last of the `length` cells are the border, of which a caller makes zeros: they may be left out.
    """
    count = len(lanes)
    # Sixteen at once read beyond the values, but must not read beyond the array.
    if WIDE and count == 1 and FLATTEST <= slope and at + stop + 2 * WIDTH <= source.size:
        if slope >= ONE_CELL:
            _scatter_cells(out, first, second, source, at, length, near, weight, height, slope, start, stop, TWO)
        elif slope >= TWO_THIRDS:
            _scatter_cells(out, first, second, source, at, length, near, weight, height, slope, start, stop, THREE)
        else:
            _scatter_cells(out, first, second, source, at, length, near, weight, height, slope, start, stop, FOUR)
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


@njit(inline="always", **OPTIONS)
def _scatter_cells(out, first, second, source, at, length, near, weight, height, slope, start, stop, rows):
    """Of scatter_line, sixteen cells at a time."""
    if start < stop:
        lowest = max(np.int64(height + slope * np.float32(start)), 1)
        end = min(np.int64(height + slope * np.float32(stop - 1)) + 2, length - 1)
        last = lowest + (end - lowest) // WIDTH * WIDTH
        for k in range(lowest, last, WIDTH):
            _scatter_sixteen(
                out, first, second, source, at, start, stop, near, weight, height, slope, k, None, rows
            )  # fmt: skip
        if last < end:
            _scatter_sixteen(
                out, first, second, source, at, start, stop, near, weight, height, slope, last, end - last, rows
            )  # fmt: skip
