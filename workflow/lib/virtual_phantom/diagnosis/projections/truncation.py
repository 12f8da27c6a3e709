"""Rays that leave a volume through its ends where the object goes on: the model has air there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...base.geometry import ScanGeometry
from ...physics.scenes.scene import VoxelScene

MOST_VIEWS = 24  # that are looked at: rays pass the ends in many
# Line integral that is missing, from which on a ray counts, and share of such rays that is worth a remark.
LEAST_MISSING, MENTIONED = 0.005, 0.001


@dataclass(frozen=True)
class Beyond:
    """What lies beyond the ends of a volume.

    Attributes
    ----------
    share : float
        Of the rays that lack something.
    most : float
        Line integral that one of them lacks, if the object goes on like its last slice.
    height_mm : float
        By how much rays leave the volume on one side at most, where it cuts the object, mm.
    """

    share: float
    most: float
    height_mm: float

    @property
    def words(self) -> list[str]:
        """A sentence for the report; none where hardly a ray is concerned."""
        if self.share <= MENTIONED:
            return []
        return [
            f"{100 * self.share:.2g} % of the rays leave the volume through its first or last slice, where it cuts the "
            f"object. If it goes on like there, they lack a line integral of up to {self.most:.2g}, which no "
            f"effect is: give a volume that is {self.height_mm:.2g} mm longer on each side along z, or fewer rows."
        ]


def beyond(scene: object, geometry: ScanGeometry) -> Beyond:
    """What rays of a scan miss of an object that its volume cuts along z.

    Parameters
    ----------
    scene : VoxelScene
        Or what has its methods; shapes, discs and prisms have no such ends.
    """
    scene = getattr(scene, "scene", scene)  # that of PosedScene
    if not isinstance(scene, VoxelScene):
        return Beyond(0.0, 0.0, 0.0)
    geometry = geometry.every(max(1, geometry.views // MOST_VIEWS))
    missing, height_mm = np.zeros(geometry.shape), 0.0
    for end, passed_mm in zip((-1, 1), _passed_mm(scene, geometry), strict=True):
        more = scene.beyond(end, passed_mm) if passed_mm > 0 else None
        if more is not None:
            missing += np.tensordot(more.attenuation_per_mm, more.path_lengths(geometry), axes=1)
            height_mm = max(height_mm, passed_mm)
    return Beyond(float(np.mean(missing > LEAST_MISSING)), float(missing.max()), height_mm)


def _passed_mm(scene: VoxelScene, geometry: ScanGeometry) -> tuple[float, float]:
    """How far rays run below and above a scene's ends within its reach from the axis, mm."""
    low, high = scene.ends_mm
    x, y, z = geometry.source_mm.T[..., None]
    (to_x, to_y, to_z), rows = geometry.bundles()
    along = np.sqrt(to_x**2 + to_y**2)
    # In the plane: where a ray passes the axis nearest, and how much longer it stays within reach.
    nearest = -(x * to_x + y * to_y) / along
    off = (x * to_y - y * to_x) / along
    half = np.sqrt(np.maximum(scene.radius_mm**2 - off**2, 0))
    climb = (to_z[:, None] + rows[:, None]) / along[:, None]
    heights = [z[:, None] + climb * (nearest + side * half)[:, None] for side in (-1, 1)]
    seen = np.broadcast_to((half > 0)[:, None], heights[0].shape)
    return (
        float(max(low - min(np.min(one, where=seen, initial=np.inf) for one in heights), 0.0)),
        float(max(max(np.max(one, where=seen, initial=-np.inf) for one in heights) - high, 0.0)),
    )
