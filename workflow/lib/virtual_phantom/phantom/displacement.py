"""Estimate a small rigid displacement of an object between two images.

The difference of the images is fitted by the gradient times a shift and a rotation, in least squares (Lucas and Kanade,
IJCAI 1981, 674). Noise in the gradient biases the estimate toward zero. The gradient of the mean image reduces this
bias.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from ..io.volumes import Volume

SMOOTHED_MM = 1.0  # SD of the Gaussian that suppresses noise in both images
STEEP_HU_PER_MM = 50.0  # least gradient of the voxels that are fitted: surfaces of the body and of bone


@dataclass(frozen=True)
class Displacement:
    """A small rigid motion.

    Attributes
    ----------
    shift_mm : tuple of 3 float
        Shift (x, y, z) of the image center.
    turn_deg : tuple of 3 float
        Rotation about (x, y, z) through the center.
    largest_mm : float
        Largest displacement of a fitted voxel.
    """

    shift_mm: tuple[float, float, float]
    turn_deg: tuple[float, float, float]
    largest_mm: float


def displacement(image: Volume, reference: Volume, within: np.ndarray | None = None) -> Displacement | None:
    """Estimate the displacement of an image relative to a reference on the same grid, both in HU.

    The estimate is accurate for shifts well below the width of a smoothed edge. Larger shifts are detected, but the
    estimated length is not accurate.

    Parameters
    ----------
    within : ndarray of bool, shape (z, y, x), optional
        Voxels to use, to exclude the table, which does not move with the object.

    Returns
    -------
    Displacement or None
        None if no voxel has a gradient above STEEP_HU_PER_MM.

    Raises
    ------
    ValueError
        If the grids differ.
    """
    if not image.grid.matches(reference.grid):
        raise ValueError(f"image on {image.grid}, reference on {reference.grid}")
    sigma = [SMOOTHED_MM / size_mm for size_mm in image.grid.spacing]
    fixed = gaussian_filter(reference.array.astype(np.float32), sigma, mode="nearest")
    moving = gaussian_filter(image.array.astype(np.float32), sigma, mode="nearest")
    gradient = np.gradient((fixed + moving) / 2, *image.grid.spacing)
    is_steep = sum(part**2 for part in gradient) > STEEP_HU_PER_MM**2
    steep = np.nonzero(is_steep if within is None else is_steep & within)
    if not len(steep[0]):
        return None
    gz, gy, gx = (part[steep].astype(np.float64) for part in gradient)
    z, y, x = (axis[index] for axis, index in zip(image.grid.axes_mm(), steep, strict=True))
    # The gray value of a point p moves to p + t + r x p, so to first order fixed - moving = gradient . (t + r x p).
    columns = np.stack([gx, gy, gz, y * gz - z * gy, z * gx - x * gz, x * gy - y * gx], axis=1)
    fitted, *_ = np.linalg.lstsq(columns, (fixed - moving)[steep].astype(np.float64), rcond=None)
    shift, turn = fitted[:3], fitted[3:]
    moved = shift + np.cross(turn, np.stack([x, y, z], axis=1))
    return Displacement(
        tuple(map(float, shift)), tuple(map(float, np.degrees(turn))), float(np.linalg.norm(moved, axis=1).max())
    )
