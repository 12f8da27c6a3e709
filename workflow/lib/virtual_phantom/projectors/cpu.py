"""The CPU engine: numba kernels with noise realisations as SIMD lanes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..base.errors import InputError
from ..base.geometry import Grid, ScanGeometry
from . import kernels, parallel
from .lanes import aligned_zeros
from .threads import share_out

VIEWS_PER_BLOCK = 16


class CpuProjector:
    """Forward and back-projection of several realisations at once between a grid and a scan geometry.

    Stacks that a caller hands in or gets back are [lane, z, y, x] and [lane, view, row, column]. Between the two
    calls `pack_*` and `unpack_*` they stay in the kernels' own layout (see kernels.py), on which sums and products
    element by element are valid as they are.

    Parameters
    ----------
    geometry : ScanGeometry
        Upright: the detector's rows lie above each other along z.
    lanes : int, optional
        How many realisations.
    centre_mm : array_like, shape (3,) or (views, 3), optional
        Of the grid from the isocentre (x, y, z), mm, in all views or in each; whatever grid.centre_mm says of its
        world. `back_parallel` asks for one of all views.

    Raises
    ------
    InputError
        If the geometry is not upright, or the grid's corners lie outside the source's orbit.
    """

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
            # Of a flat detector so that rounding is what it is from column to column.
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
        """Zeros in the kernels' layout."""
        nz, ny, nx = self.grid.shape
        return aligned_zeros((ny + 2, nx + 2, nz + 2, self.lanes))

    def _empty_projections(self, views: int) -> np.ndarray:
        return aligned_zeros((views, self.geometry.columns + 2, self.geometry.rows + 2, self.lanes))

    @staticmethod
    def one_lane(packed: np.ndarray) -> np.ndarray:
        """The first lane of packed volumes or projections, in a shape that broadcasts against all of them."""
        return packed[..., :1]

    def pack_volume(self, stack: np.ndarray) -> np.ndarray:
        """[lane, z, y, x] to the kernels' layout."""
        packed = self.empty_volume()
        packed[1:-1, 1:-1, 1:-1] = np.transpose(stack, (2, 3, 1, 0))
        return packed

    def unpack_volume(self, packed: np.ndarray) -> np.ndarray:
        """Kernels' layout to [lane, z, y, x]."""
        return np.ascontiguousarray(np.transpose(packed[1:-1, 1:-1, 1:-1], (3, 2, 0, 1)))

    def pack_projections(self, stack: np.ndarray) -> np.ndarray:
        """[lane, view, row, column], of all views or a block of them, to the kernels' layout."""
        packed = self._empty_projections(stack.shape[1])
        packed[:, 1:-1, 1:-1] = np.transpose(stack, (1, 3, 2, 0))
        return packed

    def unpack_projections(self, packed: np.ndarray) -> np.ndarray:
        """Kernels' layout to [lane, view, row, column]."""
        return np.ascontiguousarray(np.transpose(packed[:, 1:-1, 1:-1], (3, 0, 2, 1)))

    def forward(self, volume: np.ndarray, views: slice = slice(None)) -> np.ndarray:
        """Line integrals (Joseph) of a packed volume.

        Parameters
        ----------
        volume : ndarray
            Packed, 1/mm.
        views : slice, optional
            Which views.

        Returns
        -------
        ndarray
            Packed projections of these views, dimensionless.
        """
        projections = self._empty_projections(len(range(*views.indices(self.geometry.views))))

        def run(first, last):
            part = projections[first:last]
            self._trace(volume, part, self._start(views) + first, transpose=False)
            self._scale(part, self._start(views) + first)

        self._share_out(run, len(projections))
        return projections

    def back(
        self,
        projections: np.ndarray,
        views: slice = slice(None),
        out: np.ndarray | None = None,
    ) -> np.ndarray:
        """Voxel-driven back-projection. Each view counts by (source to isocentre / depth)^2.

        Parameters
        ----------
        projections : ndarray
            Packed.
        views : slice, optional
            Which views these are of.
        out : ndarray, optional
            Packed volume to add to; None: a new one.

        Returns
        -------
        ndarray
            The packed volume.
        """
        volume = self.empty_volume() if out is None else out

        def run(first, last):
            kernels.back_project(
                volume.reshape(-1),
                projections.reshape(-1),
                self._start(views),
                len(projections),
                first,
                last,
                self._scan,
                kernels.empty_lines(self._scan),
                self._lanes,
            )

        self._share_out(run, self.grid.shape[1])
        return volume

    def adjoint(
        self,
        projections: np.ndarray,
        views: slice = slice(None),
        out: np.ndarray | None = None,
        overwrite: bool = False,
    ) -> np.ndarray:
        """The exact transpose of `forward`: <forward(x), y> = <x, adjoint(y)>.

        Neighbouring rays add to the same voxels, so this runs in one thread whatever `threads` says.

        Parameters
        ----------
        projections : ndarray
            Packed.
        views : slice, optional
            Which views these are of.
        out : ndarray, optional
            Packed volume to add to; None: a new one.
        overwrite : bool, optional
            Scale `projections` where they stand instead of in a copy.

        Returns
        -------
        ndarray
            The packed volume.
        """
        volume = self.empty_volume() if out is None else out
        scaled = projections
        if not overwrite:
            scaled = aligned_zeros(projections.shape)
            scaled[...] = projections
        self._scale(scaled, self._start(views))
        self._trace(volume, scaled, self._start(views), transpose=True)
        # Rays that graze the edge also wrote into the border, which must stay zero.
        for axis in range(3):
            np.moveaxis(volume, axis, 0)[[0, -1]] = 0
        return volume

    def back_parallel(self, projections: np.ndarray, rays, full_rows: float) -> np.ndarray:
        """Mean over directions of rebinned projections, each voxel by the views that see it.

        Parameters
        ----------
        projections : ndarray
            As `parallel_stack` lays them out.
        full_rows : float
            Share of the rows, from the middle, that count fully where views of one direction overlap.

        Returns
        -------
        ndarray
            Packed volume; zero where any direction is missing.
        """
        volume = self.empty_volume()
        nz, ny, nx = self.grid.shape
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

        def run(first, last):
            parallel.back_project_parallel(
                volume.reshape(-1),
                seen,
                projections.reshape(-1),
                first,
                last,
                scan,
                parallel.empty_room(nz, views, orbit.rows),
                self._lanes,
            )

        self._share_out(run, ny)
        volume[1:-1, 1:-1, 1:-1] *= (seen == rays.half_turn)[..., None] / np.float32(rays.half_turn)
        return volume

    def _start(self, views: slice) -> int:
        return views.indices(self.geometry.views)[0]

    def _trace(self, volume, projections, first_view, transpose):
        flat, pixels, views = volume.reshape(-1), projections.reshape(-1), len(projections)
        room = kernels.empty_lines(self._scan)
        kernels.trace(flat, pixels, first_view, views, self._scan, transpose, room, self._lanes)

    def _scale(self, projections, first_view):
        kernels.path_lengths(projections.reshape(-1), first_view, len(projections), self._scan, self._lanes)

    def _share_out(self, run, count):
        share_out(run, count, self.threads)


