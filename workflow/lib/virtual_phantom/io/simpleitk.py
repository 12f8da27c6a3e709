"""Volumes as SimpleITK images, with NIfTI world coordinates as their physical coordinates."""

from __future__ import annotations

import numpy as np
import SimpleITK as sitk

from ..base.geometry import Grid


def itk_image(array: np.ndarray, grid: Grid) -> sitk.Image:
    """Return an array [z, y, x] and its grid as a SimpleITK image."""
    image = sitk.GetImageFromArray(array)
    image.SetSpacing(grid.spacing[::-1])
    image.SetOrigin(tuple(grid.affine[:3, 3]))
    return image


def itk_resample(image: sitk.Image, grid: Grid, transform: sitk.Transform, outside: float) -> np.ndarray:
    """Interpolate an image linearly at the voxel centers of a grid: float32 of shape (z, y, x).

    `transform` maps world coordinates of `grid` to world coordinates of the image. Voxels outside of the image have the
    value `outside`.
    """
    identity = (1, 0, 0, 0, 1, 0, 0, 0, 1)
    placed = (tuple(grid.affine[:3, 3]), grid.spacing[::-1], identity)
    return sitk.GetArrayFromImage(
        sitk.Resample(image, grid.shape[::-1], transform, sitk.sitkLinear, *placed, outside, sitk.sitkFloat32)
    )


def matrix_of(transform: sitk.Euler3DTransform) -> np.ndarray:
    """Return a transform of world mm as a 4 x 4 matrix."""
    matrix = np.eye(4)
    matrix[:3, :3] = np.reshape(transform.GetMatrix(), (3, 3))
    matrix[:3, 3] = transform.TransformPoint((0.0, 0.0, 0.0))
    return matrix
