"""An object that is alike along z: path lengths from one slice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...base.geometry import Grid, ScanGeometry
from ..beam.materials import Material, attenuation_per_mm
from .rays import Rays, Voxels
from .scene import DISC_ENERGY_KEV, IN_PLACE, Pose, reach_mm, turned_back


class PrismScene:
    """An object longer than the beam is high: what DiscScene is, for any outline and several materials.

    Parameters
    ----------
    shares : ndarray, shape (materials, y, x)
        Share of every pixel that each material fills, the slice's centre at the isocentre.
    grid : Grid
        Of the slice, (1, y, x).
    materials : tuple of str or Mixture
        Of materials.COMPOUNDS or ELEMENTS, or of their own.
    energy_kev : float, optional
        Of the monochromatic beam, keV.
    """

    threads = 1

    def __init__(
        self, shares: np.ndarray, grid: Grid, materials: tuple[Material, ...], energy_kev: float = DISC_ENERGY_KEV
    ):
        self.materials, self.energy_kev, self.grid = materials, energy_kev, grid
        occupied = np.argwhere((shares > 0).any(axis=0))
        low, high = occupied.min(axis=0), occupied.max(axis=0) + 1
        self._voxels = Voxels(shares[:, None, low[0] : high[0], low[1] : high[1]])
        _, dy, dx = grid.spacing
        y, x = (low + high - np.array(shares.shape[1:])) / 2 * (dy, dx)
        # Of the part that holds anything; the slice is as high as it needs to be.
        self._part, self._centre = Grid((1, *(high - low)), (1.0, dy, dx)), np.array([x, y, 0.0])

    @property
    def radius_mm(self) -> float:
        """How far it reaches from the z axis at most, mm."""
        return reach_mm(self._part, self._centre)

    @property
    def attenuation_per_mm(self) -> np.ndarray:
        """Of each material at the monochromatic energy, 1/mm, shape (materials,)."""
        return np.array([attenuation_per_mm(material, [self.energy_kev])[0] for material in self.materials])

    def path_lengths(self, geometry: ScanGeometry, pose: Pose = IN_PLACE, motion_mm: np.ndarray | None = None):
        """As VoxelScene.path_lengths; shifts along z change nothing."""
        rays = self.rays(geometry, pose, motion_mm)
        return self._voxels.path_lengths(rays).reshape(-1, *geometry.shape)

    def rays(
        self,
        geometry: ScanGeometry,
        pose: Pose = IN_PLACE,
        motion_mm: np.ndarray | None = None,
        along_x: np.ndarray | None = None,
    ) -> Rays:
        """As VoxelScene.rays; all of them lie in the slice's plane."""
        geometry, shift = turned_back(geometry, pose, motion_mm)
        dz, dy, dx = self._part.spacing
        part = replace(self._part, spacing=(dz, pose.size * dy, pose.size * dx))
        rays = Rays.of(geometry, part, pose.size * self._centre + shift, along_x)
        level, climb = np.ones_like(rays.bundles.level), np.zeros_like(rays.bundles.climb)
        return replace(rays, bundles=rays.bundles._replace(level=level, climb=climb))

    @property
    def whole_voxels(self) -> bool:
        """As Voxels.whole."""
        return self._voxels.whole

    def slopes(self, rays: Rays) -> np.ndarray:
        """As Voxels.slopes."""
        return self._voxels.slopes(rays)
