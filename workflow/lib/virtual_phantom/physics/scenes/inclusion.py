"""What lies in an object beside what its scene has: a shape that attenuates more or less by a known amount."""

from __future__ import annotations

import math
from collections.abc import Hashable

import numpy as np

from ...base.geometry import ScanGeometry
from ...base.recent import Kept
from ..state import Added
from .scene import IN_PLACE, Pose
from .shapes import Shape, ShapesScene

KEPT_BYTES, MOST_KEPT = 1e8, 32  # of path lengths; a slope asks for those of two places of the object


class Inclusion:
    """A shape in an object, moving with it.

    Parameters
    ----------
    shape : Shape
        Its material does not count.
    key : hashable
        Equal for inclusions of the same shape.
    """

    def __init__(self, shape: Shape, key: Hashable):
        self.key, self._scene = key, ShapesScene([shape])
        self._lengths: Kept | None = None

    def lengths_mm(
        self, geometry: ScanGeometry, pose: Pose = IN_PLACE, motion_mm: np.ndarray | None = None
    ) -> np.ndarray:
        """Path lengths of rays in it.

        Parameters
        ----------
        geometry : ScanGeometry
            Or the rays of its pixels, as `sampling.divided` gives them.
        pose : Pose, optional
            Of the object.
        motion_mm : ndarray, shape (views, 3), optional
            As State.motion_mm.

        Returns
        -------
        ndarray of float32, shape (views, rows, columns)
        """
        if self._lengths is None:
            self._lengths = Kept(int(min(MOST_KEPT, max(2, KEPT_BYTES // (4 * math.prod(geometry.shape))))))
        rays = (geometry.key, pose, None if motion_mm is None else motion_mm.tobytes())
        return self._lengths.get(rays, lambda: self._scene.path_lengths(geometry, pose, motion_mm)[0])


def thinned(added: Added, geometry: ScanGeometry, pose: Pose, motion_mm: np.ndarray | None) -> np.ndarray:
    """What inclusions leave of the signal of each ray, at all energies alike.

    Parameters
    ----------
    geometry, pose, motion_mm
        As Inclusion.lengths_mm takes them.

    Returns
    -------
    ndarray, shape (views, rows, columns)
    """
    lines = sum(np.float64(more) * one.lengths_mm(geometry, pose, motion_mm) for one, more in added)
    return np.exp(-np.asarray(lines))
