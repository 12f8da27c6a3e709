"""Voxel scenes for fits: path lengths that are linearized for small displacements of rays.

Path lengths are linear in changes of pose, motion and geometry around reference scans, which the caller gives. They
depend only on the scan and on these references, never on earlier calls: caches change the speed, not the result.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from ...base.geometry import ScanGeometry
from ...base.lru_cache import LRUCache
from ...base.pose import IN_PLACE, Pose
from .rays import Rays, corner_rays, extrapolate_path_lengths, slopes_by_pixel
from .sampling import SupersampledScan
from .scene import VoxelScene, scan_key

# Linear range: (largest displacement of a ray)^2 / voxel size, mm. The error grows with the square of the displacement
# and falls with the voxel size. At this limit it is below 1 % of the noise of 1e5 photons per pixel.
TOLERANCE_MM = 3e-4
# Cache of traced scans, counted with all rays of a pixel; a focal spot takes four scans or more.
CACHE_BYTES, MIN_CACHED, MAX_CACHED = 4e8, 10, 160

PosedScan = tuple[ScanGeometry | SupersampledScan, Pose, np.ndarray | None]  # geometry, pose, motion_mm


class TracedScan:
    """Path lengths of one scan and their derivatives with respect to displacements of its rays.

    Parameters
    ----------
    scene : VoxelScene
        Or another GridScene.
    geometry, pose, motion_mm
        As GridScene.path_lengths takes them.
    """

    def __init__(self, scene: VoxelScene, geometry: ScanGeometry, pose: Pose, motion_mm: np.ndarray | None):
        self.scene, self.shape, self._scan = scene, geometry.shape, (geometry, pose, motion_mm)
        self.is_upright = geometry.is_upright
        self.edge = scene.rays(corner_rays(geometry), pose, motion_mm)
        self.edge_mm = self.edge.extremes_mm()
        self.paths = scene.path_lengths(geometry, pose, motion_mm)

    @cached_property
    def _rays(self) -> Rays:
        return self.scene.rays(*self._scan)

    @cached_property
    def _slopes(self) -> np.ndarray:
        return self.scene.slopes(self._rays)

    def extrapolate(self, geometry: ScanGeometry, pose: Pose, motion_mm: np.ndarray | None) -> np.ndarray:
        """Return the linearized path lengths of a nearby scan, as GridScene.path_lengths."""
        traced, slopes = self._rays, self._slopes
        if self.is_upright and not geometry.is_upright:
            traced, slopes = traced.by_pixel(), slopes_by_pixel(slopes)
        rays = self.scene.rays(geometry, pose, motion_mm, traced.bundles.along_x)
        return extrapolate_path_lengths(self.paths, slopes, traced, rays)


class PosedScene:
    """A scene on a grid that caches traced scans.

    Parameters
    ----------
    scene : VoxelScene
        Or another GridScene.
    samples : int, optional
        Rays per pixel and direction in the chain, for the size of the cache.
    """

    def __init__(self, scene: VoxelScene, samples: int = 1):
        self.scene, self._samples = scene, samples
        self.materials, self.energy_kev, self.threads = scene.materials, scene.energy_kev, scene.threads
        self.attenuation_per_mm, self.radius_mm = scene.attenuation_per_mm, scene.radius_mm
        self.range_mm = float(np.sqrt(TOLERANCE_MM * min(scene.grid.spacing)))
        self._traced: LRUCache | None = None

    def path_lengths(self, geometry: ScanGeometry, pose: Pose = IN_PLACE, motion_mm: np.ndarray | None = None):
        """As GridScene.path_lengths."""
        return self.trace(geometry, pose, motion_mm).paths

    def trace(self, geometry: ScanGeometry, pose: Pose = IN_PLACE, motion_mm: np.ndarray | None = None) -> TracedScan:
        """Return a traced scan, from the cache if it is there."""
        if self._traced is None:
            self._traced = LRUCache(self._cache_length(geometry))
        key = scan_key(geometry, pose, motion_mm)
        return self._traced.get(key, lambda: TracedScan(self.scene, geometry, pose, motion_mm))

    def linearized_at(self, scans: Sequence[PosedScan], reach: float = 1.0) -> LinearizedScene:
        """Return a scene that is linearized around the given scans, with a linear range multiplied by `reach`."""
        return LinearizedScene(self, [self.trace(*scan) for scan in scans], reach)

    def _cache_length(self, geometry: ScanGeometry | SupersampledScan) -> int:
        """Return how many scans are cached; `geometry` may hold only some of the rays of each pixel."""
        pixels = geometry.pixel_scan if isinstance(geometry, SupersampledScan) else geometry
        rays = np.prod(pixels.shape) * self._samples ** (2 if pixels.rows > 1 else 1)
        size = 4 * len(self.materials) * rays * 5  # float32 path lengths, and four slopes
        return int(np.clip(CACHE_BYTES / size, MIN_CACHED, MAX_CACHED) * -(-rays // np.prod(geometry.shape)))


class LinearizedScene:
    """A scene whose path lengths are linearized around reference scans; scans out of the linear range are traced.

    Parameters
    ----------
    scene : PosedScene
        Traces the other scans.
    reach : float, optional
        Factor by which the linear range is extended.
    """

    def __init__(self, scene: PosedScene, references: Sequence[TracedScan], reach: float = 1.0):
        self._scene, self._references = scene, tuple(references)
        self._range_mm = reach * scene.range_mm
        self.materials, self.energy_kev, self.threads = scene.materials, scene.energy_kev, scene.threads
        self.attenuation_per_mm = scene.attenuation_per_mm

    def path_lengths(self, geometry: ScanGeometry, pose: Pose = IN_PLACE, motion_mm: np.ndarray | None = None):
        """As GridScene.path_lengths."""
        edge = self._scene.scene.rays(corner_rays(geometry), pose, motion_mm)
        nearest, displacement_mm = self._nearest(geometry, edge)
        if nearest is None:
            return self._scene.path_lengths(geometry, pose, motion_mm)
        if displacement_mm == 0 and np.array_equal(nearest.edge.rises_mm, edge.rises_mm):
            return nearest.paths
        return nearest.extrapolate(geometry, pose, motion_mm)

    def in_linear_range(self, scan: PosedScan) -> bool:
        """Whether a scan is in the linear range of a reference scan."""
        return self._nearest(scan[0], self._scene.scene.rays(corner_rays(scan[0]), *scan[1:]))[0] is not None

    def _nearest(self, geometry: ScanGeometry, edge: Rays) -> tuple[TracedScan | None, float]:
        """Return the nearest reference in range (the first of equally near ones), and its largest ray displacement."""
        edge_mm = edge.extremes_mm()
        same = [
            reference
            for reference in self._references
            if reference.shape == geometry.shape and (reference.is_upright or not geometry.is_upright)
        ]
        displacements = [float(np.abs(edge_mm - reference.edge_mm).sum(axis=0).max()) for reference in same]
        least = min(displacements, default=np.inf)
        return (same[displacements.index(least)], least) if least <= self._range_mm else (None, least)
