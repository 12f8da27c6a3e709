"""Change one property of simulated images: noise amplitude, noise texture or resolution.

These changes show which property explains a difference between scans and simulation. `split` returns the mean image and
the noise of repeats. The other functions take both, and return images, float64 [repeat, z, y, x] in HU.

The mean over n repeats contains 1/n of the noise variance. Changes of the noise do not affect this part, but a blur of
the mean does. If a noiseless simulation is available, use it as the mean.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from ..base.errors import InputError

MINIMUM_REPEATS = 2  # needed to separate noise from the mean
TRUNCATE = 6.0  # of Gaussians, in SDs: the weights beyond vanish in single precision


def split(images: np.ndarray, noiseless: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Split repeats into their mean and noise.

    Parameters
    ----------
    images : ndarray, shape (repeats, z, y, x)
        HU.
    noiseless : ndarray, shape (z, y, x), optional
        The same scan without noise, used as the mean.

    Returns
    -------
    mean : ndarray of float64, shape (z, y, x)
    noise : ndarray of float64, shape (repeats, z, y, x)

    Raises
    ------
    InputError
        If there are fewer than two repeats, shapes differ, or values are not finite.
    """
    images = np.asarray(images, dtype=np.float64)
    if images.ndim != 4 or len(images) < MINIMUM_REPEATS:
        raise InputError(
            f"variants: images of shape {images.shape}; give at least {MINIMUM_REPEATS} repeats, [repeat, z, y, x]"
        )
    mean = images.mean(axis=0) if noiseless is None else np.asarray(noiseless, dtype=np.float64)
    if mean.shape != images.shape[1:]:
        raise InputError(f"variants: the noiseless image has shape {mean.shape}, the repeats {images.shape[1:]}")
    if not np.isfinite(images).all() or not np.isfinite(mean).all():
        raise InputError("variants: an image has voxels that are not finite; repair it first")
    return mean, images - mean


def scale_noise(mean: np.ndarray, noise: np.ndarray, factor: float) -> np.ndarray:
    """Multiply the SD of the noise by a factor >= 0."""
    if not factor >= 0:
        raise InputError(f"variants: the noise factor is {factor}; give 0 or more")
    return mean + factor * noise


def filter_noise(
    mean: np.ndarray, noise: np.ndarray, sigma_voxels: float | Sequence[float], within: np.ndarray | None = None
) -> np.ndarray:
    """Make the noise coarser: smooth it by a Gaussian, and scale it by one factor to its previous variance.

    Parameters
    ----------
    sigma_voxels : float or sequence of 3 float
        SD of the Gaussian along (z, y, x). The autocorrelation of white noise becomes exp(-d^2 / (4 sigma^2)) at
        distance d.
    within : ndarray of bool, shape (z, y, x), optional
        Voxels in which the mean variance is preserved, such as the ROIs; by default all.

    Raises
    ------
    InputError
        If sigma is negative, the mask has another shape or is empty, or there is no noise.
    """
    sigma = _sigma(sigma_voxels)
    where = np.ones(mean.shape, bool) if within is None else np.asarray(within, dtype=bool)
    if where.shape != mean.shape or not where.any():
        raise InputError(
            f"variants: the mask of shape {where.shape} is empty or of another shape than the images, {mean.shape}"
        )
    smooth = np.stack([_gaussian(repeat, sigma) for repeat in noise])
    before, after = ((part[:, where] ** 2).mean() for part in (noise, smooth))
    if not after > 0:
        raise InputError("variants: there is no noise; give repeats that differ")
    return mean + np.sqrt(before / after) * smooth


def blur(mean: np.ndarray, noise: np.ndarray, sigma_voxels: float | Sequence[float]) -> np.ndarray:
    """Reduce the resolution: smooth the mean, but not the noise, by a Gaussian of SD `sigma_voxels` (z, y, x)."""
    return _gaussian(mean, _sigma(sigma_voxels)) + noise


def _sigma(sigma_voxels: float | Sequence[float]) -> np.ndarray:
    sigma = np.broadcast_to(np.asarray(sigma_voxels, dtype=np.float64), 3)
    if not (np.isfinite(sigma) & (sigma >= 0)).all():
        raise InputError(f"variants: sigma is {sigma_voxels}; give 0 or more voxels")
    return sigma


def _gaussian(image: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    return ndimage.gaussian_filter(image, sigma, mode="nearest", truncate=TRUNCATE)
