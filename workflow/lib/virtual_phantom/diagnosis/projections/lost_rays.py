"""Rays without information: those without signal, and those through the ends of a volume that cuts the object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...base.errors import InputError
from ...base.geometry import ScanGeometry
from ...physics.scenes.scene import VoxelScene
from .observed import LEAST_TRANSMISSION, Scans

LEAST_VIEWS = 16  # fewer do not separate the object's location from physics
MOST_LOST = 0.5  # share of rays without signal
MENTIONED_LOST = 0.001  # share of rays without signal that is reported
MOST_VIEWS = 24  # views that are examined
# Missing line integral from which a ray counts as truncated, and share of truncated rays that is reported.
LEAST_MISSING, MENTIONED = 0.005, 0.001


def check_scans(taken: Scans, source: str) -> None:
    """Check that repeats have enough views and signal for a diagnosis.

    Parameters
    ----------
    source : str
        Start of the message.

    Raises
    ------
    InputError
        For too few views, or most rays without signal.
    """
    views = taken.usable.shape[0]
    if views < LEAST_VIEWS:
        raise InputError(f"{source}: {views} views are too few for a diagnosis; it needs {LEAST_VIEWS}")
    lost = 1 - taken.usable.mean()
    if lost > MOST_LOST:
        compared = "the file holds line integrals" if taken.white is None else "the white field is"
        raise InputError(
            f"{source}: {100 * lost:.0f} % of the rays have no signal (under {LEAST_TRANSMISSION:g} of air) or "
            f"saturate the detector; check that {compared} from this scan and the object not opaque"
        )


def lost_rays_remark(usable: np.ndarray) -> list[str]:
    """Return a remark for the report on ignored rays, as a list; empty if these are few.

    Parameters
    ----------
    usable : ndarray of bool, shape (views, rows, columns)
    """
    lost = 1 - usable.mean()
    if lost <= MENTIONED_LOST:
        return []
    return [f"{100 * lost:.2g} % of the rays have no signal or saturate the detector in some repeat; they are ignored."]


@dataclass(frozen=True)
class Truncation:
    """Truncation of the object by the ends of its volume.

    Attributes
    ----------
    share : float
        Share of truncated rays.
    most : float
        Largest missing line integral, if the object continues like its last slice.
    height_mm : float
        Largest distance along z at which rays leave the volume on one side, mm.
    """

    share: float
    most: float
    height_mm: float

    @property
    def remark(self) -> list[str]:
        """A remark for the report, as a list; empty if few rays are truncated."""
        if self.share <= MENTIONED:
            return []
        return [
            f"{100 * self.share:.2g} % of the rays leave the volume through its first or last slice, which cuts the "
            f"object. Up to {self.most:.2g} of their line integral is missing, which no effect describes: use a volume "
            f"that is {self.height_mm:.2g} mm longer on each side along z, or fewer rows."
        ]


def truncation_of(scene: object, geometry: ScanGeometry) -> Truncation:
    """Return the truncation of a scene along z; only voxel scenes are truncated."""
    scene = getattr(scene, "scene", scene)  # the scene inside a PosedScene
    if not isinstance(scene, VoxelScene):
        return Truncation(0.0, 0.0, 0.0)
    geometry = geometry.every(max(1, geometry.views // MOST_VIEWS))
    missing, height_mm = np.zeros(geometry.shape), 0.0
    for end, passed_mm in zip((-1, 1), _passed_mm(scene, geometry), strict=True):
        more = scene.beyond(end, passed_mm) if passed_mm > 0 else None
        if more is not None:
            missing += np.tensordot(more.attenuation_per_mm, more.path_lengths(geometry), axes=1)
            height_mm = max(height_mm, passed_mm)
    return Truncation(float(np.mean(missing > LEAST_MISSING)), float(missing.max()), height_mm)


def _passed_mm(scene: VoxelScene, geometry: ScanGeometry) -> tuple[float, float]:
    """Return the extent of rays below and above the ends of a scene within its radius, mm."""
    low, high = scene.ends_mm
    x, y, z = geometry.source_mm.T[..., None]
    (to_x, to_y, to_z), rows = geometry.bundles()
    along = np.sqrt(to_x**2 + to_y**2)
    # In the axial plane: the point of a ray next to the axis, and half its chord within the radius.
    nearest = -(x * to_x + y * to_y) / along
    off = (x * to_y - y * to_x) / along
    half = np.sqrt(np.maximum(scene.radius_mm**2 - off**2, 0))
    climb = (to_z[:, None] + rows[:, None]) / along[:, None]
    heights = [z[:, None] + climb * (nearest + side * half)[:, None] for side in (-1, 1)]
    seen = np.broadcast_to((half > 0)[:, None], heights[0].shape)
    return (
        float(max(low - min(np.min(height, where=seen, initial=np.inf) for height in heights), 0.0)),
        float(max(max(np.max(height, where=seen, initial=-np.inf) for height in heights) - high, 0.0)),
    )
