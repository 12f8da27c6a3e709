"""A homogeneous object that is alike along z: path lengths from one slice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numba import njit

from ..base.geometry import Grid, ScanGeometry
from .materials import attenuation_per_mm
from .rays import Rays, Voxels
from .scene import DISC_ENERGY_KEV, IN_PLACE, Pose, turned_back


class PrismScene:
    """An object of one material, longer than the beam is high: what DiscScene is, for any outline.

    share   [y, x], the share of every pixel that it fills, the slice's centre at the isocentre
    grid    of the slice, (1, y, x)
    """

    def __init__(self, share: np.ndarray, grid: Grid, material: str):
        self.materials, self.energy_kev, self.grid = (material,), DISC_ENERGY_KEV, grid
        occupied = np.argwhere(share > 0)
        low, high = occupied.min(axis=0), occupied.max(axis=0) + 1
        # One pixel of nothing around it, so that interpolation needs no edge cases.
        self._share = np.pad(share[low[0] : high[0], low[1] : high[1]].astype(np.float32), 1)
        self._voxels: Voxels | None = None
        self._turned = np.ascontiguousarray(self._share.T)
        self._origin = (np.array(share.shape) - 1) / 2 - low + 1  # pixel (y, x) of the isocentre in it

    @property
    def attenuation_per_mm(self) -> np.ndarray:
        """At the monochromatic energy, (1,)."""
        return np.array([attenuation_per_mm(self.materials[0], [self.energy_kev])[0]])

    def path_lengths(self, geometry: ScanGeometry, pose: Pose = IN_PLACE, motion_mm: np.ndarray | None = None):
        """As VoxelScene.path_lengths; shifts along z change nothing."""
        angles = geometry.angles_rad
        place = np.zeros((angles.size, 2)) if motion_mm is None else motion_mm[:, :2]
        place = place + [pose.x_mm, pose.y_mm]
        radius, distance = geometry.source_to_isocentre_mm, geometry.source_to_detector_mm
        u = geometry.column_positions_mm()
        sine, cosine = np.sin(angles), np.cos(angles)
        source = np.stack([-radius * sine, radius * cosine], axis=1) - place
        # From the source to the detector's pixels, [view, column, (x, y)].
        away = np.stack([distance * sine, -distance * cosine], axis=1)[:, None]
        away = away + u[:, None] * np.stack([cosine, sine], axis=1)[:, None]
        turn = np.deg2rad(pose.turn_deg)
        back = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        spacing = np.array(self.grid.spacing[:0:-1])
        pixels = source @ back.T / (pose.size * spacing) + self._origin[::-1]
        lengths = np.empty((angles.size, u.size))
        _trace(self._share, self._turned, pixels, away @ back.T / spacing, spacing, lengths)
        climb = np.sqrt(1 + (geometry.row_positions_mm()[:, None] / np.hypot(distance, u)) ** 2)
        return (pose.size * lengths[:, None, :] * climb).astype(np.float32)[None]

    def rays(
        self,
        geometry: ScanGeometry,
        pose: Pose = IN_PLACE,
        motion_mm: np.ndarray | None = None,
        along_x: np.ndarray | None = None,
    ) -> Rays:
        """As VoxelScene.rays; all of them lie in the slice's plane."""
        geometry, shift = turned_back(geometry, pose, motion_mm)
        _, dy, dx = self.grid.spacing
        ny, nx = self._share.shape
        grid = Grid((1, ny, nx), (1.0, pose.size * dy, pose.size * dx))
        y, x = ((count - 1) / 2 - at for count, at in zip((ny, nx), self._origin, strict=True))
        rays = Rays.of(geometry, grid, pose.size * np.array([x * dx, y * dy, 0.0]) + shift, along_x)
        return replace(rays, level=np.ones_like(rays.level), climb=np.zeros_like(rays.climb))

    def slopes(self, rays: Rays) -> np.ndarray:
        """As Voxels.slopes."""
        if self._voxels is None:
            self._voxels = Voxels(self._share[None, None])
        return self._voxels.slopes(rays)


@njit(nogil=True, cache=True, fastmath=True, error_model="numpy")
def _trace(share, turned, sources, directions, spacing, lengths):
    """Joseph's method in the plane: through the pixel columns or rows across a ray's main direction."""
    for view in range(lengths.shape[0]):
        for column in range(lengths.shape[1]):
            dx, dy = directions[view, column]
            x, y = sources[view]
            if abs(dx) >= abs(dy):
                slope = dy / dx
                total = _line(turned, y - x * slope, slope)
                lengths[view, column] = total * np.sqrt(spacing[0] ** 2 + (slope * spacing[1]) ** 2)
            else:
                slope = dx / dy
                total = _line(share, x - y * slope, slope)
                lengths[view, column] = total * np.sqrt(spacing[1] ** 2 + (slope * spacing[0]) ** 2)


@njit(nogil=True, cache=True, fastmath=True, error_model="numpy")
def _line(image, start, slope):
    """Sum over planes of the image interpolated at start + slope * plane."""
    planes, across = image.shape
    first, last = 0, planes
    if slope != 0:
        one, other = -start / slope, (across - 1 - start) / slope
        first = max(0, int(np.ceil(min(one, other))))
        last = min(planes, int(np.floor(max(one, other))) + 1)
    elif start < 0 or start > across - 1:
        return 0.0
    total = 0.0
    for plane in range(first, last):
        position = start + slope * plane
        low = min(max(int(position), 0), across - 2)
        part = position - low
        total += (1 - part) * image[plane, low] + part * image[plane, low + 1]
    return total
