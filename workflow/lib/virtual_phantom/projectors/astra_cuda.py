"""The GPU engine: ASTRA's 3D cone-beam projectors (W. van Aarle et al., Opt. Express 24, 25129, 2016)."""

from __future__ import annotations

import astra
import numpy as np

from ..geometry import Grid, ScanGeometry


def cone_vectors(geometry: ScanGeometry, views: slice = slice(None)) -> np.ndarray:
    """ASTRA's cone_vec rows (source, detector centre, column step, row step; x, y, z in mm), (views, 12)."""
    b, z = geometry.angles_rad[views], geometry.source_z_mm[views]
    sine, cosine, zero = np.sin(b), np.cos(b), np.zeros_like(b)
    source = np.stack([-sine, cosine, zero], 1) * geometry.source_to_isocentre_mm
    column = np.stack([cosine, sine, zero], 1) * geometry.column_pitch_mm
    row = np.stack([zero, zero, zero + 1], 1) * geometry.row_pitch_mm
    away = np.stack([sine, -cosine, zero], 1) * geometry.source_to_detector_mm
    height = np.stack([zero, zero, z], 1)
    centre = source + away + column * geometry.column_offset_px + row * geometry.row_offset_px
    return np.concatenate([source + height, centre + height, column, row], axis=1)


class AstraCudaProjector:
    """The calls of cpu.CpuProjector on a CUDA device, one realisation after another.

    Volumes are [lane, z, y, x] and projections [lane, row, view, column], as ASTRA keeps them. `back` is ASTRA's
    voxel-driven back-projection, with ASTRA's own scale: good for SIRT, whose weights divide it out. FDK, which needs
    one pass only, stays on the CPU engine.
    """

    def __init__(self, geometry: ScanGeometry, grid: Grid, lanes: int = 1):
        self.geometry, self.grid, self.lanes = geometry, grid, lanes
        # A device call has a cost of its own: as few as possible.
        self.views_per_block = geometry.views
        depth, height, width = grid.extent_mm
        nz, ny, nx = grid.shape
        self._volume_geometry = astra.create_vol_geom(
            ny, nx, nz, -width / 2, width / 2, -height / 2, height / 2, -depth / 2, depth / 2
        )

    def empty_volume(self) -> np.ndarray:
        """Zeros, [lane, z, y, x]."""
        return np.zeros((self.lanes, *self.grid.shape), dtype=np.float32)

    def pack_volume(self, stack: np.ndarray) -> np.ndarray:
        """[lane, z, y, x], float32 and contiguous."""
        return np.ascontiguousarray(stack, dtype=np.float32)

    def unpack_volume(self, packed: np.ndarray) -> np.ndarray:
        """[lane, z, y, x]."""
        return packed

    def pack_projections(self, stack: np.ndarray) -> np.ndarray:
        """[lane, view, row, column] to [lane, row, view, column]."""
        return np.ascontiguousarray(np.swapaxes(stack, 1, 2), dtype=np.float32)

    def unpack_projections(self, packed: np.ndarray) -> np.ndarray:
        """[lane, row, view, column] to [lane, view, row, column]."""
        return np.ascontiguousarray(np.swapaxes(packed, 1, 2))

    def forward(self, volume: np.ndarray, views: slice = slice(None)) -> np.ndarray:
        """Line integrals of every lane for the given views."""
        geometry = self._projection_geometry(views)
        count = len(range(*views.indices(self.geometry.views)))
        out = np.zeros((self.lanes, self.geometry.rows, count, self.geometry.columns), dtype=np.float32)
        for lane in range(self.lanes):
            self._run("FP3D_CUDA", geometry, volume[lane], out[lane])
        return out

    def back(self, projections: np.ndarray, views: slice = slice(None), out: np.ndarray | None = None) -> np.ndarray:
        """Back-projection of every lane, added to `out`."""
        out = self.empty_volume() if out is None else out
        geometry = self._projection_geometry(views)
        for lane in range(self.lanes):
            volume = np.zeros(self.grid.shape, dtype=np.float32)
            self._run("BP3D_CUDA", geometry, volume, np.ascontiguousarray(projections[lane]))
            out[lane] += volume
        return out

    def _projection_geometry(self, views):
        return astra.create_proj_geom(
            "cone_vec", self.geometry.rows, self.geometry.columns, cone_vectors(self.geometry, views)
        )

    def _run(self, algorithm, projection_geometry, volume, projections):
        """Run one ASTRA algorithm on arrays that it reads and writes in place."""
        volume_id = astra.data3d.link("-vol", self._volume_geometry, volume)
        projection_id = astra.data3d.link("-sino", projection_geometry, projections)
        settings = astra.astra_dict(algorithm)
        settings["VolumeDataId"] = settings["ReconstructionDataId"] = volume_id
        settings["ProjectionDataId"] = projection_id
        algorithm_id = astra.algorithm.create(settings)
        try:
            astra.algorithm.run(algorithm_id)
        finally:
            astra.algorithm.delete(algorithm_id)
            astra.data3d.delete([volume_id, projection_id])
