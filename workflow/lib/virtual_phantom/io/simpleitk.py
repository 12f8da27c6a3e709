"""Volumes in SimpleITK, whose physical coordinates are then the NIfTI world's."""

from __future__ import annotations

import numpy as np
import SimpleITK as sitk

from ..base.geometry import Grid


def itk_image(array: np.ndarray, grid: Grid) -> sitk.Image:
    """An array [z, y, x] on its grid."""
    image = sitk.GetImageFromArray(array)
    image.SetSpacing(grid.spacing[::-1])
    image.SetOrigin(tuple(grid.affine[:3, 3]))
    return image


def itk_resample(image: sitk.Image, grid: Grid, transform: sitk.Transform, outside: float) -> np.ndarray:
    """Interpolate an image linearly at the voxel centres of a grid.

    Parameters
    ----------
    grid : Grid
        Where to.
    transform : SimpleITK.Transform
        World of `grid` to world of the image.
    outside : float
        Value where the image holds none.

    Returns
    -------
    ndarray of float32, shape (z, y, x)
    """
    identity = (1, 0, 0, 0, 1, 0, 0, 0, 1)
    placed = (tuple(grid.affine[:3, 3]), grid.spacing[::-1], identity)
    return sitk.GetArrayFromImage(
        sitk.Resample(image, grid.shape[::-1], transform, sitk.sitkLinear, *placed, outside, sitk.sitkFloat32)
    )


def matrix_of(transform: sitk.Euler3DTransform) -> np.ndarray:
    """The transform of world mm as a 4 x 4 matrix."""
    matrix = np.eye(4)
    matrix[:3, :3] = np.reshape(transform.GetMatrix(), (3, 3))
    matrix[:3, 3] = transform.TransformPoint((0.0, 0.0, 0.0))
    return matrix
