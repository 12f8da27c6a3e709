"""Rays in the coordinates of a voxel grid: path lengths (Joseph's method) and their derivatives."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...base.geometry import Grid, ScanGeometry
from ...projectors.any_rays import extrapolate_lengths, path_lengths, trace_slopes, trace_sums
from ...projectors.joseph import COORDINATES, Bundles
from ...projectors.rows import distribute_rows, empty_lines, packed, tile_width, trace_rows
from ...projectors.threads import run_in_threads
from .sampling import SupersampledScan


@dataclass(frozen=True)
class Rays:
    """Rays of a scan in the coordinates of a grid.

    Attributes
    ----------
    bundles : Bundles
        Coordinates, as the kernels take them.
    spacing_mm : tuple of 3 float
        Voxel size (z, y, x), mm.
    planes : tuple of 2 int
        Number of voxel planes perpendicular to x and to y.
    """

    bundles: Bundles
    spacing_mm: tuple[float, float, float]
    planes: tuple[int, int]
    columns: int

    @classmethod
    def of(cls, geometry: ScanGeometry, grid: Grid, centre_mm: np.ndarray, along_x: np.ndarray | None = None) -> Rays:
        """Return the rays of a scan in the coordinates of a grid.

        Parameters
        ----------
        centre_mm : ndarray, shape (3,) or (views, 3)
            Center of the grid relative to the isocenter, (x, y, z), mm.
        along_x : ndarray of bool, shape (views, bundles), optional
            Whether the main direction of a ray is x; None: if its x component is the larger one.
        """
        source_x, source_y, source_z = (geometry.source_mm - centre_mm).T[..., None]
        (to_x, to_y, lift_mm), rows_mm = geometry.bundles()
        if along_x is None:
            along_x = np.abs(to_x) >= np.abs(to_y)
        nz, ny, nx = grid.shape
        dz, dy, dx = grid.spacing
        main, other = np.where(along_x, to_x, to_y), np.where(along_x, to_y, to_x)
        spacing, spacing_other = np.where(along_x, dx, dy), np.where(along_x, dy, dx)
        # Fractions of the ray from source to detector: at the grid's middle plane, and from plane to plane.
        middle, step = -np.where(along_x, source_x, source_y) / main, spacing / main
        at_middle = np.where(along_x, source_y, source_x) + middle * other
        index = at_middle / spacing_other + (np.where(along_x, ny, nx) - 1) / 2 + 1
        bundles = Bundles(
            along_x=along_x,
            across=np.stack([index, step * other / spacing_other], axis=-1),
            level=source_z[:, 0] / dz + (nz - 1) / 2 + 1,
            climb=np.stack([middle, step], axis=-1) / dz,
            lift_mm=lift_mm,
            rows_mm=rows_mm,
            between=np.stack([np.abs(step), to_x**2 + to_y**2], axis=-1),
        )
        return cls(bundles, grid.spacing, (nx, ny), geometry.shape[2])

    @property
    def rises_mm(self) -> np.ndarray:
        """Height of the detector end of each ray above the source, mm, shape (views, rows, bundles)."""
        return self.bundles.lift_mm[:, None] + self.bundles.rows_mm[:, None]

    @property
    def lengths_mm(self) -> np.ndarray:
        """Length of each ray between neighboring voxel planes, mm, shape (views, rows, bundles)."""
        share, square = np.moveaxis(self.bundles.between, 2, 0)[:, :, None]
        return share * np.sqrt(square + self.rises_mm**2)

    def by_pixel(self) -> Rays:
        """Return the same rays in bundles of one pixel, in row-major order."""
        bundles = self.bundles
        rows = bundles.rows_mm.size
        lift_mm = self.rises_mm.reshape(len(bundles.lift_mm), -1)
        along_x, across, climb, between = (
            np.concatenate([values] * rows, axis=1)
            for values in (bundles.along_x, bundles.across, bundles.climb, bundles.between)
        )
        changed = {"along_x": along_x, "across": across, "climb": climb, "between": between, "lift_mm": lift_mm}
        return replace(self, bundles=bundles._replace(rows_mm=np.zeros(1), **changed))

    def extremes_mm(self) -> np.ndarray:
        """Return the coordinates of each ray in the middle of the grid, and their change up to its edge.

        The sum of absolute changes of the four numbers is an upper limit of the displacement of a ray within the grid.

        Returns
        -------
        ndarray, shape (4, rays)
            mm; views, rows and columns in row-major order.
        """
        dz, dy, dx = self.spacing_mm
        bundles = self.bundles
        half = (np.where(bundles.along_x, *self.planes) - 1)[..., None] / 2
        across = bundles.across * np.where(bundles.along_x, dy, dx)[..., None]
        height = bundles.climb[:, None] * self.rises_mm[..., None] * dz
        height[..., 0] += bundles.level[:, None, None] * dz
        across, height = (
            np.concatenate([coordinate[..., :1], coordinate[..., 1:] * edge], axis=-1)
            for coordinate, edge in ((across, half), (height, half[:, None]))
        )
        across = np.broadcast_to(across[:, None], height.shape)
        return np.concatenate([across, height], axis=-1).reshape(-1, 4).T


class Voxels:
    """Amounts of materials on a grid, with path lengths of rays and their derivatives.

    Parameters
    ----------
    amounts : ndarray, shape (materials, z, y, x)
    """

    def __init__(self, amounts: np.ndarray):
        self._shape, self._amounts = amounts.shape[1:], amounts

    @cached_property
    def is_binary(self) -> bool:
        """Whether every amount is 0 or 1: each voxel has exactly one material or none."""
        return bool(((self._amounts == 0) | (self._amounts == 1)).all())

    @cached_property
    def _packed(self) -> tuple[np.ndarray, np.ndarray]:
        """Amounts in the layout of trace_rows."""
        return packed(self._amounts)

    @cached_property
    def _volumes(self) -> tuple[np.ndarray, np.ndarray]:
        """Amounts with a margin of zeros, and whether a column along z is not empty, as trace_sums takes them."""
        padded = np.pad(self._amounts.transpose(0, 2, 3, 1), ((0, 0), (1, 1), (1, 1), (1, 1))).astype(np.float32)
        flat = (len(padded), -1)
        return padded.reshape(flat), (padded != 0).any(axis=3).reshape(flat)

    def path_lengths(self, rays: Rays, threads: int = 1) -> np.ndarray:
        """Return the path lengths of rays, mm, float32, shape (materials, views, rows, bundles)."""
        count, (views, bundles) = len(self._amounts), rays.bundles.along_x.shape
        if rays.bundles.rows_mm.size > 1:
            sums, _, rows = self._rows(rays, threads, with_slopes=False)
            lengths = np.empty((count, views, rows.size, bundles), np.float32)
            path_lengths(sums, rows, rays.bundles, lengths)
            return lengths
        sums = np.zeros((count, views, bundles))
        stride = rays.columns if bundles > rays.columns else 1

        def run(first, last):
            trace_sums(*self._volumes, sums[:, first:last], first, self._shape, rays.bundles, stride)

        run_in_threads(run, views, threads)
        return (sums[:, :, None] * rays.lengths_mm).astype(np.float32)

    def slopes(self, rays: Rays, threads: int = 1) -> np.ndarray:
        """Return the derivatives of the sums over voxel planes with respect to the coordinates of the rays.

        A path length is the sum times the length between two planes.

        Returns
        -------
        ndarray of float32, shape (views, bundles, materials, coordinates, rows)
            Coordinates in the order of projectors/any_rays.py.
        """
        if rays.bundles.rows_mm.size > 1:
            _, slopes, rows = self._rows(rays, threads, with_slopes=True)
            return slopes[..., rows]
        slopes = np.zeros((*rays.bundles.along_x.shape, len(self._amounts), COORDINATES, 1), np.float32)

        def run(first, last):
            trace_slopes(*self._volumes, slopes[first:last], first, self._shape, rays.bundles)

        run_in_threads(run, len(slopes), threads)
        return slopes

    def _rows(self, rays: Rays, threads: int, with_slopes: bool) -> tuple[np.ndarray, np.ndarray | None, np.ndarray]:
        """Trace bundles of several rows: sums, slopes, and the indices of the rows among the padded ones."""
        heights, rows = distribute_rows(rays.bundles, self._shape)
        shape = (*rays.bundles.along_x.shape, len(self._amounts))
        sums = np.zeros((*shape, heights.size), np.float32)
        slopes = np.zeros((*shape, COORDINATES, heights.size), np.float32) if with_slopes else None

        def run(first, last):
            part = sums[first:last], None if slopes is None else slopes[first:last]
            workspace = tile_width(shape[-1], self._shape), empty_lines(self._shape)
            trace_rows(*self._packed, *part, first, self._shape, rays.bundles, heights, *workspace)

        run_in_threads(run, len(sums), threads)
        return sums, slopes, rows


def extrapolate_path_lengths(paths: np.ndarray, slopes: np.ndarray, traced: Rays, rays: Rays) -> np.ndarray:
    """Return first-order path lengths of rays near traced rays, which have the same main directions.

    Parameters
    ----------
    paths : ndarray, shape (materials, views, rows, columns)
        Path lengths of the traced rays.
    slopes : ndarray, shape (views, bundles, materials, coordinates, rows)
        Voxels.slopes of the traced rays.
    """
    views, bundles, materials, _, rows = slopes.shape
    bundled = paths.reshape(materials, views, rows, bundles)
    result = np.empty_like(bundled)
    extrapolate_lengths(bundled, slopes, traced.bundles, rays.bundles, result)
    return result.reshape(paths.shape)


def slopes_by_pixel(slopes: np.ndarray) -> np.ndarray:
    """Return Voxels.slopes of bundles of several rows as those of Rays.by_pixel."""
    views, _, materials, coordinates, _ = slopes.shape
    return slopes.transpose(0, 4, 1, 2, 3).reshape(views, -1, materials, coordinates, 1)


def corner_rays(geometry: ScanGeometry | SupersampledScan) -> ScanGeometry:
    """Return the scan of the detector's corner pixels and the middle pixels of its upper and lower edges.

    Displacements of rays vary little between them.
    """
    if isinstance(geometry, SupersampledScan):
        geometry = geometry.pixel_scan
    columns, rows = min(geometry.columns, 3), min(geometry.rows, 2)
    column_step = max(geometry.columns - 1, 1) / max(columns - 1, 1)
    row_step = max(geometry.rows - 1, 1) / max(rows - 1, 1)
    return replace(
        geometry,
        columns=columns,
        column_pitch_mm=geometry.column_pitch_mm * column_step,
        column_offset_px=geometry.column_offset_px / column_step,
        rows=rows,
        row_pitch_mm=geometry.row_pitch_mm * row_step,
        row_offset_px=geometry.row_offset_px / row_step,
    )
