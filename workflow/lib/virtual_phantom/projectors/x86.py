"""Interpolation along a line for one realization with x86 vector instructions, written in LLVM.

A vector register holds WIDTH neighbors along a line. Two registers hold 2 WIDTH values of the input line, from which
instructions select WIDTH. AVX-512 needs one instruction for sixteen values, AVX2 two and a selection for eight.
columns.py decides which code runs; it has loops for other processors.

CPU time with this module and with these loops (AMD EPYC, AVX-512):

* path lengths of a scene: 7 and 35 ms; their derivatives: 16 and 63 ms
* benchmarks/diagnosis_time.py with all 32 candidates: 76 and 123 s (one run each; the second included compilation)
* the same with 17 candidates: 16.8 and 20.8 s (two runs each)

SIRT of many lanes does not use this module. The loops also round some results differently.
"""

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from .processors import AVX512, PROCESSOR

WIDTH = 16 if PROCESSOR == AVX512 else 8
# Largest step along the input line for which WIDTH values need at most 2 WIDTH cells.
STEEPEST = np.float32(1.875)
# Smallest step for which WIDTH cells need at most 2 WIDTH rows. With a step of s cells per row, at most ceil(2 / s)
# rows are less than one cell away from a cell: four at this step.
FLATTEST = np.float32(0.6)

FLOAT, INT = ir.FloatType(), ir.IntType(32)
FLOATS, INTS, FLAGS = (ir.VectorType(scalar, WIDTH) for scalar in (FLOAT, INT, ir.IntType(1)))
FAST = ("fast",)


