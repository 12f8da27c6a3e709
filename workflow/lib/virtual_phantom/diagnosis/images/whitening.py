"""Whitening of image noise, for fits and tests of single voxels.

Noise of reconstructed images is correlated: filtered back-projection leaves little noise at low frequencies, where
physics such as beam hardening acts. The difference of a voxel over its SD is therefore divided, in Fourier space, by
the square root of the noise power spectrum (pre-whitening, as for the Hotelling observer [1]_).

References
----------
.. [1] H. H. Barrett and K. J. Myers, Foundations of Image Science, Wiley, 2004, section 13.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft, ndimage

SMOOTH_VOXELS = (1.0, 3.0, 3.0)  # SD of the average of the noise variance, which changes slowly
SMOOTH_BINS = 1.5  # SD of the average of the noise power, in frequencies
LEAST_POWER = 1e-4  # of the mean, as numerical errors dominate at frequencies without noise
LEAST_POWER_OF_SLICES = 1e-2  # of real images, in which rounding and edges that differ dominate there


@dataclass(frozen=True)
class ImageWhitening:
    """Transform of images to fields with white noise of variance 1 per repeat.

    Attributes
    ----------
    sd : ndarray, shape (z, y, x)
        Standard deviation of one repeat, HU; 0 where voxels do not count.
    power : ndarray, shape (kz, ky, half of kx)
        Noise power over `sd`, mean 1 over all frequencies, plus the power of the numerical error.
    """

    sd: np.ndarray
    power: np.ndarray

    @property
    def used(self) -> np.ndarray:
        """Voxels that count, bool, shape (z, y, x)."""
        return self.sd > 0

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """Whiten an image, shape (z, y, x): HU to standard deviations."""
        return fft.irfftn(fft.rfftn(self.over_sd(image)) / np.sqrt(self.power), self.sd.shape)

    def inverse(self, white: np.ndarray) -> np.ndarray:
        """Undo the whitening of a field, shape (z, y, x): standard deviations to HU."""
        return fft.irfftn(fft.rfftn(white) * np.sqrt(self.power), self.sd.shape) * self.sd

    def over_sd(self, image: np.ndarray) -> np.ndarray:
        """Return an image over the SD of its noise, shape (z, y, x), 0 where voxels do not count."""
        return np.where(self.used, image / np.where(self.used, self.sd, 1), 0)


def image_whitening(
    noise: np.ndarray, used: np.ndarray, floor: np.ndarray, repeats: int, least: float = LEAST_POWER
) -> ImageWhitening:
    """Return the whitening of realizations of noise.

    Parameters
    ----------
    noise : ndarray, shape (realizations, z, y, x)
        HU, mean 0.
    used : ndarray of bool, shape (z, y, x)
    floor : ndarray, shape (z, y, x)
        Numerical error of the prediction, HU, which does not depend on the number of repeats.
    repeats : int
        Number of repeats of the compared mean.
    least : float, optional
        Smallest noise power over its mean.
    """
    cover = np.maximum(ndimage.gaussian_filter(used.astype(float), SMOOTH_VOXELS), 1e-6)
    square = np.where(used, (noise.astype(np.float64) ** 2).mean(axis=0), 0)
    sd = np.sqrt(np.where(used, ndimage.gaussian_filter(square, SMOOTH_VOXELS) / cover, 0))
    sd[sd < 1e-3 * np.median(sd[used])] = 0
    bare = ImageWhitening(sd, np.ones(1))
    power = sum(np.abs(fft.rfftn(bare.over_sd(realization))) ** 2 for realization in noise) / (
        len(noise) * bare.used.sum()
    )
    power = np.maximum(_smooth(power), least)
    floor_power = _smooth(np.abs(fft.rfftn(bare.over_sd(floor))) ** 2 / bare.used.sum())
    return ImageWhitening(sd, power + repeats * floor_power)


def local_variance(white: ImageWhitening, nulls: np.ndarray) -> np.ndarray:
    """Return the local variance of whitened noise, shape (z, y, x), mean 1.

    Noise with a texture that changes over the image does not become white everywhere.

    Parameters
    ----------
    nulls : ndarray, shape (realizations, z, y, x)
        Noise, HU.
    """
    square = np.where(white.used, np.mean([white(null) ** 2 for null in nulls], axis=0), 0)
    cover = np.maximum(ndimage.gaussian_filter(white.used.astype(float), SMOOTH_VOXELS), 1e-6)
    smooth = np.where(white.used, ndimage.gaussian_filter(square, SMOOTH_VOXELS) / cover, 0)
    return np.where(white.used, smooth / smooth[white.used].mean(), 1)


def _smooth(power: np.ndarray) -> np.ndarray:
    """Average over neighboring frequencies; the last axis holds one half of them."""
    sigma = [SMOOTH_BINS if n > 2 * SMOOTH_BINS else 0 for n in power.shape]
    return ndimage.gaussian_filter(power, sigma, mode=["wrap", "wrap", "mirror"])
