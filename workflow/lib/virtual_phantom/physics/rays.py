"""Rays in the coordinates of a voxel grid, and how sums along them change with these."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..geometry import Grid, ScanGeometry
from ..projectors.cpu import share_out
from ..projectors.slopes import COORDINATES, trace_slopes


@dataclass(frozen=True)
class Rays:
    """Where every ray of a scan crosses a grid, as projectors/slopes.py counts.

    along_x     (view, column) whether planes across x are stepped through, else those across y
    across      (view, column, 2): padded voxel index along the other in-plane axis in the middle plane, and its change
                from plane to plane
    height      (view, column, row, 2): the same along z
    length_mm   (view, column, row) between two planes
    spacing_mm  of voxels, (z, y, x)
    planes      number of planes across x and across y
    """

    along_x: np.ndarray
    across: np.ndarray
    height: np.ndarray
    length_mm: np.ndarray
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
        dz, dy, dx = grid.spacing
        main, other = np.where(along_x, to_x, to_y), np.where(along_x, to_y, to_x)
        step, step_other = np.where(along_x, dx, dy), np.where(along_x, dy, dx)
        count_other = np.where(along_x, grid.shape[1], grid.shape[2])
        middle = -np.where(along_x, source_x, source_y) / main  # share of the way to the detector
        start_other = np.where(along_x, source_y, source_x)
        across = np.stack(
            [
                (start_other + middle * other) / step_other + (count_other - 1) / 2 + 1,
                other / main * step / step_other,
            ],
            axis=-1,
        )
        v = geometry.row_positions_mm()
        source_z = geometry.source_z_mm[:, None] - z
        height = np.stack(
            [
                (source_z[..., None] + middle[..., None] * v) / dz + (grid.shape[0] - 1) / 2 + 1,
                (step / main)[..., None] * v / dz,
            ],
            axis=-1,
        )
        length = (step / np.abs(main))[..., None] * np.sqrt((to_x**2 + to_y**2)[..., None] + v**2)
        return cls(along_x, across, height, length, grid.spacing, (grid.shape[2], grid.shape[1]))

    def extremes_mm(self) -> np.ndarray:
        """Coordinates in mm, [coordinate, ray]: in the middle of the grid, and what is added at its edge. The sum of
        their changes is how far a ray is displaced anywhere in the grid, at most."""
        dz, dy, dx = self.spacing_mm
        half = (np.where(self.along_x, *self.planes) - 1)[..., None] / 2
        across = self.across * np.where(self.along_x, dy, dx)[..., None]
        height = self.height * dz
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
        """What the sums over planes change per change of the rays' coordinates: [coordinate, material, view, row,
        column], float32, in the order across[..., 0], height[..., 0], across[..., 1], height[..., 1]. A path length is
        the sum times the length between two planes."""
        views, columns, rows = rays.length_mm.shape
        found = np.zeros((len(self._volumes), views, columns, rows, COORDINATES), np.float32)

        def run(first, last):
            part = found[:, first:last]
            trace_slopes(
                self._volumes, self._occupied, part, first, self._shape, rays.along_x, rays.across, rays.height
            )

        share_out(run, views, threads)
        return np.ascontiguousarray(found.transpose(4, 0, 1, 3, 2))


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
