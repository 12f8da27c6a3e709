"""Project and back-project scans of every line density, as a single realization and as several.

python tests/projectors/one_alone.py OUT.npz      writes the results of a single realization
"""

import sys

import numpy as np
from scanner import SCANNER

from virtual_phantom.base.geometry import Grid, helical
from virtual_phantom.base.parallel_rays import ParallelRays
from virtual_phantom.projectors.cpu import CpuProjector, parallel_stacks

# (row pitch mm, rows, slices, mm of a slice)
CASES = [
    (4.0, 48, 48, 2.0),
    (2.0, 96, 40, 2.0),
    (9.0, 24, 48, 2.0),
    (4.0, 1, 3, 2.0),
    (4.0, 48, 37, 1.1),
    (3.0, 7, 5, 4.0),
    (2.5, 33, 37, 2.0),
]


def projected(case: tuple[float, int, int, float], lanes: int) -> list[np.ndarray]:
    """Projections, their back-projection, adjoint and filtered back-projection, for the last lane.

    The scan is a helix, in which lines can be cut anywhere.
    """
    row_pitch_mm, rows, slices, slice_mm = case
    detector = dict(SCANNER, columns=40, rows=rows, column_pitch_mm=16.0, row_pitch_mm=row_pitch_mm)
    grid = Grid((slices, 32, 30), (slice_mm, 9.0, 9.0))
    geometry = helical(views=30, volume_height_mm=grid.extent_mm[0], pitch=0.7, column_offset_px=0.3, **detector)
    random = np.random.default_rng(3)
    volume = random.random((1, *grid.shape), dtype=np.float32)
    taken = random.random((1, 30, rows, 40), dtype=np.float32)
    rays = ParallelRays(geometry)
    filtered = random.random((len(rays.angles_rad), 40, rows, 1), dtype=np.float32)
    projector = CpuProjector(geometry, grid, lanes)
    projections = projector.pack_projections(np.repeat(taken, lanes, 0))
    rebinned = parallel_stacks(rays, 1, lanes)
    rebinned[0, :, 1:-1, 1:-1] = filtered
    return [
        projector.unpack_projections(projector.forward(projector.pack_volume(np.repeat(volume, lanes, 0))))[-1],
        projector.unpack_volume(projector.back(projections))[-1],
        projector.unpack_volume(projector.adjoint(projections))[-1],
        projector.unpack_volume(projector.back_parallel(rebinned, rays, 0.6)[0])[-1],
    ]


if __name__ == "__main__":
    made = {f"{i}-{j}": one for i, case in enumerate(CASES) for j, one in enumerate(projected(case, 1))}
    np.savez(sys.argv[1], **made)
