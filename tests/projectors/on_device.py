"""Arrays and kernels of a CUDA device, computed by NumPy and a C compiler."""

import ctypes
import re
import subprocess
import tempfile
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from scipy import fft


class OnDevice(np.lib.mixins.NDArrayOperatorsMixin):
    """Array with the supported operations of CuPy: never mixed with NumPy arrays or converted implicitly."""

    def __init__(self, array):
        self.held = array

    shape = property(lambda self: self.held.shape)

    def __array__(self, *_, **__):
        raise TypeError("leaves the device unasked")

    def __array_ufunc__(self, ufunc, method, *inputs, out=(), **settings):
        assert method == "__call__" and not settings, f"CuPy has no {ufunc.__name__} with {settings}"
        result = ufunc(*map(held, inputs), **({"out": tuple(map(held, out))} if out else {}))
        return out[0] if out else OnDevice(result)

    def __array_function__(self, function, types, arguments, settings):
        assert function is np.where and not settings, f"{function.__name__} is not known to be CuPy's too"
        return OnDevice(function(*map(held, arguments)))

    def __getitem__(self, key):
        return OnDevice(self.held[key])

    def __setitem__(self, key, value):
        self.held[key] = held(value)

    def __len__(self):
        return len(self.held)

    def max(self):
        return OnDevice(self.held.max())

    def sum(self, axis=None):
        return OnDevice(self.held.sum(axis=axis))

    def __float__(self):
        return float(self.held)


def held(value):
    """The array that a device would compute with."""
    if isinstance(value, OnDevice):
        return value.held
    assert isinstance(value, float | int | np.generic), f"{type(value)} is not on the device"
    return value


# A kernel as a plain function, and a function that calls it for each thread of a grid.
SHIM = """
#include <math.h>
#include <stddef.h>
#define KERNEL static void
static struct { int x, y, z; } blockIdx, threadIdx, blockDim;
%s
"""
LAUNCH = """
void launch_%s(int blocks_x, int blocks_y, int blocks_z, int threads_x, %s)
{
    blockDim.x = threads_x;
    for (blockIdx.z = 0; blockIdx.z < blocks_z; blockIdx.z++)
        for (blockIdx.y = 0; blockIdx.y < blocks_y; blockIdx.y++)
            for (blockIdx.x = 0; blockIdx.x < blocks_x; blockIdx.x++)
                for (threadIdx.x = 0; threadIdx.x < threads_x; threadIdx.x++)
                    %s(%s);
}
"""
SCALARS = {"int": (np.int32, ctypes.c_int), "double": (np.float64, ctypes.c_double)}
POINTERS = {"float": np.float32, "double": np.float64}  # structures are copied as bytes
GUARD_BYTES = 1 << 12


class Device:
    """The functions of CuPy that filtered back-projection uses. RawModule compiles CUDA C for the processor.

    Arrays lie between bytes that make NaN, so that a result shows a value that is read beyond the end of its array,
    even with a weight of 0.
    """

    fft = SimpleNamespace(
        rfft=lambda array, axis: OnDevice(fft.rfft(held(array), axis=axis)),
        irfft=lambda array, n, axis: OnDevice(fft.irfft(held(array), n, axis=axis)),
    )

    def __init__(self):
        self.guards = []

    def zeros(self, shape, dtype):
        size = int(np.prod(shape)) * np.dtype(dtype).itemsize
        buffer = np.full(size + 2 * GUARD_BYTES, 0xFF, np.uint8)
        self.guards += [buffer[:GUARD_BYTES], buffer[GUARD_BYTES + size :]]
        inside = buffer[GUARD_BYTES : GUARD_BYTES + size].view(dtype).reshape(shape)
        inside[...] = 0
        return OnDevice(inside)

    def asarray(self, array):
        assert type(array) is np.ndarray
        copy = self.zeros(array.shape, array.dtype)
        copy.held[...] = array
        return copy

    @staticmethod
    def asnumpy(array):
        return array.held.copy()

    def check(self):
        assert all((guard == 0xFF).all() for guard in self.guards), "written beyond an array"

    @staticmethod
    def RawModule(code):
        return SimpleNamespace(get_function=lambda name: _kernels(code)[name])


@cache
def _kernels(code):
    """Functions (grid, block, arguments) of the kernels of a CUDA source, by name."""
    declared = dict(re.findall(r"^KERNEL (\w+)\((.*?)\)$", code, flags=re.DOTALL | re.MULTILINE))
    prototypes = {name: re.findall(r"(\w+) (\*?)(\w+)(?:,|$)", listed) for name, listed in declared.items()}
    text = SHIM % code
    for name, parameters in prototypes.items():
        text += LAUNCH % (name, declared[name], name, ", ".join(parameter for _, _, parameter in parameters))
    with tempfile.TemporaryDirectory() as folder:
        source, library = Path(folder) / "kernels.c", Path(folder) / "kernels.so"
        source.write_text(text, encoding="utf-8")
        options = ["-O2", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
        subprocess.run(["gcc", *options, "-o", library, source, "-lm"], check=True)
        loaded = ctypes.CDLL(str(library))
    return {name: _launcher(loaded[f"launch_{name}"], parameters) for name, parameters in prototypes.items()}


def _launcher(function, parameters):
    def launch(grid, block, arguments):
        assert block[1:] == (1, 1) and len(arguments) == len(parameters)
        passed = [ctypes.c_int(count) for count in (*grid, block[0])]
        for (kind, star, _), value in zip(parameters, arguments, strict=True):
            if star:
                assert value.held.dtype == POINTERS.get(kind, np.uint8) and value.held.flags.c_contiguous, kind
                passed.append(ctypes.c_void_p(value.held.ctypes.data))
            else:
                wanted, made = SCALARS[kind]
                assert type(value) is wanted, f"CuPy passes {type(value)} with its own size, not as {kind}"
                passed.append(made(value))
        function(*passed)

    return launch
