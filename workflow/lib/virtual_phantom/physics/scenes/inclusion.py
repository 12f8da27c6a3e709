"""Inclusions: shapes inside an object that its scene lacks, with a given excess attenuation."""

from __future__ import annotations

import math
from collections.abc import Hashable

import numpy as np

from ...base.geometry import ScanGeometry
from ...base.lru_cache import LRUCache
from ...base.pose import IN_PLACE, Pose
from ..state import Inclusions
from .scene import scan_key
from .shapes import Shape, ShapesScene

CACHE_BYTES, MAX_CACHED = 1e8, 32  # of path lengths; a finite difference needs two poses


class Inclusion:
    """A shape that moves with the object.

    Parameters
    ----------
    shape : Shape
        Its material is ignored.
    key : hashable
        Equal for inclusions of the same shape.
    """

    def __init__(self, shape: Shape, key: Hashable):
        self.key, self.shape, self._scene = key, shape, ShapesScene([shape])
        self._lengths: LRUCache | None = None

    def lengths_mm(
        self, geometry: ScanGeometry, pose: Pose = IN_PLACE, motion_mm: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the path lengths in the shape, mm, float32, (views, rows, columns); see GridScene.path_lengths."""
        if self._lengths is None:
            self._lengths = LRUCache(int(min(MAX_CACHED, max(2, CACHE_BYTES // (4 * math.prod(geometry.shape))))))
        key = scan_key(geometry, pose, motion_mm)
        return self._lengths.get(key, lambda: self._scene.path_lengths(geometry, pose, motion_mm)[0])


def inclusion_transmission(
    added: Inclusions, geometry: ScanGeometry, pose: Pose, motion_mm: np.ndarray | None
) -> np.ndarray:
    """Return the transmission exp(-sum of excess attenuation times path length), which is the same at all energies."""
    lines = sum(np.float64(excess) * shape.lengths_mm(geometry, pose, motion_mm) for shape, excess in added)
    return np.exp(-np.asarray(lines))
