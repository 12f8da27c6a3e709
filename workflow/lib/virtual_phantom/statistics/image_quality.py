"""Image quality from repeated images: contrast, noise magnitude and noise texture, each with its standard error.

Definitions: [1]_, [2]_. Noise is taken from differences of repeats, which are free of structure. Its standard errors
are those of Gaussian noise: an ordinate of a periodogram has a standard deviation equal to its expectation.
Correlations that reach farther than a square of the spectrum, as streaks of few views do, are not counted.

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

TILE_VOXELS = (64, 32, 16, 8)  # sides of the squares that spectra are taken of: the largest that fits often enough
LEAST_TILES = 8  # of which a spectrum is averaged: its SD is then 35 % of itself
LEAST_ROI_VOXELS = 4  # of a mean or an SD that is compared


@dataclass(frozen=True)
class Measure:
    """A number, and the standard error that the images' noise leaves it; NaN of a single repeat."""

    value: float
    error: float


@dataclass(frozen=True)
class Spectrum:
    """A radial noise power spectrum of the axial plane.

    Attributes
    ----------
    frequency : ndarray, shape (rings,)
        Mean of the ordinates in each ring, 1/mm.
    power, variance : ndarray, shape (rings,)
        HU^2 mm^2, with its variance.
    area : float
        Voxels of the axial plane that hold one independent value of the noise, for the error of a variance.
    """

    frequency: np.ndarray
    power: np.ndarray
    variance: np.ndarray
    area: float

    @property
    def shape(self) -> np.ndarray:
        """Power over its integral along the radius, mm."""
        return self.power / np.trapezoid(self.power, self.frequency)


def noise_of(images: np.ndarray) -> np.ndarray:
    """Independent draws of the noise of one image.

    Helmert's contrasts: orthonormal differences, with the variance of a single image and without any structure.

    Parameters
    ----------
    images : ndarray, shape (repeats, z, y, x)

    Returns
    -------
    ndarray of float64, shape (repeats - 1, z, y, x)

    Raises
    ------
    InputError
        For a single repeat.
    """
    if len(images) < 2:
        raise InputError("noise is measured between repeats, and there is one; record more")
    return np.tensordot(linalg.helmert(len(images)), images.astype(np.float64), 1)


def slice_correlations(noise: np.ndarray, mask: np.ndarray) -> tuple[float, float]:
    """Factors by which correlated slices make variances over slices larger than independent ones would.

    Parameters
    ----------
    noise : ndarray, shape (contrasts, z, y, x)
        From `noise_of`.
    mask : ndarray of bool, shape (z, y, x)
    """
    slices = noise.shape[1]
    square = (noise**2)[:, mask].mean()
    if not square:  # without noise nothing is correlated
        return 1.0, 1.0
    mean = square_of = 1.0
    for lag in range(1, slices):
        both = mask[lag:] & mask[:-lag]
        if both.any():
            rho = (noise[:, lag:] * noise[:, :-lag])[:, both].mean() / square
            mean += 2 * (1 - lag / slices) * rho
            square_of += 2 * (1 - lag / slices) * rho**2
    return max(mean, 1 / slices), square_of


def propagated(statistic: Callable[[np.ndarray], float], values: np.ndarray, noise: np.ndarray, repeats: int) -> float:
    """Standard error of statistic(values) where values are means over repeats, to first order in the noise.

    Parameters
    ----------
    noise : ndarray, shape (contrasts, groups, ...)
        What the noise of one repeat (from `noise_of`) adds to `values` in each of several groups of voxels, whose
        noises are independent.
    """
    centre = statistic(values)
    moved = [[statistic(values + part / np.sqrt(repeats)) - centre for part in groups] for groups in noise]
    return float(np.sqrt((np.array(moved) ** 2).mean(axis=0).sum()))


def contrast(images: np.ndarray, rois: Mapping[str, np.ndarray], reference: str | None = None) -> Measure:
    """Mean absolute difference of the ROIs' means, HU: of all pairs, or of each from the reference ROI.

    Parameters
    ----------
    images : ndarray, shape (repeats, z, y, x)
        HU.
    rois : mapping of str to ndarray of bool, shape (z, y, x)
        By name.

    Raises
    ------
    InputError
        For fewer than two ROIs of at least LEAST_ROI_VOXELS voxels, or another reference.
    """
    used = _large(rois)
    if len(used) < 2:
        raise InputError("contrast needs two ROIs in the image; there are fewer")
    if reference is not None and reference not in used:
        raise InputError(f"contrast: there is no ROI '{reference}'; use one of {', '.join(used)}")
    place = None if reference is None else list(used).index(reference)

    def statistic(means):
        if place is not None:
            return float(np.abs(np.delete(means, place) - means[place]).mean())
        first, second = np.triu_indices(len(means), 1)
        return float(np.abs(means[first] - means[second]).mean())

    mean = images.mean(axis=0, dtype=np.float64)
    values = np.array([mean[mask].mean() for mask in used.values()])
    if len(images) < 2:
        return Measure(statistic(values), np.nan)
    noise = noise_of(images)
    parts = np.stack([(noise * mask).sum(axis=(2, 3)) / mask.sum() for mask in used.values()], axis=-1)
    factor = slice_correlations(noise, np.logical_or.reduce(list(used.values())))[0]
    return Measure(statistic(values), propagated(statistic, values, parts, len(images)) * float(np.sqrt(factor)))


