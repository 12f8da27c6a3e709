"""The CPU engine: numba kernels with noise realizations as SIMD lanes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..base.errors import InputError
from ..base.geometry import Grid, ScanGeometry
from . import kernels, parallel
from .columns import empty_line
from .lanes import aligned_zeros
from .threads import run_in_threads

VIEWS_PER_BLOCK = 16


class CpuProjector:
    """Forward and back-projection of several realizations at once between a grid and a scan geometry.

    Unpacked stacks are [lane, z, y, x] and [lane, view, row, column]. Between `pack_*` and `unpack_*` they have the
    layout of the kernels (kernels.py), which allows element-wise sums and products.

    Parameters
    ----------
    geometry : ScanGeometry
        Must be upright: the detector's rows are stacked along z.
    lanes : int, optional
        Number of realizations.
    centre_mm : array_like, shape (3,) or (views, 3), optional
        Center of the grid relative to the isocenter (x, y, z), mm, for all views or for each; grid.centre_mm is
        ignored. `back_parallel` needs one center for all views.

    Raises
    ------
    InputError
        If the geometry is not upright, or the grid's corners are outside the source's orbit.
    """

    engine = "cpu"
    voxel_axes = (0, 1, 2)  # of packed volumes
    views_per_block = VIEWS_PER_BLOCK

    def __init__(
        self,
        geometry: ScanGeometry,
        grid: Grid,
        lanes: int = 1,
        threads: int = 1,
        centre_mm: ArrayLike = (0.0, 0.0, 0.0),
    ):
        above = geometry.upright("engine cpu")
        self.centre_mm = np.asarray(centre_mm, dtype=np.float64)
        x, y, z = self.centre_mm.T
        check_in_orbit(geometry, grid, centre_mm)
        self.geometry, self.grid, self.lanes, self.threads = geometry, grid, lanes, threads
        self._lanes = (0,) * lanes
        positions = geometry.column_positions_mm()
        across, nearer = geometry.on_surface_mm(positions)
        arc = geometry.arc_radius_mm or 0.0
        self._scan = kernels.Scan(
            shape=grid.shape,
            spacing=grid.spacing,
            columns=geometry.columns,
            rows=geometry.rows,
            column_pitch=float(geometry.column_pitch_mm),
            row_pitch=float(geometry.row_pitch_mm),
            # For flat detectors, this product keeps rounding the same for all columns.
            across=across - across[0] if arc else np.arange(geometry.columns) * float(geometry.column_pitch_mm),
            nearer=nearer,
            arc=float(arc),
            first_angle=float(positions[0] / arc) if arc else 0.0,
            cosine=above.cosine,
            sine=above.sine,
            depth=above.depth + x * above.sine - y * above.cosine,
            beside=above.beside - x * above.cosine - y * above.sine,
            radius=above.depth,
            distance=above.distance,
            first_column=above.first_column,
            source_z=above.source_z - z,
            first_row=above.first_row,
        )

    def empty_volume(self) -> np.ndarray:
        """Return zeros in the layout of the kernels."""
        nz, ny, nx = self.grid.shape
        return aligned_zeros((ny + 2, nx + 2, nz + 2, self.lanes))

    def _empty_projections(self, views: int) -> np.ndarray:
        return aligned_zeros((views, self.geometry.columns + 2, self.geometry.rows + 2, self.lanes))

    @staticmethod
    def one_lane(packed: np.ndarray) -> np.ndarray:
        """Return the first lane of packed volumes or projections, in a shape that broadcasts against all lanes."""
        return packed[..., :1]

    @staticmethod
    def per_lane(values: np.ndarray) -> np.ndarray:
        """Return one value for each realization, by which packed volumes can be multiplied."""
        return values.astype(np.float32)

    def pack_volume(self, stack: np.ndarray) -> np.ndarray:
        """Convert [lane, z, y, x] to the layout of the kernels."""
        packed = self.empty_volume()
        packed[1:-1, 1:-1, 1:-1] = np.transpose(stack, (2, 3, 1, 0))
        return packed

    def unpack_volume(self, packed: np.ndarray) -> np.ndarray:
        """Convert the layout of the kernels to [lane, z, y, x]."""
        return np.ascontiguousarray(np.transpose(packed[1:-1, 1:-1, 1:-1], (3, 2, 0, 1)))

    def pack_projections(self, stack: np.ndarray) -> np.ndarray:
        """Convert [lane, view, row, column], for all views or a block of views, to the layout of the kernels."""
        packed = self._empty_projections(stack.shape[1])
        packed[:, 1:-1, 1:-1] = np.transpose(stack, (1, 3, 2, 0))
        return packed

    def unpack_projections(self, packed: np.ndarray) -> np.ndarray:
        """Convert the layout of the kernels to [lane, view, row, column]."""
        return np.ascontiguousarray(np.transpose(packed[:, 1:-1, 1:-1], (3, 0, 2, 1)))

    def forward(self, volume: np.ndarray, views: slice = slice(None)) -> np.ndarray:
        """Return line integrals of a packed volume (1/mm) by Joseph's method: packed projections, dimensionless."""
        projections = self._empty_projections(len(range(*views.indices(self.geometry.views))))
        start = self._start(views)

        def run(first, last):
            self._trace(volume, projections[first:last], start + first, transpose=False)
            self._scale(projections[first:last], start + first)

        run_in_threads(run, len(projections), self.threads)
        return projections

    def back(self, projections: np.ndarray, views: slice = slice(None), out: np.ndarray | None = None) -> np.ndarray:
        """Return the voxel-driven back-projection, packed. Each view has the weight (source to isocenter / depth)^2.

        The result is added to the packed volume `out`, if given.
        """
        volume = self.empty_volume() if out is None else out
        voxels, pixels, taken = volume.reshape(-1), projections.reshape(-1), (self._start(views), len(projections))

        def run(first, last):
            workspace = kernels.empty_lines(), self._line(self.geometry.rows), self._lanes
            kernels.back_project(voxels, pixels, *taken, first, last, self._scan, *workspace)

        run_in_threads(run, self.grid.shape[1], self.threads)
        return volume

    def adjoint(
        self,
        projections: np.ndarray,
        views: slice = slice(None),
        out: np.ndarray | None = None,
        overwrite: bool = False,
    ) -> np.ndarray:
        """Return the exact transpose of `forward`, packed: <forward(x), y> = <x, adjoint(y)>; added to `out`, if given.

        It always runs in one thread, because neighboring rays add to the same voxels. With `overwrite`, projections are
        scaled in place instead of in a copy.
        """
        volume = self.empty_volume() if out is None else out
        scaled = projections
        if not overwrite:
            scaled = aligned_zeros(projections.shape)
            scaled[...] = projections
        self._scale(scaled, self._start(views))
        self._trace(volume, scaled, self._start(views), transpose=True)
        # Rays at the edge also wrote into the padding, which must stay zero.
        for axis in range(3):
            np.moveaxis(volume, axis, 0)[[0, -1]] = 0
        return volume

    def back_parallel(self, projections: np.ndarray, rays, full_rows: float) -> np.ndarray:
        """Return a packed volume for each filter: the mean over directions, or zero where any direction is missing.

        `projections` have the layout of `parallel_stacks`. `full_rows` is the central fraction of the rows with full
        weight where views of one direction overlap.
        """
        nz, ny, nx = self.grid.shape
        volumes = aligned_zeros((len(projections), ny + 2, nx + 2, nz + 2, self.lanes))
        if nz == rays.geometry.rows == rays.levels == 1 and rays.periodic:
            for volume, of_filter in zip(volumes, projections, strict=True):
                self._back_plane(of_filter, rays, volume)
            return volumes
        seen = np.zeros((ny, nx, nz), dtype=np.float32)
        orbit, views = rays.geometry, rays.levels * -(-len(rays.angles_rad) // rays.half_turn)
        scan = parallel.ParallelScan(
            shape=self.grid.shape,
            spacing=self.grid.spacing,
            centre=tuple(map(float, self.centre_mm[::-1])),
            columns=len(rays.t_mm),
            rows=orbit.rows,
            half_turn=rays.half_turn,
            sine=np.sin(rays.angles_rad),
            cosine=np.cos(rays.angles_rad),
            view_of_angle=rays.view_of_angle,
            view_step=rays.view_step,
            source_z=float(orbit.source_z_mm[0]),
            source_step=float(orbit.source_z_mm[1] - orbit.source_z_mm[0]),
            level_z=rays.level_z_mm,
            level_radius=rays.level_radius_mm,
            level_turn=rays.level_turn_rad,
            level_ahead=rays.level_ahead_mm,
            first_row=float(orbit.row_positions_mm()[0]),
            row_pitch=float(orbit.row_pitch_mm),
            first_t=float(rays.t_mm[0]),
            t_pitch=float(rays.t_pitch_mm),
            full=float(full_rows),
        )

        voxels, pixels = (stack.reshape(len(stack), -1) for stack in (volumes, projections))

        def run(first, last):
            workspace = parallel.empty_workspace(nz, views), self._line(orbit.rows), self._lanes
            parallel.back_project_parallel(voxels, seen, pixels, first, last, scan, *workspace)

        run_in_threads(run, ny, self.threads)
        volumes[:, 1:-1, 1:-1, 1:-1] *= (seen == rays.half_turn)[..., None] / np.float32(rays.half_turn)
        return volumes

    def _back_plane(self, projections, rays, volume):
        """Set a volume to the `back_parallel` of one slice of whole turns, in which every direction is seen."""
        _, ny, nx = self.grid.shape
        _, y_mm, x_mm = self.grid.axes_mm()
        pitch = rays.t_pitch_mm
        count, half = len(rays.angles_rad), rays.half_turn
        # Rays of opposite directions coincide if the detector is centered.
        folded = count == 2 * half and abs(rays.t_mm[0] + rays.t_mm[-1]) < 1e-6 * pitch
        angles = tuple(
            wave(rays.angles_rad[: half if folded else count]).astype(np.float32) for wave in (np.sin, np.cos)
        )
        begin = (1 - rays.t_mm[0] / pitch, (x_mm[0] + self.centre_mm[0]) / pitch, (y_mm[0] + self.centre_mm[1]) / pitch)
        steps = [np.float32(step / pitch) for step in self.grid.spacing[:0:-1]]
        for lane in range(projections.shape[-1]):
            image = np.zeros((ny, nx), np.float32)
            samples = np.ascontiguousarray(projections[:, :, 1, lane])
            if folded:
                samples = samples[:half] + samples[half:, ::-1]

            def run(first, last, image=image, samples=samples):
                parallel.back_project_plane(image, samples, *angles, tuple(map(np.float32, begin)), *steps, first, last)

            run_in_threads(run, ny, self.threads)
            volume[1:-1, 1:-1, 1, lane] = image / np.float32(count)

    def _start(self, views: slice) -> int:
        return views.indices(self.geometry.views)[0]

    def _trace(self, volume, projections, first_view, transpose):
        flat, pixels, views = volume.reshape(-1), projections.reshape(-1), len(projections)
        workspace = kernels.empty_lines(), self._line(self.geometry.rows), self._lanes
        kernels.trace(flat, pixels, first_view, views, self._scan, transpose, *workspace)

    def _line(self, rows):
        return empty_line(max(rows, self.grid.shape[0])) if self.lanes == 1 else None

    def _scale(self, projections, first_view):
        kernels.path_lengths(projections.reshape(-1), first_view, len(projections), self._scan, self._lanes)


def parallel_stacks(rays, filters: int, lanes: int) -> np.ndarray:
    """Return zeros for rebinned projections: [filter, levels x angles, t + 2, rows + 2, lane], float32."""
    images = rays.levels * len(rays.angles_rad)
    return aligned_zeros((filters, images, len(rays.t_mm) + 2, rays.geometry.rows + 2, lanes))


def check_in_orbit(geometry: ScanGeometry, grid: Grid, centre_mm: ArrayLike) -> None:
    """Check that a grid is inside the source's orbit. `centre_mm` is its center (or one per view) from the isocenter.

    Raises
    ------
    InputError
        If the grid's corners are outside the orbit.
    """
    orbit_mm = float(np.hypot(*geometry.source_mm[:, :2].T).min())
    x, y, _ = np.asarray(centre_mm, dtype=np.float64).T
    half_diagonal = np.hypot(*grid.extent_mm[1:]) / 2 + np.hypot(x, y).max()
    if half_diagonal >= orbit_mm:
        raise InputError(
            f"grid: its corners are {half_diagonal:.0f} mm from the isocenter, outside the source's orbit of "
            f"{orbit_mm:g} mm; shrink the grid or move the source out"
        )
