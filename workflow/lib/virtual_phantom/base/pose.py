"""Where an object lies beside the place that it is said to have, and how a scan sees it then."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .vectors import ScanGeometry


@dataclass(frozen=True)
class Pose:
    """How the object lies off the place that it is said to have.

    Attributes
    ----------
    x_mm, y_mm, z_mm : float
        Shift, mm.
    turn_deg : float
        About z, degrees.
    size : float
        Over the one that it is said to have, in every direction.
    """

    x_mm: float = 0.0
    y_mm: float = 0.0
    z_mm: float = 0.0
    turn_deg: float = 0.0
    size: float = 1.0


IN_PLACE = Pose()


def turned_axes(turn_deg: float) -> np.ndarray:
    """The axes of an object that is turned about z, from +x to +y, by so many degrees: unit vectors, shape (3, 3)."""
    turn = np.deg2rad(turn_deg)
    return np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]])


def turned_back(geometry: ScanGeometry, pose: Pose, motion_mm: np.ndarray | None) -> tuple[ScanGeometry, np.ndarray]:
    """The geometry in which an object that is turned is seen unturned, and the object's shift in it.

    The object turned by t about z and seen at angle b is the object seen at b - t, with shifts turned back.

    Parameters
    ----------
    motion_mm : ndarray, shape (views, 3), or None
        As VoxelScene.path_lengths takes it.

    Returns
    -------
    shift_mm : ndarray, shape (3,) or (views, 3)
    """
    geometry, back = geometry.turned(-np.deg2rad(pose.turn_deg)), turned_axes(pose.turn_deg)
    shift = back @ [pose.x_mm, pose.y_mm, pose.z_mm]
    return geometry, shift if motion_mm is None else shift + motion_mm @ back.T
