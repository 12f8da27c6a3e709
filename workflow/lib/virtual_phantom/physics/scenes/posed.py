"""A voxel scene for fits, whose path lengths follow small displacements without being traced again.

They follow changes of pose, motion and geometry to first order.
What is followed from where is said, not remembered: path lengths depend on what is asked and on the scans that they may
follow, and on nothing that was asked before. What is kept makes them faster, never different.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from ...base.geometry import ScanGeometry
from ...base.recent import Kept
from .rays import Rays, followed, outline
from .sampling import Divided
from .scene import IN_PLACE, Pose, VoxelScene

# Square of how far any ray may lie from the one that was traced, over the voxel's size, mm: the error grows with the
# square of the one and falls with the other. Here it is under 1 % of the noise of 1e5 photons per pixel.
TOLERANCE_MM = 3e-4
# Of scans that were traced, all rays of a pixel; a focal spot takes nine.
MEMORY_BYTES, LEAST_KEPT, MOST_KEPT = 4e8, 10, 32

Scan = tuple[ScanGeometry | Divided, Pose, np.ndarray | None]  # geometry, pose, motion_mm


class Traced:
    """Path lengths of one scan, and what a displacement of its rays changes.

    Parameters
    ----------
    scene : VoxelScene
        Or what has its methods.
    pose : Pose
        Of the object.
    motion_mm : ndarray, shape (views, 3), or None
        As VoxelScene.path_lengths takes it.
    """

    def __init__(self, scene: VoxelScene, geometry: ScanGeometry, pose: Pose, motion_mm: np.ndarray | None):
        self.scene, self.shape, self._scan = scene, geometry.shape, (geometry, pose, motion_mm)
        self.edge = scene.rays(outline(geometry), pose, motion_mm)
        self.edge_mm = self.edge.extremes_mm()
        self.paths = scene.path_lengths(geometry, pose, motion_mm)

    @cached_property
    def _rays(self) -> Rays:
        return self.scene.rays(*self._scan)

    @cached_property
    def _slopes(self) -> np.ndarray:
        return self.scene.slopes(self._rays)

    def followed(self, geometry: ScanGeometry, pose: Pose, motion_mm: np.ndarray | None) -> np.ndarray:
        """Path lengths of rays nearby, as VoxelScene.path_lengths gives them."""
        rays = self.scene.rays(geometry, pose, motion_mm, self._rays.bundles.along_x)
        return followed(self.paths, self._slopes, self._rays, rays)


class PosedScene:
    """A VoxelScene that keeps the scans that were traced last.

    Parameters
    ----------
    scene : VoxelScene
        Or what has its methods.
    samples : int, optional
        Rays per pixel and direction of the chain that asks: each is a scan of its own.
    """

    def __init__(self, scene: VoxelScene, samples: int = 1):
        self.scene, self._samples = scene, samples
        self.materials, self.energy_kev, self.threads = scene.materials, scene.energy_kev, scene.threads
        self.attenuation_per_mm = scene.attenuation_per_mm
        self.allowed_mm = float(np.sqrt(TOLERANCE_MM * min(scene.grid.spacing)))
        self._kept: Kept | None = None

    @property
    def radius_mm(self) -> float:
        """As VoxelScene.radius_mm."""
        return self.scene.radius_mm

    def path_lengths(self, geometry: ScanGeometry, pose: Pose = IN_PLACE, motion_mm: np.ndarray | None = None):
        """As VoxelScene.path_lengths."""
        return self.traced(geometry, pose, motion_mm).paths

    def traced(self, geometry: ScanGeometry, pose: Pose = IN_PLACE, motion_mm: np.ndarray | None = None) -> Traced:
        """A scan, traced now or lately."""
        if self._kept is None:
            self._kept = Kept(self._most(geometry))
        key = geometry.key, pose, None if motion_mm is None else motion_mm.tobytes()
        return self._kept.get(key, lambda: Traced(self.scene, geometry, pose, motion_mm))

    def near(self, scans: Sequence[Scan], reach: float = 1.0) -> NearScene:
        """The scene whose scans follow the nearest of these, where it is near enough: `reach` times as far as usual."""
        return NearScene(self, [self.traced(*scan) for scan in scans], reach)

    def _most(self, geometry: ScanGeometry | Divided) -> int:
        """How many scans are kept, each of as many rays as are asked for at once."""
        pixels = geometry.whole if isinstance(geometry, Divided) else geometry
        rays = np.prod(pixels.shape) * self._samples ** (2 if pixels.rows > 1 else 1)
        size = 4 * len(self.materials) * rays * 5  # path lengths, four slopes
        return int(np.clip(MEMORY_BYTES / size, LEAST_KEPT, MOST_KEPT) * -(-rays // np.prod(geometry.shape)))


class NearScene:
    """As VoxelScene: scans near one of those given take its path lengths and slopes, others are traced.

    Parameters
    ----------
    scene : PosedScene
        Which traces the others.
    given : sequence of Traced
        Those that may be followed.
    reach : float, optional
        Times as far as usual that they may be followed.
    """

    def __init__(self, scene: PosedScene, given: Sequence[Traced], reach: float = 1.0):
        self._scene, self._given = scene, tuple(given)
        self._allowed_mm = reach * scene.allowed_mm
        self.materials, self.energy_kev, self.threads = scene.materials, scene.energy_kev, scene.threads
        self.attenuation_per_mm = scene.attenuation_per_mm

    def path_lengths(self, geometry: ScanGeometry, pose: Pose = IN_PLACE, motion_mm: np.ndarray | None = None):
        """As VoxelScene.path_lengths."""
        edge = self._scene.scene.rays(outline(geometry), pose, motion_mm)
        nearest, displaced_mm = self._nearest(geometry, edge)
        if nearest is None:
            return self._scene.path_lengths(geometry, pose, motion_mm)
        if displaced_mm == 0 and np.array_equal(nearest.edge.rises_mm, edge.rises_mm):
            return nearest.paths
        return nearest.followed(geometry, pose, motion_mm)

    def follows(self, scan: Scan) -> bool:
        """Whether a scan is near enough to one of those given."""
        return self._nearest(scan[0], self._scene.scene.rays(outline(scan[0]), *scan[1:]))[0] is not None

    def _nearest(self, geometry: ScanGeometry, edge: Rays) -> tuple[Traced | None, float]:
        """The scan that is near enough, the first of the nearest, and how far any ray is displaced from it."""
        edge_mm = edge.extremes_mm()
        same = [one for one in self._given if one.shape == geometry.shape]
        displaced = [float(np.abs(edge_mm - one.edge_mm).sum(axis=0).max()) for one in same]
        least = min(displaced, default=np.inf)
        return (same[displaced.index(least)], least) if least <= self._allowed_mm else (None, least)