def parallel_stack(rays, lanes: int) -> np.ndarray:
    """Zeros for projections sorted into parallel rays (ParallelRays), in the kernels' layout.

    Returns
    -------
    ndarray of float32, shape (levels x angles, t + 2, rows + 2, lanes)
    """
    images = rays.levels * len(rays.angles_rad)
    return aligned_zeros((images, len(rays.t_mm) + 2, rays.geometry.rows + 2, lanes))


def check_in_orbit(geometry: ScanGeometry, grid: Grid, centre_mm: ArrayLike) -> None:
    """Check that the source goes round a grid.

    Parameters
    ----------
    centre_mm : array_like, shape (3,) or (views, 3)
        Of the grid from the isocentre (x, y, z), mm.

    Raises
    ------
    InputError
        If the grid's corners lie outside the source's orbit.
    """
    orbit_mm = float(np.hypot(*geometry.source_mm[:, :2].T).min())
    x, y, _ = np.asarray(centre_mm, dtype=np.float64).T
    half_diagonal = np.hypot(*grid.extent_mm[1:]) / 2 + np.hypot(x, y).max()
    if half_diagonal >= orbit_mm:
        raise InputError(
            f"grid: its corners lie {half_diagonal:.0f} mm from the isocentre, outside the source's orbit of "
            f"{orbit_mm:g} mm; shrink the grid or move the source out"
        )
