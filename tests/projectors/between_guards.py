"""Project and back-project small scans with every array next to a page that ends the process on access.

Prints the number of scans. An array ends where the next page begins, or begins where the previous one ends.
"""

import ctypes
import itertools
import mmap
import sys

import numpy as np
from scanner import SCANNER

from virtual_phantom.base.geometry import Grid, circular, helical
from virtual_phantom.base.parallel_rays import ParallelRays
from virtual_phantom.projectors import cpu

PAGE, NO_ACCESS = mmap.PAGESIZE, 0
libc = ctypes.CDLL(None, use_errno=True)
libc.mprotect.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
stored = []  # guards must remain guards while another array is in use


def guarded(at_end):
    def zeros(shape):
        size = 4 * int(np.prod(shape))
        pages = -(-size // PAGE)
        block = mmap.mmap(-1, (pages + 2) * PAGE)
        stored.append(block)
        start = ctypes.addressof(ctypes.c_char.from_buffer(block))
        for guard in (start, start + (pages + 1) * PAGE):
            if libc.mprotect(guard, PAGE, NO_ACCESS):
                sys.exit("mprotect is not allowed here")
        offset = PAGE + (pages * PAGE - size if at_end else 0)
        return np.frombuffer(block, np.float32, size // 4, offset).reshape(shape)

    return zeros


def main():
    done = 0
    cases = itertools.product((True, False), (1, 5, 17, 33), (1, 7, 16, 33), (0.55, 0.65, 1.0, 1.8))
    for at_end, slices, rows, step in cases:
        cpu.aligned_zeros = guarded(at_end)
        detector = dict(columns=9, rows=rows, column_pitch_mm=20.0, row_pitch_mm=4.0 * step, row_offset_px=0.3)
        grid = Grid((slices, 8, 11), (2.0, 7.0, 7.0))
        for geometry in (
            circular(views=3, start_angle_rad=0.4, **detector, **SCANNER),
            helical(views=24, volume_height_mm=2.0 * slices, pitch=0.9, **detector, **SCANNER),
        ):
            projector = cpu.CpuProjector(geometry, grid)
            lines = projector.forward(projector.pack_volume(np.ones((1, *grid.shape), np.float32)))
            for image in (projector.back(lines), projector.adjoint(lines)):
                assert np.isfinite(image).all()
            done += 1
        rays = ParallelRays(geometry)
        rebinned = cpu.parallel_stacks(rays, 1, 1)
        rebinned[0, :, 1:-1, 1:-1] = 1
        assert np.isfinite(projector.back_parallel(rebinned, rays, 0.6)).all()
    print(done, "scans")


if __name__ == "__main__":
    main()
