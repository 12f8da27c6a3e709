"""Objects that do not change along z: path lengths from one slice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...base.geometry import Grid, ScanGeometry
from ...base.pose import IN_PLACE, Pose, turned_back
from ..beam.materials import Material
from .rays import Rays
from .scene import DISC_ENERGY_KEV, GridScene


class PrismScene(GridScene):
    """A prism that is longer than the beam is high, with any cross-section and several materials.

    Parameters
    ----------
    shares : ndarray, shape (materials, y, x)
        Share of every pixel of the cross-section that each material fills.
    grid : Grid
        Grid of the cross-section, (1, y, x), with its center at the isocenter.
    materials, energy_kev
        As in Scene.
    """

    def __init__(
        self, shares: np.ndarray, grid: Grid, materials: tuple[Material, ...], energy_kev: float = DISC_ENERGY_KEV
    ):
        super().__init__(shares[:, None], grid, materials, energy_kev)

    def rays(self, geometry: ScanGeometry, pose: Pose = IN_PLACE, motion_mm=None, along_x=None) -> Rays:
        """As VoxelScene.rays, projected onto the plane of the slice: shifts along z have no effect."""
        geometry, shift = turned_back(geometry, pose, motion_mm)
        _, dy, dx = self.grid.spacing
        grid = replace(self.grid, spacing=(1.0, pose.size * dy, pose.size * dx))
        rays = Rays.of(geometry, grid, pose.size * self._center + shift, along_x)
        level, climb = np.ones_like(rays.bundles.level), np.zeros_like(rays.bundles.climb)
        return replace(rays, bundles=rays.bundles._replace(level=level, climb=climb))
