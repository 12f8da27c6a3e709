"""Interfaces between materials within voxels, from the share of each voxel (piecewise linear interfaces [1]_).

References
----------
.. [1] D. L. Youngs, Time-dependent multi-material flow with large fluid distortion, in: Numerical Methods for Fluid
   Dynamics, Academic Press, 1982, 273-285.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

LEAST_SHARE = 1e-3  # of both sides of an interface in a voxel
BISECTIONS = 20  # of a distance from -1 to 1: 2e-6
AT_ONCE = 2_000_000  # parts of voxels, with about 50 bytes each


def divided(shares: np.ndarray, parts: tuple[int, int, int]) -> np.ndarray:
    """Divide voxels into parts, with a plane as the interface within each voxel.

    The plane is perpendicular to the gradient of the shares, and each voxel keeps its share.

    Parameters
    ----------
    shares : ndarray, shape (z, y, x)
    parts : tuple of 3 int
        Parts of a voxel along each axis.
    """
    found = repeated(shares, parts)
    mixed = np.argwhere((shares > LEAST_SHARE) & (shares < 1 - LEAST_SHARE))
    # Sobel filters are Youngs' finite differences in three dimensions.
    slopes = [ndimage.sobel(shares, axis, mode="nearest") if n > 1 else None for axis, n in enumerate(shares.shape)]
    normal = np.stack([np.zeros(len(mixed)) if slope is None else slope[tuple(mixed.T)] for slope in slopes], axis=1)
    length = np.abs(normal).sum(axis=1)
    mixed, normal = mixed[length > LEAST_SHARE], normal[length > LEAST_SHARE] / length[length > LEAST_SHARE, None]
    at = np.meshgrid(*((np.arange(count) - (count - 1) / 2) / count for count in parts), indexing="ij")
    at = np.stack([coordinate.ravel() for coordinate in at])
    blocks = found.reshape(*(size for pair in zip(shares.shape, parts, strict=True) for size in pair))
    step = max(1, AT_ONCE // at.shape[1])
    for first in range(0, len(mixed), step):
        z, y, x = mixed[first : first + step].T
        filled = _filled(normal[first : first + step], shares[z, y, x], at, parts)
        blocks[z, :, y, :, x, :] = filled.reshape(-1, *parts)
    return found


def sharpened(values: np.ndarray, parts: tuple[int, int, int]) -> np.ndarray:
    """Divide voxels that mix their neighbors' least and largest value into parts, with a plane as the interface."""
    if max(parts) == 1:
        return values
    mixed, low, high = phases(values)
    low, high = (repeated(ends, parts) for ends in (low, high))
    return low + (high - low) * divided(mixed, parts)


def repeated(values: np.ndarray, parts: tuple[int, int, int]) -> np.ndarray:
    """Return values with each voxel divided into equal parts."""
    for axis, count in enumerate(parts):
        values = values.repeat(count, axis)
    return values


def phases(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return voxels as mixtures of their neighbors' least and largest value: share of the largest, least, largest."""
    size = [min(n, 3) for n in values.shape]
    low, high = (extreme(values, size, mode="nearest") for extreme in (ndimage.minimum_filter, ndimage.maximum_filter))
    return np.divide(values - low, high - low, out=np.zeros_like(values), where=high > low), low, high


def _filled(normal: np.ndarray, share: np.ndarray, at: np.ndarray, parts: tuple[int, int, int]) -> np.ndarray:
    """Return the share of each part on one side of a plane, by bisection of its distance, shape (voxels, parts)."""
    along, width = normal @ at, (np.abs(normal) / parts).sum(axis=1, keepdims=True)

    def filled(distance: np.ndarray) -> np.ndarray:
        return np.clip(0.5 + (along - distance[:, None]) / width, 0, 1)

    low, high = np.full(len(share), -1.0), np.full(len(share), 1.0)
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        more = filled(middle).mean(axis=1) > share
        low, high = np.where(more, middle, low), np.where(more, high, middle)
    return filled((low + high) / 2)
