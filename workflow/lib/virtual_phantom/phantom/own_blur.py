"""A scanned phantom without what its own scanner put on it: blur, and the noise that is left in the mean of scans.

A scan of a scan has two blurs. What is taken out here is the first, as far as the mean shows more object than noise: a
Wiener filter [1]_ whose signal and noise are measured, the one in the mean and the other in what scans differ by.

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

SHAPE = BINS, ALONG = 16, 8  # bins of spatial frequency in the plane and along z, up to the highest that voxels hold
COLUMNS = ("per_mm_in_plane", "per_mm_along_z", "mean", "noise")
LEAST_SIGNAL = 0.1  # share of the mean's power that is the object's: with less, nothing is restored
LARGEST_GAIN = 4.0  # of any frequency; a Gaussian stands for the blur, and what it says of its tail is not known
MIRRORED = 8  # slices beyond each end, so that the ends are not each other's neighbours
SD_OF_HALF = math.sqrt(math.log(2) / 2) / math.pi  # of a Gaussian in mm whose MTF is one half at 1 per mm
# Share of a voxel's interpolation that blurs along (z, y, x), mean over all rays.
ACROSS = (1.0, 0.5 + 1 / math.pi, 0.5 + 1 / math.pi)
SD_OF_FWHM = 1 / math.sqrt(8 * math.log(2))


@dataclass(frozen=True)
class Spectra:
    """Power of the mean of scans, and of the noise in it, by spatial frequency.

    Attributes
    ----------
    most_per_mm : tuple of 2 float
        Frequency at which bins end: in the plane, and along z.
    mean, noise : ndarray, shape (bins in the plane, bins along z)
        HU2 mm3, in one unit.
    """

    most_per_mm: tuple[float, float]
    mean: np.ndarray
    noise: np.ndarray

    def table(self) -> pd.DataFrame:
        """A row per bin: its middle (per_mm_in_plane, per_mm_along_z), mean and noise."""
        middles = [
            (np.arange(size) + 0.5) / size * most for size, most in zip(self.mean.shape, self.most_per_mm, strict=True)
        ]
        in_plane, along = np.meshgrid(*middles, indexing="ij")
        values = [in_plane, along, self.mean, self.noise]
        return pd.DataFrame(dict(zip(COLUMNS, (one.ravel() for one in values), strict=True)))

    @classmethod
    def of_table(cls, table: pd.DataFrame) -> Spectra:
        """What `table` wrote."""
        most = tuple(
            float(table[name].max()) * size / (size - 0.5) for name, size in zip(COLUMNS[:2], SHAPE, strict=True)
        )
        return cls(most, *(table[name].to_numpy().reshape(SHAPE) for name in COLUMNS[2:]))

    def signal(self) -> np.ndarray:
        """Which share of the mean's power is the object's, 0 to 1, and 0 where that is below LEAST_SIGNAL."""
        share = 1 - np.divide(self.noise, self.mean, out=np.ones_like(self.mean), where=self.mean > 0)
        return np.where(share < LEAST_SIGNAL, 0.0, share)


def spectra(mean: np.ndarray, noise: np.ndarray, spacing: Sequence[float]) -> Spectra:
    """Power of an image and of its noise, in a part that lies within the object.

    Parameters
    ----------
    mean, noise : ndarray, shape (z, y, x)
        HU; the noise has the mean's own spectrum, and none of the object.
    spacing : sequence of 3 float
        mm (z, y, x).

    Returns
    -------
    Spectra
        Each bin a mean over its frequencies.
    """
    most = 0.5 * math.hypot(1 / spacing[1], 1 / spacing[2]), 0.5 / spacing[0]
    window = np.ones(mean.shape)
    for axis, size in enumerate(mean.shape):
        shape = [1, 1, 1]
        shape[axis] = size
        window = window * np.sin(np.pi * (np.arange(size) + 0.5) / size).reshape(shape)
    places = _bins(mean.shape, spacing, most)
    count = np.bincount(places, minlength=BINS * ALONG)
    powers = []
    for image in (mean, noise):
        centred = (image - np.average(image, weights=window**2)) * window
        power = np.abs(fft.rfftn(centred)) ** 2 * math.prod(spacing) / (window**2).sum()
        total = np.bincount(places, power.ravel(), minlength=count.size)
        powers.append(np.divide(total, count, out=np.zeros(count.size), where=count > 0).reshape(SHAPE))
    return Spectra(most, *powers)


def _frequencies(shape: Sequence[int], spacing: Sequence[float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies (z, y, x) of a transform of real numbers, 1/mm, each along its own axis."""
    z, y = (fft.fftfreq(size, step) for size, step in zip(shape[:2], spacing[:2], strict=True))
    return z[:, None, None], y[None, :, None], fft.rfftfreq(shape[2], spacing[2])[None, None, :]


