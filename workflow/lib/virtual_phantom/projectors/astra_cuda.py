"""The GPU engine: ASTRA's 3D cone-beam projectors.

Volumes and projections are CuPy arrays, which ASTRA reads and writes without copies (DLPack). NumPy functions dispatch
to CuPy (NEP 13 and 18), so the arrays of SIRT stay on the device.

References
----------
W. van Aarle et al., Opt. Express 24, 25129, 2016.
"""

from __future__ import annotations

import weakref
from types import ModuleType

import astra
import numpy as np
from astra import experimental
from astra.log import AstraError

from ..base.errors import InputError
from ..base.geometry import Grid, ScanGeometry
from . import UNSUPPORTED_BY_ASTRA, astra_projects


def cone_vectors(geometry: ScanGeometry, views: slice = slice(None)) -> np.ndarray:
    """Return ASTRA's cone_vec rows (source, detector center, column step, row step; x, y, z), mm, (views, 12)."""
    column = geometry.column_direction * geometry.column_pitch_mm
    row = geometry.row_direction * geometry.row_pitch_mm
    centre = geometry.detector_mm + column * geometry.column_offset_px + row * geometry.row_offset_px
    return np.concatenate([geometry.source_mm, centre, column, row], axis=1)[views]


def volume_geometry(grid: Grid) -> dict:
    """Return ASTRA's description of a grid around the isocenter."""
    depth, height, width = (extent / 2 for extent in grid.extent_mm)
    nz, ny, nx = grid.shape
    return astra.create_vol_geom(ny, nx, nz, -width, width, -height, height, -depth, depth)


def projection_geometry(geometry: ScanGeometry, views: slice = slice(None)) -> dict:
    """Return ASTRA's description of a scan."""
    return astra.create_proj_geom("cone_vec", geometry.rows, geometry.columns, cone_vectors(geometry, views))


class AstraCudaProjector:
    """Methods of cpu.CpuProjector on a CUDA device, one realization after the other.

    Packed volumes are [lane, z, y, x] and packed projections [lane, row, view, column], float32, as in ASTRA. `pack_*`
    copies NumPy arrays to the device, `unpack_*` copies them back. `back` is ASTRA's voxel-driven back-projection with
    ASTRA's own scale. SIRT divides by its weights, which removes this scale. FBP on the device: parallel_cuda.py.

    Parameters
    ----------
    lanes : int, optional
        Number of realizations.
    arrays : module, optional
        Array module of the device; None: CuPy.

    Raises
    ------
    InputError
        For a detector that is not flat, a parallel beam, or an error of ASTRA.
    """

    voxel_axes = (1, 2, 3)  # of packed volumes

    def __init__(self, geometry: ScanGeometry, grid: Grid, lanes: int = 1, arrays: ModuleType | None = None):
        if not astra_projects(geometry):
            raise InputError(UNSUPPORTED_BY_ASTRA)
        if arrays is None:
            import cupy as arrays
        self.geometry, self.grid, self.lanes, self._arrays = geometry, grid, lanes, arrays
        # Each device call has an overhead, so all views form one block.
        self.views_per_block = geometry.views
        self._volume_geometry = volume_geometry(grid)
        self._made: dict[tuple[int, int, int], tuple[dict, int]] = {}

    def empty_volume(self):
        """Return zeros, [lane, z, y, x]."""
        return self._arrays.zeros((self.lanes, *self.grid.shape), dtype=np.float32)

    @staticmethod
    def one_lane(packed):
        """Return the first lane of packed volumes or projections, in a shape that broadcasts against all lanes."""
        return packed[:1]

    def per_lane(self, values: np.ndarray):
        """Return one value for each realization, by which packed volumes can be multiplied."""
        return self._arrays.asarray(values.astype(np.float32)[:, None, None, None])

    def pack_volume(self, stack: np.ndarray):
        """Copy [lane, z, y, x] to the device."""
        return self._arrays.asarray(np.ascontiguousarray(stack, dtype=np.float32))

    def unpack_volume(self, packed) -> np.ndarray:
        """Copy [lane, z, y, x] from the device."""
        return self._arrays.asnumpy(packed)

    def pack_projections(self, stack: np.ndarray):
        """Copy [lane, view, row, column] to [lane, row, view, column] on the device."""
        return self._arrays.asarray(np.ascontiguousarray(np.swapaxes(stack, 1, 2), dtype=np.float32))

    def unpack_projections(self, packed) -> np.ndarray:
        """Copy [lane, row, view, column] from the device to [lane, view, row, column]."""
        return np.ascontiguousarray(np.swapaxes(self._arrays.asnumpy(packed), 1, 2))

    def forward(self, volume, views: slice = slice(None)):
        """Return line integrals of all lanes for the given views."""
        count = len(range(*views.indices(self.geometry.views)))
        out = self._arrays.zeros((self.lanes, self.geometry.rows, count, self.geometry.columns), dtype=np.float32)
        for lane in range(self.lanes):
            self._run(experimental.do_composite_FP, views, volume[lane], out[lane])
        return out

    def back(self, projections, views: slice = slice(None), out=None):
        """Back-project all lanes and add the result to `out`."""
        out = self.empty_volume() if out is None else out
        for lane in range(self.lanes):
            volume = self._arrays.zeros(self.grid.shape, dtype=np.float32)
            self._run(experimental.do_composite_BP, views, volume, projections[lane])
            out[lane] += volume
        return out

    def _run(self, operation, views, volume, projections):
        """Run an ASTRA operation on arrays without copies. ASTRA's `direct_...` functions do not report failures."""
        rays, projector = self._rays_and_projector(views)
        linked = []
        try:
            linked.append(astra.data3d.link("-vol", self._volume_geometry, volume))
            linked.append(astra.data3d.link("-sino", rays, projections))
            operation(projector, linked[:1], linked[1:])
        except AstraError as error:
            raise InputError(
                f"engine: astra_cuda: {' '.join(str(error).split())}; if the device's memory is full, free it, make "
                "the grid or the scan smaller, or set engine: cpu"
            ) from error
        finally:
            astra.data3d.delete(linked)

    def _rays_and_projector(self, views):
        """Return ASTRA's description of these views and the number of a projector for them, made once."""
        span = views.indices(self.geometry.views)
        if span not in self._made:
            rays = projection_geometry(self.geometry, views)
            number = astra.create_projector("cuda3d", rays, self._volume_geometry)
            weakref.finalize(self, astra.projector3d.delete, number)
            self._made[span] = rays, number
        return self._made[span]
