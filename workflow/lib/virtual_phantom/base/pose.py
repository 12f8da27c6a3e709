"""Pose of the object: its deviation from the nominal position and size, and the scan as the object sees it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .vectors import ScanGeometry


@dataclass(frozen=True)
class Pose:
    """Deviation of the object from its nominal position and size.

    Attributes
    ----------
    x_mm, y_mm, z_mm : float
        Shift, mm.
    turn_deg : float
        Rotation about z, degrees.
    size : float
        Scale factor in all directions.
    """

    x_mm: float = 0.0
    y_mm: float = 0.0
    z_mm: float = 0.0
    turn_deg: float = 0.0
    size: float = 1.0


IN_PLACE = Pose()


def turned_axes(turn_deg: float) -> np.ndarray:
    """Return the axes of an object rotated about z, from +x to +y: unit vectors as rows, shape (3, 3)."""
    turn = np.deg2rad(turn_deg)
    return np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]])


def turned_back(geometry: ScanGeometry, pose: Pose, motion_mm: np.ndarray | None) -> tuple[ScanGeometry, np.ndarray]:
    """Return the geometry in which a rotated object appears unrotated, and the object's shift, (3,) or (views, 3).

    The object rotated by t about z and seen at angle b is the unrotated object seen at b - t, with rotated shifts.
    VoxelScene.path_lengths describes `motion_mm`.
    """
    geometry, back = geometry.turned(-np.deg2rad(pose.turn_deg)), turned_axes(pose.turn_deg)
    shift = back @ [pose.x_mm, pose.y_mm, pose.z_mm]
    return geometry, shift if motion_mm is None else shift + motion_mm @ back.T
