"""A voxel scene for fits: path lengths follow small changes of the pose to first order, without tracing rays again."""

from __future__ import annotations

from dataclasses import astuple, fields, replace

import numpy as np

from ..geometry import ScanGeometry
from ..kept import Kept
from .scene import IN_PLACE, Pose, VoxelScene

# Square of how far any point may lie from the pose that was traced, over the voxel's size, mm: the error grows with the
# square of the one and falls with the other. Here it is under 1 % of the noise of 1e5 photons per pixel.
TOLERANCE_MM = 3e-4
ANCHORS, TRACES = 3, 16
NAMES = tuple(field.name for field in fields(Pose))


class PosedScene:
    """As VoxelScene. Poses near one that was traced take its path lengths and their derivatives.

    Derivatives are central differences over the tolerance; those of one geometry serve all of the same shape, since
    effects move rays by far less than the object is large.
    """

    def __init__(self, scene: VoxelScene):
        self.scene = scene
        self.materials, self.energy_kev = scene.materials, scene.energy_kev
        self.attenuation_per_mm = scene.attenuation_per_mm
        reach = float(np.linalg.norm(scene.grid.extent_mm[1:])) / 2
        allowed = float(np.sqrt(TOLERANCE_MM * min(scene.grid.spacing)))
        # What moves a point of the object by the tolerance, in each of the pose's numbers.
        self._unit = np.array(
            [{"turn_deg": np.rad2deg(allowed / reach), "size": allowed / reach}.get(name, allowed) for name in NAMES]
        )
        self._anchors: list[Pose] = []
        self._traces, self._slopes = Kept(TRACES), Kept(ANCHORS * len(NAMES))

    def path_lengths(self, geometry: ScanGeometry, pose: Pose = IN_PLACE, motion_mm: np.ndarray | None = None):
        """As VoxelScene.path_lengths."""
        anchor = self._anchor(pose)
        key = (anchor, geometry.key, None if motion_mm is None else motion_mm.tobytes())
        paths = self._traces.get(key, lambda: self.scene.path_lengths(geometry, anchor, motion_mm))
        steps = (np.array(astuple(pose)) - astuple(anchor)) / self._unit
        for name, step in zip(NAMES, steps, strict=True):
            if step:
                paths = paths + np.float32(step) * self._slope(geometry, anchor, name)
        return paths

    def _anchor(self, pose: Pose) -> Pose:
        def distance(anchor):
            return float(np.abs((np.array(astuple(pose)) - astuple(anchor)) / self._unit).sum())

        nearest = min(self._anchors, key=distance, default=None)
        if nearest is None or distance(nearest) > 1:
            nearest = pose
            self._anchors = [*self._anchors[1 - ANCHORS :], pose]
        return nearest

    def _slope(self, geometry: ScanGeometry, anchor: Pose, name: str) -> np.ndarray:
        """Change of the path lengths per tolerance of one number of the pose."""
        unit = float(self._unit[NAMES.index(name)])

        def make():
            moved = (replace(anchor, **{name: getattr(anchor, name) + sign * unit}) for sign in (1, -1))
            more, less = (self.scene.path_lengths(geometry, pose) for pose in moved)
            return (more - less) / 2

        return self._slopes.get((anchor, name, geometry.shape), make)
