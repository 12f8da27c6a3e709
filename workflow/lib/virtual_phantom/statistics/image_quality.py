"""Image quality from repeated images: contrast, noise magnitude and noise texture, with standard errors.

Definitions follow [1]_ and [2]_. Noise is measured from differences of repeats, which contain no structure. Standard
errors assume Gaussian noise: an ordinate of a periodogram has a standard deviation equal to its expectation. Errors of
spectra ignore correlations over more than one tile, such as streaks from few views.

References
----------
.. [1] ICRU Report 87, 2012.
.. [2] AAPM Report 233, Performance Evaluation of Computed Tomography Systems, 2019.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg, ndimage

from ..base.errors import InputError

TILE_VOXELS = (64, 32, 16, 8)  # sides of the square tiles for spectra; the largest with LEAST_TILES tiles is used
LEAST_TILES = 8  # tiles that a spectrum averages; its relative SD is then 35 %
LEAST_ROI_VOXELS = 4  # voxels of an ROI whose mean or SD is compared


@dataclass(frozen=True)
class Measure:
    """A value and its standard error from image noise (NaN for a single repeat)."""

    value: float
    error: float


@dataclass(frozen=True)
class Spectrum:
    """Radial noise power spectrum of the axial plane.

    Attributes
    ----------
    frequency : ndarray, shape (rings,)
        Mean frequency of the ordinates in each ring, 1/mm.
    power, variance : ndarray, shape (rings,)
        HU^2 mm^2, and its variance.
    """

    frequency: np.ndarray
    power: np.ndarray
    variance: np.ndarray

    @property
    def shape(self) -> np.ndarray:
        """Power divided by its integral over frequency, mm."""
        return self.power / np.trapezoid(self.power, self.frequency)


def noise_contrasts(images: np.ndarray) -> np.ndarray:
    """Independent realizations of the noise of one image.

    Helmert contrasts: orthonormal differences of repeats, with the variance of a single image and without structure.

    Parameters
    ----------
    images : ndarray, shape (repeats, z, y, x)

    Returns
    -------
    ndarray of float64, shape (repeats - 1, z, y, x)

    Raises
    ------
    InputError
        If there is only one repeat.
    """
    if len(images) < 2:
        raise InputError("noise is measured between repeats, but there is only one; record at least two")
    return np.tensordot(linalg.helmert(len(images)), images.astype(np.float64), 1)


def slice_correlations(noise: np.ndarray, mask: np.ndarray) -> tuple[float, float]:
    """Factors by which correlation between slices increases the variances of a mean and of a mean square.

    Parameters
    ----------
    noise : ndarray, shape (contrasts, z, y, x)
        From `noise_contrasts`.
    mask : ndarray of bool, shape (z, y, x)
    """
    slices = noise.shape[1]
    variance = (noise**2)[:, mask].mean()
    if not variance:
        return 1.0, 1.0
    mean = mean_square = 1.0
    for lag in range(1, slices):
        both = mask[lag:] & mask[:-lag]
        if both.any():
            rho = (noise[:, lag:] * noise[:, :-lag])[:, both].mean() / variance
            mean += 2 * (1 - lag / slices) * rho
            mean_square += 2 * (1 - lag / slices) * rho**2
    return max(mean, 1 / slices), mean_square


def propagated_error(
    statistic: Callable[[np.ndarray], float], values: np.ndarray, noise: np.ndarray, repeats: int
) -> float:
    """Standard error of statistic(values), to first order in the noise; values are means over repeats.

    Parameters
    ----------
    noise : ndarray, shape (contrasts, groups, ...)
        Contribution of the noise of one repeat (from `noise_contrasts`) to `values`, for groups of voxels with
        independent noise.
    """
    center = statistic(values)
    changes = [[statistic(values + part / np.sqrt(repeats)) - center for part in groups] for groups in noise]
    return float(np.sqrt((np.array(changes) ** 2).mean(axis=0).sum()))


def contrast(images: np.ndarray, rois: Mapping[str, np.ndarray]) -> Measure:
    """Mean absolute difference between ROI means, HU, over all pairs.

    Parameters
    ----------
    images : ndarray, shape (repeats, z, y, x)
        HU.
    rois : mapping of str to ndarray of bool, shape (z, y, x)

    Raises
    ------
    InputError
        If fewer than two ROIs have LEAST_ROI_VOXELS voxels.
    """
    used = [mask for mask in rois.values() if mask.sum() >= LEAST_ROI_VOXELS]
    if len(used) < 2:
        raise InputError("contrast needs two ROIs in the image; there are fewer")

    def statistic(means):
        first, second = np.triu_indices(len(means), 1)
        return float(np.abs(means[first] - means[second]).mean())

    mean = images.mean(axis=0, dtype=np.float64)
    values = np.array([mean[mask].mean() for mask in used])
    if len(images) < 2:
        return Measure(statistic(values), np.nan)
    noise = noise_contrasts(images)
    parts = np.stack([(noise * mask).sum(axis=(2, 3)) / mask.sum() for mask in used], axis=-1)
    factor = slice_correlations(noise, np.logical_or.reduce(used))[0]
    return Measure(statistic(values), propagated_error(statistic, values, parts, len(images)) * float(np.sqrt(factor)))


def independent_values(images: np.ndarray, mask: np.ndarray) -> float:
    """Number of independent values of the noise inside a mask; NaN for fewer than three repeats.

    The mean square of the noise of N voxels with the covariance C varies as with tr(C)^2 / tr(C^2) independent
    values. The product of two independent realizations, summed over voxels, has the expected square tr(C^2).
    Correlation over any distance counts, as in streaks, and so does a variance that differs between voxels.

    Parameters
    ----------
    images : ndarray, shape (repeats, z, y, x)
        HU; eight repeats give 21 pairs, and the number within 31 % (one standard deviation).
    mask : ndarray of bool, shape (z, y, x)
    """
    if len(images) < 3:
        return np.nan
    noise = noise_contrasts(images)[:, mask]
    products = noise @ noise.T
    pairs = products[np.triu_indices(len(noise), 1)]
    square = float((pairs**2).mean())
    found = float(np.trace(products) / len(noise)) ** 2 / square if square else np.nan
    return float(np.minimum(found, mask.sum()))


def noise_magnitude(images: np.ndarray, mask: np.ndarray, independent: float) -> Measure:
    """Standard deviation over repeats, HU: square root of the mean variance inside a mask.

    Parameters
    ----------
    images : ndarray, shape (repeats, z, y, x)
        HU.
    mask : ndarray of bool, shape (z, y, x)
    independent : float
        Result of `independent_values` for such images.

    Raises
    ------
    InputError
        If there is only one repeat, or the mask is empty.
    """
    noise = noise_contrasts(images)
    if not mask.any():
        raise InputError("noise magnitude needs a region in the image; there is none")
    value = float(np.sqrt((noise**2)[:, mask].mean()))
    return Measure(value, value / float(np.sqrt(2 * len(noise) * independent)))


def noise_spectrum(images: np.ndarray, mask: np.ndarray, spacing: Sequence[float]) -> Spectrum:
    """Radial noise power spectrum of square tiles inside the mask, up to the Nyquist frequency.

    Parameters
    ----------
    images : ndarray, shape (repeats, z, y, x)
        HU.
    mask : ndarray of bool, shape (z, y, x)
    spacing : sequence of 3 float
        mm (z, y, x).

    Raises
    ------
    InputError
        If there is only one repeat, or fewer than LEAST_TILES tiles of the smallest size fit into the mask.
    """
    noise = noise_contrasts(images)
    side, corners = tiles(mask)
    correlated = slice_correlations(noise, mask)[1]
    # A drift between repeats would add power at frequency 0.
    noise = noise - noise[:, mask].mean(axis=1)[:, None, None, None]
    squares = np.stack([noise[:, z, y : y + side, x : x + side] for z, y, x in corners])
    return tile_spectrum(squares.reshape(-1, side, side), spacing, correlated)


def tile_spectrum(squares: np.ndarray, spacing: Sequence[float], correlated: float = 1.0) -> Spectrum:
    """Radial noise power spectrum of square tiles of noise, up to the Nyquist frequency.

    Parameters
    ----------
    squares : ndarray, shape (tiles, side, side)
        HU, of mean 0.
    spacing : sequence of 3 float
        mm (z, y, x).
    correlated : float, optional
        Factor by which correlation between tiles increases the variance of the mean.
    """
    side = squares.shape[-1]
    power = np.abs(np.fft.fft2(squares)) ** 2 * (spacing[1] * spacing[2] / side**2)
    power = power.reshape(-1, side * side)
    radius = np.hypot(*np.meshgrid(*(np.fft.fftfreq(side, step) for step in spacing[1:]), indexing="ij")).ravel()
    width = 1 / (side * max(spacing[1:]))
    ring = np.rint(radius / width).astype(int)
    rings = side // 2 + 1  # the last one ends at the Nyquist frequency of the coarser axis
    count = np.bincount(ring, minlength=rings)[:rings] * len(power)
    mean, square = (np.bincount(ring, values.sum(axis=0), rings)[:rings] for values in (power, power**2))
    return Spectrum(
        frequency=np.bincount(ring, radius, rings)[:rings] * len(power) / count,
        power=mean / count,
        variance=square / count**2 * correlated,  # ordinates come in equal pairs, so half of them are independent
    )


def tiles(mask: np.ndarray) -> tuple[int, list[tuple[int, int, int]]]:
    """Non-overlapping square tiles of the axial plane inside a mask (z, y, x).

    Returns
    -------
    side : int
        Voxels.
    corners : list of tuple of 3 int
        First corner (z, y, x) of every tile.

    Raises
    ------
    InputError
        If fewer than LEAST_TILES tiles of the smallest size fit.
    """
    for side in TILE_VOXELS:
        corners = []
        for z, plane in enumerate(mask):
            if min(plane.shape) < side:
                continue
            # 1 where the tile that starts here is completely inside the mask
            inside = ndimage.minimum_filter(plane.astype(np.uint8), side, mode="constant", origin=-(side // 2))
            for y, x in np.argwhere(inside):
                if inside[y, x]:
                    corners.append((z, int(y), int(x)))
                    inside[max(0, y - side + 1) : y + side, max(0, x - side + 1) : x + side] = False
        if len(corners) >= LEAST_TILES:
            return side, corners
    raise InputError(
        f"noise spectrum: fewer than {LEAST_TILES} tiles of {TILE_VOXELS[-1]} x {TILE_VOXELS[-1]} voxels fit into the "
        "object; use smaller voxels"
    )


def mean_frequency(spectrum: Spectrum) -> Measure:
    """Mean frequency of the radial noise power spectrum, 1/mm (f_av of AAPM Report 233)."""
    f, power = spectrum.frequency, spectrum.power
    weight = np.gradient(f)
    weight[[0, -1]] /= 2  # trapezoidal rule
    mean = float((weight * f * power).sum() / (weight * power).sum())
    error = np.sqrt(((weight * (f - mean)) ** 2 * spectrum.variance).sum()) / (weight * power).sum()
    return Measure(mean, float(error))


def shape_difference(recorded: Spectrum, simulated: Spectrum) -> Measure:
    """RMS difference of two spectral shapes relative to the recorded RMS; the error is its value from noise alone."""
    size = np.sqrt((recorded.shape**2).mean())
    noise = sum(spectrum.variance * (spectrum.shape / spectrum.power) ** 2 for spectrum in (recorded, simulated))
    difference = np.sqrt(((simulated.shape - recorded.shape) ** 2).mean())
    return Measure(float(difference / size), float(np.sqrt(noise.mean()) / size))
