"""Remove the scanner's blur from a mean of scans, before it is used as a phantom.

A simulated scan of a scan is blurred twice. The first blur is removed by a Wiener filter [1]_. Its noise spectrum is
measured in the differences of scans, and its signal spectrum in their mean.

References
----------
.. [1] N. Wiener, Extrapolation, Interpolation, and Smoothing of Stationary Time Series, 1949; W. K. Pratt, Digital
   Image Processing, 4th ed., 2007, section 12.4.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import fft

from ..base.errors import InputError
from ..base.units import HU_AIR
from ..io.volumes import Volume

SHAPE = BINS, ALONG = 16, 8  # bins of spatial frequency in-plane and along z, up to the Nyquist frequency
COLUMNS = ("per_mm_in_plane", "per_mm_along_z", "mean", "noise")
LEAST_SIGNAL = 0.1  # least fraction of the power of the mean that is signal; frequencies with less are removed
LARGEST_GAIN = 4.0  # largest gain: the Gaussian model of the blur is not valid at high frequencies
MIRRORED = 8  # slices of mirror padding, as the Fourier transform is periodic
SD_OF_HALF = math.sqrt(math.log(2) / 2) / math.pi  # SD in mm of a Gaussian whose MTF is 0.5 at 1 per mm
# Share of the variance of the projector's interpolation blur along (z, y, x), mean over all ray directions.
ACROSS = (1.0, 0.5 + 1 / math.pi, 0.5 + 1 / math.pi)
SD_OF_FWHM = 1 / math.sqrt(8 * math.log(2))


@dataclass(frozen=True)
class PowerSpectra:
    """Power spectra of the mean of scans and of its noise.

    Attributes
    ----------
    most_per_mm : tuple of 2 float
        Upper limits of frequency, in-plane and along z.
    mean, noise : ndarray, shape (in-plane bins, bins along z)
        HU^2 mm^3.
    """

    most_per_mm: tuple[float, float]
    mean: np.ndarray
    noise: np.ndarray

    def table(self) -> pd.DataFrame:
        """Return a table with a row per bin: center (per_mm_in_plane, per_mm_along_z), mean and noise."""
        centers = [
            (np.arange(size) + 0.5) / size * most for size, most in zip(self.mean.shape, self.most_per_mm, strict=True)
        ]
        in_plane, along = np.meshgrid(*centers, indexing="ij")
        values = np.ravel(in_plane), np.ravel(along), self.mean.ravel(), self.noise.ravel()
        return pd.DataFrame(dict(zip(COLUMNS, values, strict=True)))

    @classmethod
    def from_table(cls, table: pd.DataFrame) -> PowerSpectra:
        """Restore the spectra from `table`."""
        most = tuple(
            float(table[name].max()) * size / (size - 0.5) for name, size in zip(COLUMNS[:2], SHAPE, strict=True)
        )
        return cls(most, *(table[name].to_numpy().reshape(SHAPE) for name in COLUMNS[2:]))

    def signal(self) -> np.ndarray:
        """Return the Wiener filter (mean - noise) / mean, set to 0 below LEAST_SIGNAL."""
        share = 1 - np.divide(self.noise, self.mean, out=np.ones_like(self.mean), where=self.mean > 0)
        return np.where(share < LEAST_SIGNAL, 0.0, share)


def measure_spectra(mean: np.ndarray, noise: np.ndarray, spacing: Sequence[float]) -> PowerSpectra:
    """Measure the power spectra of a part of an image within the object, and of its noise.

    Parameters
    ----------
    mean, noise : ndarray, shape (z, y, x)
        HU; `noise` is a difference of scans, scaled to the power spectrum of the noise in `mean`.
    spacing : sequence of 3 float
        mm (z, y, x).
    """
    most = 0.5 * math.hypot(1 / spacing[1], 1 / spacing[2]), 0.5 / spacing[0]
    window = np.ones(mean.shape)
    for axis, size in enumerate(mean.shape):
        shape = [1, 1, 1]
        shape[axis] = size
        window = window * np.sin(np.pi * (np.arange(size) + 0.5) / size).reshape(shape)
    bins = _bins(mean.shape, spacing, most)
    count = np.bincount(bins, minlength=BINS * ALONG)
    powers = []
    for image in (mean, noise):
        centered = (image - np.average(image, weights=window**2)) * window
        power = np.abs(fft.rfftn(centered)) ** 2 * math.prod(spacing) / (window**2).sum()
        total = np.bincount(bins, power.ravel(), minlength=count.size)
        powers.append(np.divide(total, count, out=np.zeros(count.size), where=count > 0).reshape(SHAPE))
    return PowerSpectra(most, *powers)


def _frequencies(shape: Sequence[int], spacing: Sequence[float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the frequencies along z, y and x of `rfftn`, 1/mm, as arrays that broadcast."""
    z, y = (fft.fftfreq(size, step) for size, step in zip(shape[:2], spacing[:2], strict=True))
    return z[:, None, None], y[None, :, None], fft.rfftfreq(shape[2], spacing[2])[None, None, :]


