"""Rays in the coordinates of a voxel grid, and how sums along them change with these."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...base.geometry import Grid, ScanGeometry
from ...projectors.any_rays import COORDINATES, Bundles, follow, path_lengths, trace_slopes, trace_sums
from ...projectors.rows import empty_lines, in_registers, packed, tile_width, trace_rows
from ...projectors.threads import share_out
from .sampling import Divided


@dataclass(frozen=True)
class Rays:
    """Where every ray of a scan crosses a grid.

    Attributes
    ----------
    bundles : Bundles
        In the coordinates that the kernels take.
    spacing_mm : tuple of 3 float
        Of voxels, (z, y, x), mm.
    planes : tuple of 2 int
        Number of planes across x and across y.
    columns : int
        Of the detector.
    """

    bundles: Bundles
    spacing_mm: tuple[float, float, float]
    planes: tuple[int, int]
    columns: int

    @classmethod
    def of(cls, geometry: ScanGeometry, grid: Grid, centre_mm: np.ndarray, along_x: np.ndarray | None = None) -> Rays:
        """Rays of a scan of a grid.

        Parameters
        ----------
        centre_mm : ndarray, shape (3,) or (views, 3)
            Of the grid from the isocentre, (x, y, z), mm.
        along_x : ndarray of bool, shape (views, bundles), optional
            The main directions to use; None: of each ray the larger component.
        """
        source_x, source_y, source_z = (geometry.source_mm - centre_mm).T[..., None]
        (to_x, to_y, lift_mm), rows_mm = geometry.bundles()
        if along_x is None:
            along_x = np.abs(to_x) >= np.abs(to_y)
        nz, ny, nx = grid.shape
        dz, dy, dx = grid.spacing
        main, other = np.where(along_x, to_x, to_y), np.where(along_x, to_y, to_x)
        spacing, spacing_other = np.where(along_x, dx, dy), np.where(along_x, dy, dx)
        middle, step = -np.where(along_x, source_x, source_y) / main, spacing / main  # shares of the way
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
        """How much higher than the source each ray meets the detector, mm, shape (views, rows, bundles)."""
        return self.bundles.lift_mm[:, None] + self.bundles.rows_mm[:, None]

    @property
    def lengths_mm(self) -> np.ndarray:
        """Of every ray between two planes, mm, shape (views, rows, bundles)."""
        share, square = np.moveaxis(self.bundles.between, 2, 0)[:, :, None]
        return share * np.sqrt(square + self.rises_mm**2)

    def extremes_mm(self) -> np.ndarray:
        """Coordinates in the middle of the grid, and what is added at its edge.

        The sum of their changes is how far a ray is displaced anywhere in the grid, at most.

        Returns
        -------
        ndarray, shape (4, rays)
            mm.
        """
        dz, dy, dx = self.spacing_mm
        bundles = self.bundles
        half = (np.where(bundles.along_x, *self.planes) - 1)[..., None] / 2
        across = bundles.across * np.where(bundles.along_x, dy, dx)[..., None]
        height = bundles.climb[:, :, None] * self.rises_mm.swapaxes(1, 2)[..., None] * dz
        height[..., 0] += bundles.level[:, None, None] * dz
        across, height = (
            np.concatenate([one[..., :1], one[..., 1:] * edge], axis=-1)
            for one, edge in ((across, half), (height, half[..., None]))
        )
        across = np.broadcast_to(across[:, :, None], height.shape)
        return np.concatenate([across, height], axis=-1).reshape(-1, 4).T


class Voxels:
    """Amounts of materials on a grid, and how sums along rays change with the rays.

    Parameters
    ----------
    amounts : ndarray, shape (materials, z, y, x)
    """

    def __init__(self, amounts: np.ndarray):
        self._shape, self._amounts = amounts.shape[1:], amounts

    @cached_property
    def whole(self) -> bool:
        """Whether every amount is 0 or 1: edges of the object then run along those of voxels."""
        return bool(((self._amounts == 0) | (self._amounts == 1)).all())

    @cached_property
    def _packed(self) -> tuple[np.ndarray, np.ndarray]:
        """As trace_rows takes them."""
        return packed(self._amounts)

    @cached_property
    def _volumes(self) -> tuple[np.ndarray, np.ndarray]:
        """As trace_sums takes them, and whether any voxel of a column is not zero."""
        around = np.pad(self._amounts.transpose(0, 2, 3, 1), ((0, 0), (1, 1), (1, 1), (1, 1))).astype(np.float32)
        flat = (len(around), -1)
        return around.reshape(flat), (around != 0).any(axis=3).reshape(flat)

    def path_lengths(self, rays: Rays, threads: int = 1) -> np.ndarray:
        """Path lengths of rays.

        Returns
        -------
        ndarray of float32, shape (materials, views, rows, bundles)
            mm.
        """
        count, (views, bundles) = len(self._amounts), rays.bundles.along_x.shape
        if rays.bundles.rows_mm.size > 1:
            sums, _, place = self._rows(rays, threads, with_slopes=False)
            found = np.empty((count, views, place.size, bundles), np.float32)
            path_lengths(sums, place, rays.bundles, found)
            return found
        sums = np.zeros((count, views, bundles))
        apart = rays.columns if bundles > rays.columns else 1

        def run(first, last):
            trace_sums(*self._volumes, sums[:, first:last], first, self._shape, rays.bundles, apart)

        share_out(run, views, threads)
        return (sums[:, :, None] * rays.lengths_mm).astype(np.float32)

    def slopes(self, rays: Rays, threads: int = 1) -> np.ndarray:
        """What the sums over planes change per change of the rays' coordinates.

        A path length is the sum times the length between two planes.

        Returns
        -------
        ndarray of float32, shape (views, bundles, materials, coordinates, rows)
            Coordinates as projectors/any_rays.py has them.
        """
        if rays.bundles.rows_mm.size > 1:
            _, slopes, place = self._rows(rays, threads, with_slopes=True)
            return slopes[..., place]
        found = np.zeros((*rays.bundles.along_x.shape, len(self._amounts), COORDINATES, 1), np.float32)

        def run(first, last):
            trace_slopes(*self._volumes, found[first:last], first, self._shape, rays.bundles)

        share_out(run, len(found), threads)
        return found

    def _rows(self, rays: Rays, threads: int, with_slopes: bool) -> tuple[np.ndarray, np.ndarray | None, np.ndarray]:
        """Of bundles of several rows, what `trace_rows` writes: sums, slopes, and where rows are among padded ones."""
        heights, place = in_registers(rays.bundles, self._shape)
        shape = (*rays.bundles.along_x.shape, len(self._amounts))
        sums = np.zeros((*shape, heights.size), np.float32)
        slopes = np.zeros((*shape, COORDINATES, heights.size), np.float32) if with_slopes else None

        def run(first, last):
            trace_rows(
                *self._packed,
                sums[first:last],
                None if slopes is None else slopes[first:last],
                first,
                self._shape,
                rays.bundles,
                heights,
                tile_width(shape[-1], self._shape),
                empty_lines(self._shape),
            )

        share_out(run, len(sums), threads)
        return sums, slopes, place


def followed(paths: np.ndarray, slopes: np.ndarray, traced: Rays, rays: Rays) -> np.ndarray:
    """Path lengths of rays beside those that were traced, with the same main directions, to first order.

    Parameters
    ----------
    paths : ndarray, shape (materials, views, rows, columns)
        Of the rays traced, mm.
    slopes : ndarray, shape (views, bundles, materials, coordinates, rows)
        Of the rays traced, as Voxels.slopes gives them.
    traced, rays : Rays
        The rays traced, and those beside them.

    Returns
    -------
    ndarray, shape (materials, views, rows, columns)
        mm.
    """
    views, bundles, lanes, _, rows = slopes.shape
    bundled = paths.reshape(lanes, views, rows, bundles)
    result = np.empty_like(bundled)
    follow(bundled, slopes, traced.bundles, rays.bundles, result)
    return result.reshape(paths.shape)


def outline(geometry: ScanGeometry | Divided) -> ScanGeometry:
    """The rays to the detector's corners and the middles of its upper and lower edges, one of each pixel.

    How rays are displaced changes little in between.
    """
    if isinstance(geometry, Divided):
        geometry = geometry.whole
    columns, rows = min(geometry.columns, 3), min(geometry.rows, 2)
    wider = max(geometry.columns - 1, 1) / max(columns - 1, 1)
    taller = max(geometry.rows - 1, 1) / max(rows - 1, 1)
    return replace(
        geometry,
        columns=columns,
        column_pitch_mm=geometry.column_pitch_mm * wider,
        column_offset_px=geometry.column_offset_px / wider,
        rows=rows,
        row_pitch_mm=geometry.row_pitch_mm * taller,
        row_offset_px=geometry.row_offset_px / taller,
    )
