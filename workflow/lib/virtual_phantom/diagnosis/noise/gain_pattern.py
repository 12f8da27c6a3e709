"""Pattern of a detector: one constant per pixel, a gain or a dark signal, from the mean residual of all views.

In images, a constant belongs to a ring of a slice, and the mean is over its voxels (ObservedImages).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy import ndimage, optimize, stats

from .whitening import Whitening

SMOOTH_FACTOR = 3.0  # of the variance expected of the smooth part
LEAST_ROUGH = 1e-9  # share of a pixel's variance in its rough part: more than rounding errors
SMOOTH_PX = 3.0  # width of the Gaussian that gives the smooth part, which may be other physics
# Largest standard deviation of the dark signal of pixels, relative to its mean; a choice. Without a limit, the pattern
# of a small dark signal could describe gains.
MOST_UNEVEN = 0.5


Sums = Callable[[np.ndarray], np.ndarray]


def over_views(values: np.ndarray) -> np.ndarray:
    """Return sums over the data of every pixel, shape (rows, columns)."""
    return values.sum(axis=0)


@dataclass(frozen=True)
class Pattern:
    """Constants added to line integrals, with independent normal priors.

    Constants of gains are changes of line integrals, constants of dark signals relative deviations from the mean.

    Attributes
    ----------
    values : ndarray, shape (rows, columns) or (slices, rings)
        Estimates, shrunk towards 0 for noise.
    variance : ndarray, shaped as `values`
        Variance of the true constants, whitened, about them.
    share : ndarray, shaped as `values`
        Share of the mean residual of its data that each constant takes, by its prior.
    smooth : bool
        Whether the smooth part of the mean residual belongs to the pattern.
    rms, error : float
        Standard deviation of the true constants, and its standard error.
    p : float
        P-value of a likelihood ratio against no constants.
    per_constant : ndarray, shaped as the data, or None
        Change of the data per constant; None: 1 (gains).
    """

    values: np.ndarray
    variance: np.ndarray
    share: np.ndarray
    smooth: bool
    rms: float
    error: float
    p: float = 1.0
    per_constant: np.ndarray | None = field(default=None, repr=False)

    @property
    def penalty(self) -> float:
        """Twice the log likelihood that the pattern loses because its prior is wider than noise alone."""
        return -float(np.log1p(-self.share).sum())

    def constants(self, residual: np.ndarray, weight: np.ndarray, sums: Sums = over_views) -> np.ndarray:
        """Return the estimates for another whitened residual, a linear function; arguments as `estimate`."""
        return self.share * self._mean(residual, weight, sums)

    def over_data(self, constants: np.ndarray) -> np.ndarray:
        """Return the change of the data by constants, which are broadcastable to the data."""
        return constants if self.per_constant is None else constants * self.per_constant

    def absorbed(self, residual: np.ndarray, weight: np.ndarray, sums: Sums = over_views) -> np.ndarray:
        """Return the constants without which the square of a residual is chi-square beside the pattern.

        Let r be a residual with weights W, A r its means, S the shares, and B the spreading of constants over the data.
        The best constants S A r leave r'W (r - B S A r), with the squares of their priors. This is the weighted square
        of r - B (1 - sqrt(1 - S)) A r, as A B = 1. Without the smooth part, this is an approximation.
        """
        return (1 - np.sqrt(1 - self.share)) * self._mean(residual, weight, sums)

    def _mean(self, residual: np.ndarray, weight: np.ndarray, sums: Sums) -> np.ndarray:
        mean, total = _mean(*_per_constant(residual, weight, self.per_constant), sums)
        return mean if self.smooth else _without_smooth(mean, total > 0)[0]


def estimate(
    residual: np.ndarray,
    weight: np.ndarray,
    whitening: Whitening | None = None,
    sums: Sums = over_views,
    smooth: bool = False,
    per_constant: np.ndarray | None = None,
) -> Pattern:
    """Estimate the pattern in residuals with weights 1 / variance, shape (views, rows, columns).

    The constants are modeled as independent normal values, whose variance is the most likely one for their rough part
    and the noise of each. A smooth part that is larger than expected of such values is other physics (the shadow of a
    disc is equal in all views), and not part of the pattern.

    Parameters
    ----------
    sums : callable, optional
        Returns the sums over the data that share a constant.
    smooth : bool, optional
        Whether the smooth part belongs to the pattern, however large it is.
    per_constant : ndarray, shape (views, rows, columns), optional
        See Pattern.
    """
    mean, total = _mean(*_per_constant(residual, weight, per_constant), sums)
    good = total > 0
    noise = np.where(good, 1 / np.where(good, total, 1), 0)
    rough, left = _without_smooth(mean, good)
    rough_noise = _noise_without_smooth(noise, good)
    shown = good & (rough_noise > LEAST_ROUGH * noise)
    if not shown.any():
        none = np.zeros_like(mean)
        return Pattern(none, none, none, smooth, 0.0, 0.0, per_constant=per_constant)
    square, rough_noise = rough[shown] ** 2 / left, rough_noise[shown] / left
    variance, ratio = _variance(square, rough_noise, np.inf if per_constant is None else MOST_UNEVEN**2)
    rms = float(np.sqrt(variance))
    of_variance = float(np.sqrt(2 / ((variance + rough_noise) ** -2).sum()))
    error = of_variance / (2 * max(rms, np.sqrt(of_variance / np.sqrt(2))))
    p = float(stats.norm.sf(np.sqrt(ratio))) if rms else 1.0
    share = np.where(good, rms**2 / np.maximum(rms**2 + noise, 1e-300), 0) if rms else np.zeros_like(noise)
    expected = (1 - left) * float((rms**2 + noise[good]).mean())
    smooth = smooth or float(((mean - rough)[good] ** 2).mean()) <= SMOOTH_FACTOR * expected
    values = share * (mean if smooth else rough)
    if whitening is not None:  # which makes white constants of pixels rougher
        values, larger = whitening.pixels(values), whitening.roughness(_widths(mean.shape))
        rms, error = rms / larger, error / larger
    return Pattern(values, share * noise, share, smooth, rms, float(error), p, per_constant)


def _variance(square: np.ndarray, noise: np.ndarray, most: float) -> tuple[float, float]:
    """Return the most likely variance v <= most of constants with squares of mean v + noise, and its likelihood ratio.

    The ratio is twice its log likelihood above that of no constants. Pixels with little noise count most.
    """

    def loss(variance: float) -> float:
        return float((np.log1p(variance / noise) + square / (variance + noise)).sum())

    most = min(most, float(square.max()))
    if not most:
        return 0.0, 0.0
    found = optimize.minimize_scalar(lambda root: loss(root**2), bounds=(0.0, np.sqrt(most)), method="bounded")
    ratio = loss(0.0) - float(found.fun)
    return (float(found.x) ** 2, ratio) if ratio > 0 else (0.0, 0.0)


def _per_constant(
    residual: np.ndarray, weight: np.ndarray, per_constant: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return residuals and weights in units of the constants."""
    if per_constant is None:
        return residual, weight
    there = per_constant != 0
    return np.divide(residual, per_constant, out=np.zeros(residual.shape), where=there), weight * per_constant**2


