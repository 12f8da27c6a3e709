"""Repeats before which the phantom is laid down anew: it then lies a little elsewhere, and a little turned."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import SimpleITK as sitk

from ..base.pose import Pose, turned_axes
from ..base.streams import Branch, branch, generator


def drawn_pose(study_seed: int, seed: int, shift_mm: float, turn_deg: float) -> Pose:
    """Where the phantom lies in a re-positioned repeat, the same in all scans, noise levels and protocols of it.

    Parameters
    ----------
    seed : int
        Of the repeat.
    shift_mm : float
        The shift is drawn evenly from this far down to this far up, along x, y and z each.
    turn_deg : float
        The turn about z likewise.
    """
    draws = generator(branch(study_seed, Branch.REPOSITIONING, seed)).uniform(-1, 1, 4)
    x, y, z, turn = (float(one) for one in draws * [shift_mm, shift_mm, shift_mm, turn_deg])
    return Pose(x, y, z, turn)


def to_object(pose: Pose, isocentre_mm: tuple[float, float, float]) -> sitk.Transform:
    """Where a point of the room lies in the object at rest.

    Parameters
    ----------
    pose : Pose
        Its size is not looked at.
    isocentre_mm : tuple of 3 float
        Of the object at rest, in its image's NIfTI world, (x, y, z): what it is turned about.

    Returns
    -------
    SimpleITK.Transform
        World to world, as io.simpleitk.itk_resample takes it.
    """
    back = turned_axes(pose.turn_deg)
    transform = sitk.Euler3DTransform()
    transform.SetCenter(tuple(isocentre_mm))
    transform.SetMatrix(back.ravel().tolist())
    transform.SetTranslation((-back @ np.array([pose.x_mm, pose.y_mm, pose.z_mm])).tolist())
    return transform


def beyond(moved: Sequence[np.ndarray], still: Sequence[np.ndarray]) -> list[int]:
    """Which regions reach the border of their voxels by having been moved.

    Parameters
    ----------
    moved, still : sequence of ndarray of bool, shape (z, y, x)
        The regions after and before.

    Returns
    -------
    list of int
        Their places in the sequence.
    """

    def touches(mask):
        return any(np.moveaxis(mask, axis, 0)[[0, -1]].any() for axis in range(3))

    return [i for i, (one, other) in enumerate(zip(moved, still, strict=True)) if touches(one) and not touches(other)]