def _bins(shape: Sequence[int], spacing: Sequence[float], most: tuple[float, float]) -> np.ndarray:
    """Return the bin number of every frequency of `rfftn`."""
    z, y, x = _frequencies(shape, spacing)
    in_plane = np.minimum(np.hypot(y, x) / most[0] * BINS, BINS - 1).astype(int)
    along = np.minimum(np.abs(z) / most[1] * ALONG, ALONG - 1).astype(int)
    return (in_plane * ALONG + along).ravel()


def deconvolve(image: Volume, blur_mm: Sequence[float], measured: PowerSpectra) -> Volume:
    """Deconvolve a Gaussian blur from an image in HU; the mean of the image does not change.

    Parameters
    ----------
    blur_mm : sequence of 3 float
        SD of the Gaussian along (z, y, x).

    Raises
    ------
    InputError
        If an SD is negative or not finite.
    """
    if not all(math.isfinite(sd) and sd >= 0 for sd in blur_mm):
        raise InputError(f"deconvolution: blur_mm is {blur_mm}; give 0 or more along z, y and x")
    spacing = image.grid.spacing
    padded = np.pad(image.array, ((MIRRORED, MIRRORED), (0, 0), (0, 0)), mode="symmetric").astype(np.float32)
    transformed = fft.rfftn(padded, workers=1)
    z, y, x = _frequencies(padded.shape, spacing)
    in_plane = np.hypot(y, x)[0] / measured.most_per_mm[0] * BINS - 0.5
    wiener_filter = measured.signal()
    for plane, frequency in zip(transformed, z.ravel(), strict=True):  # one plane at a time, to limit memory
        along = abs(frequency) / measured.most_per_mm[1] * ALONG - 0.5
        filter_value = _interpolated(wiener_filter, in_plane, along)
        squares = (blur_mm[0] * frequency) ** 2 + ((blur_mm[1] * y) ** 2 + (blur_mm[2] * x) ** 2)[0]
        plane *= filter_value * np.minimum(np.exp(2 * np.pi**2 * squares), LARGEST_GAIN)
    transformed[0, 0, 0] = padded.sum(dtype=np.float64)
    restored = fft.irfftn(transformed, padded.shape, workers=1)[MIRRORED:-MIRRORED]
    return Volume(np.ascontiguousarray(restored, dtype=np.float32), image.grid)


def add_voxel_blur(
    blur_mm: Sequence[float], image_mm: Sequence[float], phantom_mm: Sequence[float], same_voxels: bool = False
) -> tuple[float, float, float]:
    """Add the blur by interpolation and averaging of voxels to a Gaussian blur, and return its SDs (z, y, x), mm.

    Variances add, from the image to the line integrals of the phantom. `ct.load_phantom` interpolates between voxels of
    the image (triangle: 1/6 of the squared voxel size). It averages points in larger voxels of the phantom (box: up
    to 1/12). The projector interpolates between voxels of the phantom, along z and across the ray [2]_. In-plane, this
    is weighted by the squared cosine of the angle to the nearer axis: 1/2 + 1/pi on average.

    Parameters
    ----------
    image_mm, phantom_mm : sequence of 3 float
        Voxel size (z, y, x) of the image and of the phantom, mm.
    same_voxels : bool, optional
        Whether the phantom has the voxels of the image, so that `ct.load_phantom` does not interpolate.

    References
    ----------
    .. [2] P. M. Joseph, IEEE Trans. Med. Imaging 1, 192, 1982.
    """
    found = []
    for sd, image_voxel, phantom_voxel, share in zip(blur_mm, image_mm, phantom_mm, ACROSS, strict=True):
        variance = sd**2 + share * phantom_voxel**2 / 6
        if not same_voxels:
            points = max(math.ceil(phantom_voxel / image_voxel - 1e-6), 1)  # as in ct.resample
            variance += image_voxel**2 / 6 + phantom_voxel**2 / 12 * (1 - 1 / points**2)
        found.append(math.sqrt(variance))
    return tuple(found)


def keep_air(image: Volume, mean: Volume) -> Volume:
    """Set an image to air where the mean is air, and raise values below air to air."""
    kept = np.maximum(image.array, np.float32(HU_AIR))
    return Volume(np.where(mean.array <= HU_AIR, np.float32(HU_AIR), kept), image.grid)


def _interpolated(table: np.ndarray, rows: np.ndarray, column: float) -> np.ndarray:
    """Interpolate linearly between bin centers, without extrapolation."""
    last = table.shape[1] - 1
    first = int(np.clip(math.floor(column), 0, last))
    weight = np.clip(column - first, 0, 1)
    of_column = (1 - weight) * table[:, first] + weight * table[:, min(first + 1, last)]
    return np.interp(rows, np.arange(len(table)), of_column)