def _mean(residual: np.ndarray, weight: np.ndarray, sums: Sums) -> tuple[np.ndarray, np.ndarray]:
    """Return the weighted mean residual of the data that share a constant, and their total weight."""
    total = sums(weight)
    good = total > 0
    return np.where(good, sums(weight * residual) / np.where(good, total, 1), 0), total


def _widths(shape: tuple[int, ...]) -> list[float]:
    """Return the widths over which the smooth part is averaged; 0 along a short axis."""
    return [SMOOTH_PX if n > 2 * SMOOTH_PX else 0 for n in shape]


def _without_smooth(mean: np.ndarray, good: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the rough part, and the share of a white pattern's variance that it keeps."""
    rough = np.where(good, mean - _smoothed(np.where(good, mean, 0)) / _cover(good), 0)
    impulse = _impulse(good)
    return rough, float(((impulse - _smoothed(impulse)) ** 2).sum())


def _noise_without_smooth(noise: np.ndarray, good: np.ndarray) -> np.ndarray:
    """Return the variance of the rough part of independent values with variances `noise`."""
    middle = float(_smoothed(_impulse(good)).max())
    squared = _smoothed(np.where(good, noise, 0), squared=True)
    cover = _cover(good)
    return noise * (1 - 2 * middle / cover) + squared / cover**2


def _cover(good: np.ndarray) -> np.ndarray:
    return np.maximum(_smoothed(good), 1e-12)


def _smoothed(array: np.ndarray, squared: bool = False) -> np.ndarray:
    """Convolve with a Gaussian, or with its square."""
    found = array.astype(float)
    for axis, width in enumerate(_widths(array.shape)):
        if width:
            kernel = ndimage.gaussian_filter1d(np.eye(1, 8 * int(width) + 1, 4 * int(width))[0], width, mode="constant")
            found = ndimage.convolve1d(found, kernel**2 if squared else kernel, axis, mode="constant")
    return found


def _impulse(like: np.ndarray) -> np.ndarray:
    found = np.zeros([8 * int(width) + 1 if width else 1 for width in _widths(like.shape)])
    found[tuple(n // 2 for n in found.shape)] = 1
    return found
