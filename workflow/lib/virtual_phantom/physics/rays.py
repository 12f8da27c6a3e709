"""Rays in the coordinates of a voxel grid, and how sums along them change with these."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..base.geometry import Grid, ScanGeometry
from ..projectors.any_rays import COORDINATES, Bundles, follow, trace_slopes, trace_sums
from ..projectors.cpu import share_out


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
    """

    bundles: Bundles
    spacing_mm: tuple[float, float, float]
    planes: tuple[int, int]

    @classmethod
    def of(cls, geometry: ScanGeometry, grid: Grid, centre_mm: np.ndarray, along_x: np.ndarray | None = None) -> Rays:
        """Rays of a scan of a grid.

        Parameters
        ----------
        geometry : ScanGeometry
        grid : Grid
        centre_mm : ndarray, shape (3,) or (views, 3)
            Of the grid from the isocentre, (x, y, z), mm.
        along_x : ndarray of bool, shape (views, bundles), optional
            The main directions to use; None: of each ray the larger component.

        Returns
        -------
        Rays
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
        return cls(bundles, grid.spacing, (nx, ny))

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
        self._shape = amounts.shape[1:]
        around = np.pad(amounts.transpose(0, 2, 3, 1), ((0, 0), (1, 1), (1, 1), (1, 1))).astype(np.float32)
        flat = (len(amounts), -1)
        self._volumes, self._occupied = around.reshape(flat), (around != 0).any(axis=3).reshape(flat)

    def path_lengths(self, rays: Rays, threads: int = 1) -> np.ndarray:
        """Path lengths of rays.

        Parameters
        ----------
        rays : Rays
            Those of a bundle of several rows must have one shadow and meet the same voxels.
        threads : int, optional

        Returns
        -------
        ndarray of float32, shape (materials, views, rows, bundles)
            mm.
        """
        sums = np.zeros((len(self._volumes), *rays.bundles.along_x.shape))

        def run(first, last):
            trace_sums(self._volumes, sums[:, first:last], first, self._shape, rays.bundles)

        share_out(run, sums.shape[1], threads)
        return (sums[:, :, None] * rays.lengths_mm).astype(np.float32)

    def slopes(self, rays: Rays, threads: int = 1) -> np.ndarray:
        """What the sums over planes change per change of the rays' coordinates.

        A path length is the sum times the length between two planes.

        Parameters
        ----------
        rays : Rays
        threads : int, optional

        Returns
        -------
        ndarray of float32, shape (materials, views, bundles, rows, coordinates)
            Coordinates as projectors/any_rays.py has them.
        """
        views, bundles = rays.bundles.along_x.shape
        found = np.zeros((len(self._volumes), views, bundles, rays.bundles.rows_mm.size, COORDINATES), np.float32)

        def run(first, last):
            trace_slopes(self._volumes, self._occupied, found[:, first:last], first, self._shape, rays.bundles)

        share_out(run, views, threads)
        return found


def followed(paths: np.ndarray, slopes: np.ndarray, traced: Rays, rays: Rays) -> np.ndarray:
    """Path lengths of rays beside those that were traced, with the same main directions, to first order.

    Parameters
    ----------
    paths : ndarray, shape (materials, views, rows, columns)
        Of the rays traced, mm.
    slopes : ndarray, shape (materials, views, bundles, rows, coordinates)
        Of the rays traced, as Voxels.slopes gives them.
    traced, rays : Rays
        The rays traced, and those beside them.

    Returns
    -------
    ndarray, shape (materials, views, rows, columns)
        mm.
    """
    lanes, views, bundles, rows = slopes.shape[:4]
    bundled = paths.reshape(lanes, views, rows, bundles)
    result = np.empty_like(bundled)
    follow(bundled, slopes, traced.bundles, rays.bundles, result)
    return result.reshape(paths.shape)


def outline(geometry: ScanGeometry) -> ScanGeometry:
    """The rays to the detector's corners and the middles of its upper and lower edges.

    How rays are displaced changes little in between.

    Returns
    -------
    ScanGeometry
    """
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
