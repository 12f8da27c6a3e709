"""A voxel scene for fits, whose path lengths follow small displacements without being traced again.

They follow changes of pose, motion and geometry to first order.
"""

from __future__ import annotations

import numpy as np

from ..base.geometry import ScanGeometry
from .rays import Rays, followed, outline
from .scene import IN_PLACE, Pose, VoxelScene

# Square of how far any ray may lie from the one that was traced, over the voxel's size, mm: the error grows with the
# square of the one and falls with the other. Here it is under 1 % of the noise of 1e5 photons per pixel.
TOLERANCE_MM = 3e-4
# Of scans that were traced, all rays of a pixel; a focal spot takes nine.
MEMORY_BYTES, LEAST_KEPT, MOST_KEPT = 4e8, 10, 32


class Traced:
    """Path lengths of one set of rays, and what a displacement of the rays changes.

    Parameters
    ----------
    scene : VoxelScene
        Or what has its methods.
    geometry : ScanGeometry
    pose : Pose
        Of the object.
    motion_mm : ndarray, shape (views, 3), or None
        As VoxelScene.path_lengths takes it.
    edge : Rays
        Those of the outline.
    """

    def __init__(self, scene: VoxelScene, geometry: ScanGeometry, pose: Pose, motion_mm, edge: Rays):
        self.scene, self.edge_mm, self.rises_mm = scene, edge.extremes_mm(), edge.rises_mm
        self.shape = geometry.shape
        self._given = geometry, pose, motion_mm
        self._rays: Rays | None = None
        self._slopes: np.ndarray | None = None
        self.paths = scene.path_lengths(geometry, pose, motion_mm)

    def followed(self, geometry: ScanGeometry, pose: Pose, motion_mm: np.ndarray | None) -> np.ndarray:
        """Path lengths of rays nearby, as VoxelScene.path_lengths gives them."""
        if self._rays is None:
            self._rays = self.scene.rays(*self._given)
            self._slopes = self.scene.slopes(self._rays)
        rays = self.scene.rays(geometry, pose, motion_mm, self._rays.bundles.along_x)
        return followed(self.paths, self._slopes, self._rays, rays)


class PosedScene:
    """A VoxelScene in which scans whose rays lie near those of one that was traced take its path lengths and slopes.

    Parameters
    ----------
    scene : VoxelScene
        Or what has its methods.
    samples : int, optional
        Rays per pixel and direction of the chain that asks: each is a scan of its own.
    """

    def __init__(self, scene: VoxelScene, samples: int = 1):
        self.scene, self._samples = scene, samples
        self.materials, self.energy_kev = scene.materials, scene.energy_kev
        self.attenuation_per_mm = scene.attenuation_per_mm
        self._allowed_mm = float(np.sqrt(TOLERANCE_MM * min(scene.grid.spacing)))
        self._traced: list[Traced] = []

    def path_lengths(self, geometry: ScanGeometry, pose: Pose = IN_PLACE, motion_mm: np.ndarray | None = None):
        """As VoxelScene.path_lengths."""
        edge = self.scene.rays(outline(geometry), pose, motion_mm)
        edge_mm = edge.extremes_mm()
        same = [one for one in self._traced if one.shape == geometry.shape]
        displaced = [float(np.abs(edge_mm - one.edge_mm).sum(axis=0).max()) for one in same]
        nearest = min(displaced, default=np.inf)
        if nearest > self._allowed_mm:
            found = Traced(self.scene, geometry, pose, motion_mm, edge)
        else:
            found = same[displaced.index(nearest)]
        # The least recently used goes first.
        self._traced = [*(one for one in self._traced if one is not found), found][-self._most(geometry) :]
        if nearest > self._allowed_mm or (nearest == 0 and np.array_equal(found.rises_mm, edge.rises_mm)):
            return found.paths
        return found.followed(geometry, pose, motion_mm)

    def _most(self, geometry: ScanGeometry) -> int:
        """How many scans of one ray per pixel are kept."""
        rays = self._samples ** (2 if geometry.rows > 1 else 1)
        size = 4 * len(self.materials) * np.prod(geometry.shape) * 5 * rays  # path lengths, four slopes
        return rays * int(np.clip(MEMORY_BYTES / size, LEAST_KEPT, MOST_KEPT))