class _Neighbours:
    """Emitter of operations on WIDTH float32 or int32."""

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
        """Return the mask of the first `count` (int32) of WIDTH values."""
        return self.builder.icmp_signed("<", ir.Constant(INTS, list(range(WIDTH))), self.everywhere(count))

    def pointer(self, array_type, array, offset):
        data = self.context.make_array(array_type)(self.context, self.builder, array).data
        return self.builder.bitcast(self.builder.gep(data, [offset]), FLOATS.as_pointer())

    def load(self, pointer, mask=None):
        """Load WIDTH values; those outside of the mask are zero and not read. Without a mask it is much faster."""
        if mask is None:
            value = self.builder.load(pointer)
            value.align = 4
            return value
        function = self._declared(f"llvm.masked.load.v{WIDTH}f32.p0", FLOATS, [FLOATS.as_pointer(), INT, FLAGS, FLOATS])
        return self.builder.call(function, [pointer, INT(4), mask, ir.Constant(FLOATS, [0.0] * WIDTH)])

    def store(self, values, pointer, mask):
        if mask is None:
            self.builder.store(values, pointer).align = 4
            return
        arguments = [FLOATS, FLOATS.as_pointer(), INT, FLAGS]
        function = self._declared(f"llvm.masked.store.v{WIDTH}f32.p0", ir.VoidType(), arguments)
        self.builder.call(function, [values, pointer, INT(4), mask])

    def accumulate(self, values, pointer, mask):
        """Add values to those in memory."""
        self.store(self.add(self.load(pointer, mask), values), pointer, mask)

    def look_up(self, low, high, index):
        """Return the values at WIDTH indices of two registers."""
        if PROCESSOR == AVX512:
            function = self._declared("llvm.x86.avx512.vpermi2var.ps.512", FLOATS, [FLOATS, INTS, FLOATS])
            return self.builder.call(function, [low, index, high])
        # Each instruction uses the last three bits of an index.
        function = self._declared("llvm.x86.avx2.permps", FLOATS, [FLOATS, INTS])
        first, second = (self.builder.call(function, [half, index]) for half in (low, high))
        in_first = self.builder.icmp_signed("<", index, ir.Constant(INTS, [WIDTH] * WIDTH))
        return self.builder.select(in_first, first, second)

    def split(self, height, slope, index, numbers):
        """Split height + slope i, for i from `index` on, into cells and fractions.

        Returns
        -------
        lowest : int32
            The first cell.
        cells : int32
            WIDTH cells, relative to the lowest.
        left : float32
            Fractional part above each cell.
        """
        if PROCESSOR == AVX512:
            start = self.add(height, self.multiply(slope, self.builder.sitofp(index, FLOAT)))
            lowest = self.builder.fptosi(start, INT)
            heights = self.apart(self.subtract(start, self.builder.sitofp(lowest, FLOAT)), slope)
            cells = self.builder.fptosi(heights, INTS)
            return lowest, cells, self.subtract(heights, self.builder.sitofp(cells, FLOATS))
        # AVX2: vectors only, because a register holds half as many values.
        heights = self.add(self.everywhere(height), self.multiply(self.everywhere(slope), numbers))
        cells = self.builder.fptosi(heights, INTS)
        lowest = self.builder.extract_element(cells, INT(0))
        left = self.subtract(heights, self.builder.sitofp(cells, FLOATS))
        return lowest, self.builder.sub(cells, self.everywhere(lowest)), left

    def over(self, start, stop, action):
        """Call action(index, numbers, mask) for WIDTH consecutive integers at a time, from start to stop - 1."""
        builder, step = self.builder, start.type(WIDTH)
        before, test, body, after, rest, end = (
            builder.block,
            *(builder.append_basic_block(name) for name in ("test", "body", "after", "rest", "end")),
        )
        first = builder.sitofp(self.counted(start), FLOATS)
        builder.branch(test)
        builder.position_at_end(test)
        index, numbers = builder.phi(start.type), builder.phi(FLOATS)
        index.add_incoming(start, before)
        numbers.add_incoming(first, before)
        following = builder.add(index, step)
        builder.cbranch(builder.icmp_signed("<=", following, stop), body, after)
        builder.position_at_end(body)
        action(index, numbers, None)
        index.add_incoming(following, builder.block)
        numbers.add_incoming(self.add(numbers, ir.Constant(FLOATS, [float(WIDTH)] * WIDTH)), builder.block)
        builder.branch(test)
        builder.position_at_end(after)
        builder.cbranch(builder.icmp_signed("<", index, stop), rest, end)
        builder.position_at_end(rest)
        action(index, numbers, self.below(self.narrow(builder.sub(stop, index))))
        builder.branch(end)
        builder.position_at_end(end)

    def floor(self, values):
        return self.builder.call(self._declared(f"llvm.floor.v{WIDTH}f32", FLOATS, [FLOATS]), [values])

    def larger(self, one, other):
        return self.builder.select(self.builder.fcmp_ordered(">", one, other), one, other)

    def absolute(self, values):
        return self.builder.call(self._declared(f"llvm.fabs.v{WIDTH}f32", FLOATS, [FLOATS]), [values])

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
def gather_neighbours(typingctx, out, at, source, first, second, near, weight, height, slope, start, stop, shares):
    """Do the work of columns.gather_line for one realization."""
    # Reads 2 WIDTH cells of both lines from the first of each WIDTH values.
    whole, real = types.intp, types.float32
    signature = types.void(out, whole, source, *[whole] * 2, *[real] * 4, *[whole] * 2, shares)

    def generate(context, builder, signature, arguments):
        out, at, source, first, second, near, weight, height, slope, start, stop, given = arguments
        emit = _Neighbours(context, builder)

        def add_found(index, numbers, wanted):
            """Add WIDTH values from `index` on; `wanted` is a mask, or None for all."""
            lowest, cells, up = emit.split(height, slope, index, numbers)
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
            if signature.args[-1] != types.none:
                found = emit.multiply(found, emit.load(emit.pointer(signature.args[-1], given, index), wanted))
            emit.accumulate(found, emit.pointer(signature.args[0], out, builder.add(at, index)), wanted)

        emit.over(start, stop, add_found)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def scatter_neighbours(
    typingctx, out, first, second, source, at, begin, stop, near, weight, height, slope, lowest, end, rows
):
    """Do the work of columns.scatter_line for one realization, for cells `lowest` to `end` - 1."""
    # Reads 2 WIDTH values from the first of each WIDTH cells, from three before `begin` on. Each cell gathers from the
    # values less than one cell away, so that no two writes conflict. The length of `rows` is the largest number of
    # such values.
    whole, real = types.intp, types.float32
    signature = types.void(out, *[whole] * 2, source, *[whole] * 3, *[real] * 4, *[whole] * 2, rows)

    def generate(context, builder, signature, arguments):
        out, first, second, source, at, begin, stop, near, weight, height, slope, lowest, end, _ = arguments
        emit = _Neighbours(context, builder)
        one, zero = (ir.Constant(FLOATS, [value] * WIDTH) for value in (1.0, 0.0))
        inverse = emit.everywhere(builder.fdiv(FLOAT(1.0), slope))

        def taken(earliest, half):
            """Return one half of the values from `earliest` on."""
            place = builder.add(builder.add(at, builder.sext(earliest, at.type)), at.type(half))
            values = emit.load(emit.pointer(signature.args[3], source, place))
            # Values three beyond the first or last are two cells away or more; those between are zero padding.
            if len(rows) <= 3:
                return values
            numbers = builder.add(emit.everywhere(earliest), ir.Constant(INTS, list(range(half, half + WIDTH))))
            there = builder.and_(
                builder.icmp_signed(">=", numbers, emit.everywhere(emit.narrow(begin))),
                builder.icmp_signed("<", numbers, emit.everywhere(emit.narrow(stop))),
            )
            return builder.select(there, values, zero)

        def add_received(index, cells, wanted):
            """Add to WIDTH cells from `index` on; `wanted` is a mask, or None for all."""
            # The first row less than a cell away.
            before = emit.subtract(emit.subtract(cells, one), emit.everywhere(height))
            row = emit.add(emit.floor(emit.multiply(before, inverse)), one)
            whole_row = builder.fptosi(row, INTS)
            earliest = builder.extract_element(whole_row, INT(0))
            halves = [taken(earliest, half) for half in (0, WIDTH)]
            off = emit.subtract(emit.add(emit.multiply(emit.everywhere(slope), row), emit.everywhere(height)), cells)
            place, total = builder.sub(whole_row, emit.everywhere(earliest)), zero
            for _ in range(len(rows)):
                share = emit.larger(emit.subtract(one, emit.absolute(off)), zero)
                total = emit.add(total, emit.multiply(share, emit.look_up(*halves, place)))
                off = emit.add(off, emit.everywhere(slope))
                place = builder.add(place, ir.Constant(INTS, [1] * WIDTH))
            for line, factor in ((first, near), (second, weight)):
                target = emit.pointer(signature.args[0], out, builder.add(line, index))
                emit.accumulate(emit.multiply(emit.everywhere(factor), total), target, wanted)

        emit.over(lowest, end, add_received)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def add_rows(typingctx, sums, slopes, at, row, rows, volume, one, another, weight, t, heights, lowest, slope, top):
    """Do the work of rows.trace_rows for WIDTH rows of one lane in one plane; `at` is the offset of row 0 in sums."""
    # Reads 2 WIDTH cells of both lines from the first row on. Rows outside of the grid look up zero padding.
    whole, real = types.intp, types.float32
    signature = types.void(sums, slopes, *[whole] * 3, volume, whole, whole, real, real, heights, *[real] * 3)

    def generate(context, builder, signature, arguments):
        sums, slopes, at, row, rows, volume, one, another, weight, t, heights, lowest, slope, top = arguments
        of_sums, of_slopes, of_volume, of_heights = (signature.args[i] for i in (0, 1, 5, 10))
        emit = _Neighbours(context, builder)
        zero, ones = ir.Constant(FLOATS, [0.0] * WIDTH), ir.Constant(INTS, [1] * WIDTH)
        height = emit.load(emit.pointer(of_heights, heights, row))
        height = emit.add(emit.everywhere(lowest), emit.multiply(emit.everywhere(slope), height))
        highest = emit.everywhere(top)
        inside = builder.and_(builder.fcmp_ordered(">=", height, zero), builder.fcmp_ordered("<", height, highest))
        height = emit.larger(height, zero)
        height = builder.select(builder.fcmp_ordered("<", height, highest), height, highest)
        cells = builder.fptosi(height, INTS)
        up = emit.subtract(height, builder.sitofp(cells, FLOATS))
        first = builder.extract_element(cells, INT(0))
        cells = builder.sub(cells, emit.everywhere(first))
        following, offset = builder.add(cells, ones), builder.sext(first, one.type)
        steps, lines = [], []
        for half in (0, WIDTH):
            beside = [
                emit.load(emit.pointer(of_volume, volume, builder.add(builder.add(line, offset), one.type(half))))
                for line in (one, another)
            ]
            steps.append(emit.subtract(beside[1], beside[0]))
            lines.append(emit.add(beside[0], emit.multiply(emit.everywhere(weight), steps[-1])))

        def between(halves):
            below, above = emit.look_up(*halves, cells), emit.look_up(*halves, following)
            step = emit.subtract(above, below)
            return emit.add(below, emit.multiply(up, step)), step

        def add(array_type, array, place, values):
            emit.accumulate(values, emit.pointer(array_type, array, place), None)

        found, by_height = between(lines)
        add(of_sums, sums, builder.add(at, row), found)
        if of_slopes != types.none:
            by_other, by_height = between(steps)[0], builder.select(inside, by_height, zero)
            place, factor = builder.add(builder.mul(at, at.type(4)), row), emit.everywhere(t)
            changes = by_other, by_height, emit.multiply(factor, by_other), emit.multiply(factor, by_height)
            for change in changes:
                add(of_slopes, slopes, place, change)
                place = builder.add(place, rows)
        return context.get_dummy_value()

    return signature, generate
