"""How far an object lies in one image from where it lies in another, where that is little.

The difference of the images is taken as the gradient times a shift and a turn, in least squares (Lucas and Kanade,
IJCAI 1981, 674). The gradient is that of their mean, so that the noise of one does not pull the answer to zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from ..io.volumes import Volume

SMOOTHED_MM = 1.0  # SD of a Gaussian over both images: noise differs from voxel to voxel, edges do not
STEEP_HU_PER_MM = 50.0  # where the images say something: at surfaces against air, and of bone


@dataclass(frozen=True)
class Displacement:
    """A small rigid motion.

    Attributes
    ----------
    shift_mm : tuple of 3 float
        Of the image's centre, (x, y, z).
    turn_deg : tuple of 3 float
        About (x, y, z) through the centre.
    largest_mm : float
        The longest way that a steep voxel of the object goes.
    """

    shift_mm: tuple[float, float, float]
    turn_deg: tuple[float, float, float]
    largest_mm: float


def displacement(image: Volume, reference: Volume, within: np.ndarray | None = None) -> Displacement | None:
    """Where the object of one image lies beside that of another on the same grid.

    Exact for shifts of a fraction of the smoothed edge's width; longer ones come out of another length, and long.

    Parameters
    ----------
    image, reference : Volume
        HU.
    within : ndarray of bool, shape (z, y, x), optional
        Where to look: a table that the object lies on does not move with it.

    Returns
    -------
    Displacement or None
        None if nothing in them is steep.

    Raises
    ------
    ValueError
        If the grids differ.
    """
    if not image.grid.matches(reference.grid):
        raise ValueError(f"image on {image.grid}, reference on {reference.grid}")
    sigma = [SMOOTHED_MM / wide for wide in image.grid.spacing]
    one = gaussian_filter(reference.array.astype(np.float32), sigma, mode="nearest")
    other = gaussian_filter(image.array.astype(np.float32), sigma, mode="nearest")
    gradient = np.gradient((one + other) / 2, *image.grid.spacing)
    is_steep = sum(part**2 for part in gradient) > STEEP_HU_PER_MM**2
    steep = np.nonzero(is_steep if within is None else is_steep & within)
    if not len(steep[0]):
        return None
    gz, gy, gx = (part[steep].astype(np.float64) for part in gradient)
    z, y, x = (axis[index] for axis, index in zip(image.grid.axes_mm(), steep, strict=True))
    # A point moves by t + r x p; its grey value goes with it.
    columns = np.stack([gx, gy, gz, y * gz - z * gy, z * gx - x * gz, x * gy - y * gx], axis=1)
    fitted, *_ = np.linalg.lstsq(columns, (one - other)[steep].astype(np.float64), rcond=None)
    shift, turn = fitted[:3], fitted[3:]
    moved = shift + np.cross(turn, np.stack([x, y, z], axis=1))
    return Displacement(
        tuple(map(float, shift)), tuple(map(float, np.degrees(turn))), float(np.linalg.norm(moved, axis=1).max())
    )