def noise_magnitude(images: np.ndarray, rois: Mapping[str, np.ndarray], area: float) -> Measure:
    """Standard deviation over repeats, HU: root of the ROIs' mean variance.

    Parameters
    ----------
    images : ndarray, shape (repeats, z, y, x)
        HU.
    rois : mapping of str to ndarray of bool, shape (z, y, x)
        By name.
    area : float
        As Spectrum.area.

    Raises
    ------
    InputError
        For a single repeat or no ROI.
    """
    noise, used = noise_of(images), _large(rois)
    if not used:
        raise InputError("noise magnitude needs an ROI in the image; there is none")
    correlated = slice_correlations(noise, np.logical_or.reduce(list(used.values())))[1]
    variances, errors = [], []
    for mask in used.values():
        square = (noise**2)[:, mask]
        variances.append(square.mean())
        # A variance's own variance is twice the mean of sigma^4 per independent value; of Gaussian noise that is a
        # third of the mean fourth power, however sigma varies over the ROI.
        independent = len(noise) * max(mask.sum() / (area * correlated), 1)
        errors.append(2 / 3 * (square**2).mean() / independent)
    pooled = np.mean(variances)
    error = np.sqrt(np.sum(errors)) / len(variances)
    return Measure(float(np.sqrt(pooled)), float(error / (2 * np.sqrt(pooled))))


def noise_spectrum(images: np.ndarray, mask: np.ndarray, spacing: Sequence[float]) -> Spectrum:
    """Radial noise power spectrum of squares within the mask, up to the Nyquist frequency.

    Parameters
    ----------
    images : ndarray, shape (repeats, z, y, x)
        HU.
    mask : ndarray of bool, shape (z, y, x)
        Where the noise counts.
    spacing : sequence of 3 float
        mm (z, y, x).

    Raises
    ------
    InputError
        For a single repeat, or a mask that holds fewer than LEAST_TILES squares of any size.
    """
    noise = noise_of(images)
    side, corners = tiles(mask)
    correlated = slice_correlations(noise, mask)[1]
    # A drift between repeats would stand at frequency 0; one number per difference costs nothing.
    noise = noise - noise[:, mask].mean(axis=1)[:, None, None, None]
    squares = np.stack([noise[:, z, y : y + side, x : x + side] for z, y, x in corners])
    power = np.abs(np.fft.fft2(squares)) ** 2 * (spacing[1] * spacing[2] / side**2)
    power = power.reshape(-1, side * side)
    radius = np.hypot(*np.meshgrid(*(np.fft.fftfreq(side, step) for step in spacing[1:]), indexing="ij")).ravel()
    width = 1 / (side * max(spacing[1:]))
    ring = np.rint(radius / width).astype(int)
    rings = side // 2 + 1  # the last one ends at the Nyquist frequency of the coarser axis
    count = np.bincount(ring, minlength=rings)[:rings] * len(power)
    mean, square = (np.bincount(ring, values.sum(axis=0), rings)[:rings] for values in (power, power**2))
    area = side**2 * (power**2).sum(axis=1).mean() / 2 / (power.sum(axis=1) ** 2).mean()
    return Spectrum(
        frequency=np.bincount(ring, radius, rings)[:rings] * len(power) / count,
        power=mean / count,
        variance=square / count**2 * correlated,  # ordinates come in equal pairs: twice the half of their square
        area=float(area),
    )


def tiles(mask: np.ndarray) -> tuple[int, list[tuple[int, int, int]]]:
    """Squares of the axial plane that lie in a mask, side by side.

    Parameters
    ----------
    mask : ndarray of bool, shape (z, y, x)

    Returns
    -------
    side : int
        Voxels.
    corners : list of tuple of 3 int
        The first corner (z, y, x) of each.

    Raises
    ------
    InputError
        If there are fewer than LEAST_TILES of even the smallest.
    """
    for side in TILE_VOXELS:
        corners = []
        for z, plane in enumerate(mask):
            if min(plane.shape) < side:
                continue
            # 1 where the square that begins here is all within the mask
            inside = ndimage.minimum_filter(plane.astype(np.uint8), side, mode="constant", origin=-(side // 2))
            for y, x in np.argwhere(inside):
                if inside[y, x]:
                    corners.append((z, int(y), int(x)))
                    inside[max(0, y - side + 1) : y + side, max(0, x - side + 1) : x + side] = False
        if len(corners) >= LEAST_TILES:
            return side, corners
    raise InputError(
        f"noise spectrum: fewer than {LEAST_TILES} squares of {TILE_VOXELS[-1]} voxels fit into the object; "
        "the image is too coarse"
    )


def mean_frequency(spectrum: Spectrum) -> Measure:
    """Mean frequency of the radial noise power spectrum, 1/mm (f_av of AAPM Report 233)."""
    f, power = spectrum.frequency, spectrum.power
    weight = np.gradient(f)
    weight[[0, -1]] /= 2  # trapezoids
    mean = float((weight * f * power).sum() / (weight * power).sum())
    error = np.sqrt(((weight * (f - mean)) ** 2 * spectrum.variance).sum()) / (weight * power).sum()
    return Measure(mean, float(error))


def shape_difference(recorded: Spectrum, simulated: Spectrum) -> Measure:
    """RMS difference of two spectra's shapes over the RMS of the recorded one; the error is what noise alone gives."""
    size = np.sqrt((recorded.shape**2).mean())
    noise = sum(one.variance * (one.shape / one.power) ** 2 for one in (recorded, simulated))
    difference = np.sqrt(((simulated.shape - recorded.shape) ** 2).mean())
    return Measure(float(difference / size), float(np.sqrt(noise.mean()) / size))


def _large(rois: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: mask for name, mask in rois.items() if mask.sum() >= LEAST_ROI_VOXELS}
