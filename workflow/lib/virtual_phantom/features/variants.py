"""Simulated images with one property changed and the others kept, to find out which of them explains a misfit.

Every function takes the mean image and the noise of repeats of one scan, as `split` gives them, and returns new images
float64 [repeat, z, y, x] in HU on the same grid. An image is the mean plus its noise, so that each property is changed
where it lies: amplitude and texture in the noise, resolution in the mean.

A mean over n repeats still holds 1/n of the noise variance, which changes of the noise do not reach and a blur of the
mean does. Where a noiseless simulation is at hand, take it as the mean and the differences from it as noise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from ..base.errors import InputError

MINIMUM_REPEATS = 2  # from which noise is what differs between them
TRUNCATE = 6.0  # of Gaussians, in SDs: what is cut off has no weight in single precision


def split(images: np.ndarray, noiseless: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """The mean image, and what each repeat differs from it by.

    Parameters
    ----------
    images : ndarray, shape (repeats, z, y, x)
        HU.
    noiseless : ndarray, shape (z, y, x), optional
        The same scan without noise, to be used in place of the mean over repeats.

    Returns
    -------
    mean : ndarray of float64, shape (z, y, x)
        HU.
    noise : ndarray of float64, shape (repeats, z, y, x)
        HU. Its variance over repeats (n - 1) is that of the images, at every voxel.

    Raises
    ------
    InputError
        For fewer than two repeats, other shapes, or values that are not finite.
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
    """Noise amplitude: its SD times `factor`, its variance times the square.

    Parameters
    ----------
    mean, noise : ndarray
        From `split`, HU.

    Returns
    -------
    ndarray, shape (repeats, z, y, x)
        HU.

    Raises
    ------
    InputError
        If the factor is negative.
    """
    if not factor >= 0:
        raise InputError(f"variants: a noise factor of {factor} is none; give 0 or more")
    return mean + factor * noise


def filter_noise(
    mean: np.ndarray, noise: np.ndarray, sigma_voxels: float | Sequence[float], within: np.ndarray | None = None
) -> np.ndarray:
    """Noise texture: the noise smoothed by a Gaussian, and scaled to the variance it had.

    Noise can only be made coarser like this.

    Parameters
    ----------
    mean, noise : ndarray
        From `split`, HU.
    sigma_voxels : float or sequence of 3 float
        SD of the Gaussian along (z, y, x), or one for all; the autocorrelation of white noise becomes exp(-d^2 / (4
        sigma^2)) at the distance d.
    within : ndarray of bool, shape (z, y, x), optional
        Where the variance, averaged over voxels and repeats, is kept, such as the ROIs; everywhere if left out. One
        factor serves the whole image: where noise is stronger, it stays so.

    Returns
    -------
    ndarray, shape (repeats, z, y, x)
        HU.

    Raises
    ------
    InputError
        For a negative sigma, a mask of another shape or without voxels, or if nothing is left of the noise.
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
        raise InputError("variants: there is no noise to give a texture to; give repeats that differ")
    return mean + np.sqrt(before / after) * smooth


def blur(mean: np.ndarray, noise: np.ndarray, sigma_voxels: float | Sequence[float]) -> np.ndarray:
    """Resolution: the mean image smoothed by a Gaussian, under the same noise.

    Parameters
    ----------
    mean, noise : ndarray
        From `split`, HU.
    sigma_voxels : float or sequence of 3 float
        SD of the Gaussian along (z, y, x), or one for all.

    Returns
    -------
    ndarray, shape (repeats, z, y, x)
        HU.

    Raises
    ------
    InputError
        For a negative sigma.
    """
    return _gaussian(mean, _sigma(sigma_voxels)) + noise


def _sigma(sigma_voxels: float | Sequence[float]) -> np.ndarray:
    sigma = np.broadcast_to(np.asarray(sigma_voxels, dtype=np.float64), 3)
    if not (np.isfinite(sigma) & (sigma >= 0)).all():
        raise InputError(f"variants: sigma {sigma_voxels} is none; give 0 or more voxels")
    return sigma


def _gaussian(image: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    return ndimage.gaussian_filter(image, sigma, mode="nearest", truncate=TRUNCATE)
