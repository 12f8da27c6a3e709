"""Noise of images made white: what fits and tests of single voxels ask for.

Noise of reconstructed images is correlated: filtered back-projection leaves next to none of it at low frequencies,
where physics such as beam hardening acts. A voxel's difference over its standard deviation is therefore divided, in
Fourier space, by the square root of the noise power spectrum (pre-whitening, as for the Hotelling observer [1]_).

References
----------
.. [1] H. H. Barrett and K. J. Myers, Foundations of Image Science, Wiley, 2004, section 13.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft, ndimage

SMOOTH_VOXELS = (1.0, 3.0, 3.0)  # over which the noise's variance is averaged: it changes slowly
SMOOTH_BINS = 1.5  # of frequencies, over which its power is
LEAST_POWER = 1e-4  # of the mean: frequencies that hold no noise at all are no evidence, numerics matter there


@dataclass(frozen=True)
class Whitening:
    """Maps images to fields whose noise is white, of variance 1 per repeat.

    Attributes
    ----------
    sd : ndarray, shape (z, y, x)
        Standard deviation of one repeat, HU; 0 where voxels do not count.
    power : ndarray, shape (kz, ky, half of kx)
        Of the noise over `sd`, mean 1 over all frequencies, plus that of the numerical floor.
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

    def over_sd(self, image: np.ndarray) -> np.ndarray:
        """An image over its noise's standard deviation, shape (z, y, x), 0 where voxels do not count."""
        return np.where(self.used, image / np.where(self.used, self.sd, 1), 0)


def whitening(noise: np.ndarray, used: np.ndarray, floor: np.ndarray, repeats: int) -> Whitening:
    """The whitening of realisations of noise.

    Parameters
    ----------
    noise : ndarray, shape (realisations, z, y, x)
        HU, mean 0.
    used : ndarray of bool, shape (z, y, x)
    floor : ndarray, shape (z, y, x)
        Numerical error of the prediction, HU; it does not fall with the number of repeats.
    repeats : int
        Whose mean is compared.
    """
    cover = np.maximum(ndimage.gaussian_filter(used.astype(float), SMOOTH_VOXELS), 1e-6)
    square = np.where(used, (noise.astype(np.float64) ** 2).mean(axis=0), 0)
    sd = np.sqrt(np.where(used, ndimage.gaussian_filter(square, SMOOTH_VOXELS) / cover, 0))
    sd[sd < 1e-3 * np.median(sd[used])] = 0
    bare = Whitening(sd, np.ones(1))
    power = sum(np.abs(fft.rfftn(bare.over_sd(one))) ** 2 for one in noise) / (len(noise) * bare.used.sum())
    power = np.maximum(_smooth(power), LEAST_POWER)
    floor_power = _smooth(np.abs(fft.rfftn(bare.over_sd(floor))) ** 2 / bare.used.sum())
    return Whitening(sd, power + repeats * floor_power)


def local_variance(white: Whitening, nulls: np.ndarray) -> np.ndarray:
    """Variance of whitened noise by place.

    Noise whose texture changes over the image (along the body's long axis, say) does not become white everywhere.

    Parameters
    ----------
    nulls : ndarray, shape (realisations, z, y, x)
        Noise, HU.

    Returns
    -------
    ndarray, shape (z, y, x)
        Mean 1.
    """
    square = np.where(white.used, np.mean([white(one) ** 2 for one in nulls], axis=0), 0)
    cover = np.maximum(ndimage.gaussian_filter(white.used.astype(float), SMOOTH_VOXELS), 1e-6)
    smooth = np.where(white.used, ndimage.gaussian_filter(square, SMOOTH_VOXELS) / cover, 0)
    return np.where(white.used, smooth / smooth[white.used].mean(), 1)


def _smooth(power: np.ndarray) -> np.ndarray:
    """Averaged over neighbouring frequencies; the last axis holds one half of them."""
    sigma = [SMOOTH_BINS if n > 2 * SMOOTH_BINS else 0 for n in power.shape]
    return ndimage.gaussian_filter(power, sigma, mode=["wrap", "wrap", "mirror"])