def _bins(shape: Sequence[int], spacing: Sequence[float], most: tuple[float, float]) -> np.ndarray:
    """Number of the bin of every frequency of a transform of real numbers."""
    z, y, x = _frequencies(shape, spacing)
    in_plane = np.minimum(np.hypot(y, x) / most[0] * BINS, BINS - 1).astype(int)
    along = np.minimum(np.abs(z) / most[1] * ALONG, ALONG - 1).astype(int)
    return (in_plane * ALONG + along).ravel()


def without_own_blur(image: Volume, blur_mm: Sequence[float], measured: Spectra) -> Volume:
    """The image before a Gaussian blur, as far as it shows more object than noise.

    Parameters
    ----------
    image : Volume
        HU.
    blur_mm : sequence of 3 float
        SD of the Gaussian along (z, y, x).

    Returns
    -------
    Volume
        Of the same grid. Its mean is the image's.

    Raises
    ------
    InputError
        For a blur that is negative or no number.
    """
    if not all(math.isfinite(sd) and sd >= 0 for sd in blur_mm):
        raise InputError(f"own blur: SDs of {blur_mm} mm are none; give 0 or more along z, y and x")
    spacing = image.grid.spacing
    padded = np.pad(image.array, ((MIRRORED, MIRRORED), (0, 0), (0, 0)), mode="symmetric").astype(np.float32)
    transformed = fft.rfftn(padded, workers=1)
    z, y, x = _frequencies(padded.shape, spacing)
    in_plane = np.hypot(y, x)[0] / measured.most_per_mm[0] * BINS - 0.5
    signal = measured.signal()
    for plane, frequency in zip(transformed, z.ravel(), strict=True):  # a plane at a time bounds the memory
        along = abs(frequency) / measured.most_per_mm[1] * ALONG - 0.5
        share = _interpolated(signal, in_plane, along)
        squares = (blur_mm[0] * frequency) ** 2 + ((blur_mm[1] * y) ** 2 + (blur_mm[2] * x) ** 2)[0]
        plane *= share * np.minimum(np.exp(2 * np.pi**2 * squares), LARGEST_GAIN)
    transformed[0, 0, 0] = padded.sum(dtype=np.float64)
    restored = fft.irfftn(transformed, padded.shape, workers=1)[MIRRORED:-MIRRORED]
    return Volume(np.ascontiguousarray(restored, dtype=np.float32), image.grid)


def with_voxels(
    blur_mm: Sequence[float], own: Sequence[float], fine: Sequence[float], aligned: bool = False
) -> tuple[float, float, float]:
    """A blur with what voxels add to it, on the way from an image to line integrals of a phantom made of it.

    Variances add. `ct.load` interpolates between the image's voxels (a triangle: a sixth of a voxel's square) and takes
    means of points in the phantom's where these are larger (a box: up to a twelfth). The projector interpolates between
    the phantom's voxels, along z and across the ray [2]_. For a structure in the plane that counts by the square of the
    cosine of its angle to the nearer axis: in the mean over directions 1/2 + 1/pi.

    Parameters
    ----------
    blur_mm : sequence of 3 float
        SD of a Gaussian along (z, y, x), mm.
    own, fine : sequence of 3 float
        Voxels of the image and of the phantom, mm.
    aligned : bool, optional
        Whether the phantom's voxels are the image's, so that nothing is interpolated between these.

    Returns
    -------
    tuple of 3 float
        SD of a Gaussian, mm.

    References
    ----------
    .. [2] P. M. Joseph, IEEE Trans. Med. Imaging 1, 192, 1982.
    """
    found = []
    for sd, step, larger, across in zip(blur_mm, own, fine, ACROSS, strict=True):
        variance = sd**2 + across * larger**2 / 6
        if not aligned:
            points = max(math.ceil(larger / step - 1e-6), 1)  # as ct.resample has them
            variance += step**2 / 6 + larger**2 / 12 * (1 - 1 / points**2)
        found.append(math.sqrt(variance))
    return tuple(found)


def within_object(image: Volume, mean: Volume) -> Volume:
    """The image where the mean is no air, and air where it is or where it would be less than that."""
    kept = np.maximum(image.array, np.float32(HU_AIR))
    return Volume(np.where(mean.array <= HU_AIR, np.float32(HU_AIR), kept), image.grid)


def _interpolated(table: np.ndarray, rows: np.ndarray, column: float) -> np.ndarray:
    """Between the middles of bins, linearly; beyond the outer ones as these."""
    last = table.shape[1] - 1
    first = int(np.clip(math.floor(column), 0, last))
    weight = np.clip(column - first, 0, 1)
    of_column = (1 - weight) * table[:, first] + weight * table[:, min(first + 1, last)]
    return np.interp(rows, np.arange(len(table)), of_column)
