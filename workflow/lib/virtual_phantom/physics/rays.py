"""Rays in the coordinates of a voxel grid, and how sums along them change with these."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..base.geometry import Grid, ScanGeometry
from ..projectors.cpu import share_out
from ..projectors.slopes import COORDINATES, follow, trace_slopes


@dataclass(frozen=True)
class Rays:
    """Where every ray of a scan crosses a grid, as projectors/slopes.py counts.

    along_x     (view, column) whether planes across x are stepped through, else those across y
    across      (view, column, 2): padded voxel index along the other in-plane axis in the middle plane, and its change
                from plane to plane
    level       (view,) padded voxel index of the source along z
    climb       (view, column, 2): change along z per mm of a row's position, to the middle plane, and from plane to
                plane
    rows_mm     (row,) from the source's height
    between     (view, column, 2): share of the way to the detector between two planes, and the square of that way in
                the plane, mm^2
    spacing_mm  of voxels, (z, y, x)
    planes      number of planes across x and across y
    """

    along_x: np.ndarray
    across: np.ndarray
    level: np.ndarray
    climb: np.ndarray
    rows_mm: np.ndarray
    between: np.ndarray
    spacing_mm: tuple[float, float, float]
    planes: tuple[int, int]

    @classmethod
    def of(cls, geometry: ScanGeometry, grid: Grid, centre_mm: np.ndarray, along_x: np.ndarray | None = None) -> Rays:
        """Rays of a scan of a grid.

        centre_mm   of the grid from the isocentre, x, y, z: (3,) or (view, 3)
        along_x     the main directions to use; None: of each ray the larger component
        """
        x, y, z = np.broadcast_to(centre_mm, (geometry.views, 3)).T[..., None]
        radius, distance = geometry.source_to_isocentre_mm, geometry.source_to_detector_mm
        sine, cosine = np.sin(geometry.angles_rad)[:, None], np.cos(geometry.angles_rad)[:, None]
        u = geometry.column_positions_mm()
        source_x, source_y = -radius * sine - x, radius * cosine - y
        to_x, to_y = distance * sine + u * cosine, -distance * cosine + u * sine
        if along_x is None:
            along_x = np.abs(to_x) >= np.abs(to_y)
        nz, ny, nx = grid.shape
        dz, dy, dx = grid.spacing
        main, other = np.where(along_x, to_x, to_y), np.where(along_x, to_y, to_x)
        spacing, spacing_other = np.where(along_x, dx, dy), np.where(along_x, dy, dx)
        middle, step = -np.where(along_x, source_x, source_y) / main, spacing / main  # shares of the way
        at_middle = np.where(along_x, source_y, source_x) + middle * other
        index = at_middle / spacing_other + (np.where(along_x, ny, nx) - 1) / 2 + 1
        return cls(
            along_x=along_x,
            across=np.stack([index, step * other / spacing_other], axis=-1),
            level=(geometry.source_z_mm - z[:, 0]) / dz + (nz - 1) / 2 + 1,
            climb=np.stack([middle, step], axis=-1) / dz,
            rows_mm=geometry.row_positions_mm(),
            between=np.stack([np.abs(step), to_x**2 + to_y**2], axis=-1),
            spacing_mm=grid.spacing,
            planes=(nx, ny),
        )

    @property
    def coordinates(self) -> tuple[np.ndarray, ...]:
        """As the kernels take them."""
        return self.across, self.level, self.climb, self.rows_mm

    @property
    def lengths_mm(self) -> np.ndarray:
        """Of every ray between two planes, [view, row, column]."""
        share, square = np.moveaxis(self.between, 2, 0)[:, :, None]
        return share * np.sqrt(square + self.rows_mm[:, None] ** 2)

    def extremes_mm(self) -> np.ndarray:
        """Coordinates in mm, [coordinate, ray]: in the middle of the grid, and what is added at its edge. The sum of
        their changes is how far a ray is displaced anywhere in the grid, at most."""
        dz, dy, dx = self.spacing_mm
        half = (np.where(self.along_x, *self.planes) - 1)[..., None] / 2
        across = self.across * np.where(self.along_x, dy, dx)[..., None]
        height = self.climb[:, :, None] * self.rows_mm[:, None] * dz
        height[..., 0] += self.level[:, None, None] * dz
        across, height = (
            np.concatenate([one[..., :1], one[..., 1:] * edge], axis=-1)
            for one, edge in ((across, half), (height, half[..., None]))
        )
        across = np.broadcast_to(across[:, :, None], height.shape)
        return np.concatenate([across, height], axis=-1).reshape(-1, 4).T


class Voxels:
    """Amounts of materials on a grid, [material, z, y, x], and how sums along rays change with the rays."""

    def __init__(self, amounts: np.ndarray):
        self._shape = amounts.shape[1:]
        around = np.pad(amounts.transpose(0, 2, 3, 1), ((0, 0), (1, 1), (1, 1), (1, 1))).astype(np.float32)
        flat = (len(amounts), -1)
        self._volumes, self._occupied = around.reshape(flat), (around != 0).any(axis=3).reshape(flat)

    def slopes(self, rays: Rays, threads: int = 1) -> np.ndarray:
        """What the sums over planes change per change of the rays' coordinates: [material, view, column, row,
        coordinate], float32, as projectors/slopes.py has them. A path length is the sum times the length between two
        planes."""
        views, columns = rays.along_x.shape
        found = np.zeros((len(self._volumes), views, columns, rays.rows_mm.size, COORDINATES), np.float32)

        def run(first, last):
            part = found[:, first:last]
            trace_slopes(self._volumes, self._occupied, part, first, self._shape, rays.along_x, *rays.coordinates)

        share_out(run, views, threads)
        return found


def followed(paths: np.ndarray, slopes: np.ndarray, traced: Rays, rays: Rays) -> np.ndarray:
    """Path lengths [material, view, row, column] of rays beside those that were traced, with the same main directions,
    to first order.

    paths, slopes   of the rays traced; slopes as Voxels.slopes gives them
    """
    result = np.empty_like(paths)
    follow(paths, slopes, traced.coordinates, traced.between, rays.coordinates, rays.between, result)
    return result


def outline(geometry: ScanGeometry) -> ScanGeometry:
    """The rays to the detector's corners and the middles of its upper and lower edges: how rays are displaced changes
    little in between."""
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
