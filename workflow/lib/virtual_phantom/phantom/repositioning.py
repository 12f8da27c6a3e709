"""Re-positioned scans: the phantom is shifted and rotated by small random amounts between repeats."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import SimpleITK as sitk

from ..base.pose import Pose, turned_axes
from ..base.streams import Branch, branch, generator


def random_pose(study_seed: int, seed: int, shift_mm: float, turn_deg: float) -> Pose:
    """Return the pose of a re-positioned repeat, the same for all of its scans, noise levels and protocols.

    Parameters
    ----------
    seed : int
        Seed of the repeat.
    shift_mm, turn_deg : float
        Limits of the uniform distributions of the shift along x, y and z and of the rotation about z.
    """
    samples = generator(branch(study_seed, Branch.REPOSITIONING, seed)).uniform(-1, 1, 4)
    return Pose(*map(float, samples * [shift_mm, shift_mm, shift_mm, turn_deg]))


def world_to_object(pose: Pose, isocentre_mm: tuple[float, float, float]) -> sitk.Transform:
    """Return the transform from positions in the world to positions in the object before it was moved.

    Parameters
    ----------
    pose : Pose
        The size is ignored.
    isocentre_mm : tuple of 3 float
        Center of rotation (x, y, z) in the NIfTI world of the object's image.
    """
    back = turned_axes(pose.turn_deg)
    transform = sitk.Euler3DTransform()
    transform.SetCenter(tuple(isocentre_mm))
    transform.SetMatrix(back.ravel().tolist())
    transform.SetTranslation((-back @ np.array([pose.x_mm, pose.y_mm, pose.z_mm])).tolist())
    return transform


def moved_to_border(moved: Sequence[np.ndarray], still: Sequence[np.ndarray]) -> list[int]:
    """Return the indices of the masks, bool [z, y, x], that touch the border of the grid only after the motion."""

    def touches(mask):
        return any(np.moveaxis(mask, axis, 0)[[0, -1]].any() for axis in range(3))

    return [i for i, (after, before) in enumerate(zip(moved, still, strict=True)) if touches(after) > touches(before)]
