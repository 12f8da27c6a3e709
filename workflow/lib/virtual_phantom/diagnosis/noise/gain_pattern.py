"""Gain pattern of a detector: one constant per pixel, estimated from the mean residual of all views.

In images, a constant belongs to a ring of a slice, and the mean is over its voxels (ObservedImages).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage, stats

from .whitening import Whitening

SMOOTH_FACTOR = 3.0  # of the variance expected of the smooth part
SMOOTH_PX = 3.0  # width of the Gaussian that gives the smooth part, which may be other physics


Sums = Callable[[np.ndarray], np.ndarray]


def over_views(values: np.ndarray) -> np.ndarray:
    """Return sums over the data of every pixel, shape (rows, columns)."""
    return values.sum(axis=0)


@dataclass(frozen=True)
class Pattern:
    """Constants added to line integrals, with independent normal priors.

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
    """

    values: np.ndarray
    variance: np.ndarray
    share: np.ndarray
    smooth: bool
    rms: float
    error: float

    def constants(self, residual: np.ndarray, weight: np.ndarray, sums: Sums = over_views) -> np.ndarray:
        """Return the estimates for another whitened residual, a linear function; arguments as `estimate`."""
        return self.share * self._mean(residual, weight, sums)

    def absorbed(self, residual: np.ndarray, weight: np.ndarray, sums: Sums = over_views) -> np.ndarray:
        """Return the constants without which the square of a residual is chi-square beside the pattern.

        Let r be a residual with weights W, A r its means, S the shares, and B the spreading of constants over the data.
        The best constants S A r leave r'W (r - B S A r), with the squares of their priors. This is the weighted square
        of r - B (1 - sqrt(1 - S)) A r, as A B = 1. Without the smooth part, this is an approximation.
        """
        return (1 - np.sqrt(1 - self.share)) * self._mean(residual, weight, sums)

    def _mean(self, residual: np.ndarray, weight: np.ndarray, sums: Sums) -> np.ndarray:
        mean, total = _mean(residual, weight, sums)
        return mean if self.smooth else _without_smooth(mean, total > 0)[0]


def pattern_p_value(rms: float, error: float) -> float:
    """Return the p-value of a pattern's rms, by its standard error.

    A likelihood ratio has no known distribution here: a pattern has as many constants as there are pixels.
    """
    return float(stats.norm.sf(rms / error)) if rms else 1.0


def estimate(
    residual: np.ndarray,
    weight: np.ndarray,
    whitening: Whitening | None = None,
    sums: Sums = over_views,
    smooth: bool = False,
) -> Pattern:
    """Estimate the pattern in residuals with weights 1 / variance, shape (views, rows, columns).

    The constants are modeled as independent normal values, whose variance is the mean square of their rough part less
    noise. A smooth part that is larger than expected of such values is other physics (the shadow of a disc is
    equal in all views), and not part of the pattern.

    Parameters
    ----------
    sums : callable, optional
        Returns the sums over the data that share a constant.
    smooth : bool, optional
        Whether the smooth part belongs to the pattern, however large it is.
    """
    mean, total = _mean(residual, weight, sums)
    good = total > 0
    noise = np.where(good, 1 / np.where(good, total, 1), 0)
    if not good.any():
        return Pattern(mean, noise, np.zeros_like(noise), smooth, 0.0, 0.0)
    rough, left = _without_smooth(mean, good)
    square = rough[good] ** 2 / left
    excess = float((square - noise[good]).mean())
    rms = float(np.sqrt(max(0.0, excess)))
    typical = float(square.mean())
    error = typical * np.sqrt(2 / good.sum()) / (2 * max(rms, np.sqrt(typical / np.sqrt(good.sum()))))
    share = np.where(good, rms**2 / np.maximum(rms**2 + noise, 1e-300), 0) if rms else np.zeros_like(noise)
    expected = (1 - left) * float((rms**2 + noise[good]).mean())
    smooth = smooth or float(((mean - rough)[good] ** 2).mean()) <= SMOOTH_FACTOR * expected
    values = share * (mean if smooth else rough)
    if whitening is not None:  # which makes white constants of pixels rougher
        values, larger = whitening.pixels(values), whitening.roughness(_widths(mean.shape))
        rms, error = rms / larger, error / larger
    return Pattern(values, share * noise, share, smooth, rms, float(error))


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
    sigma = _widths(mean.shape)

    def smooth(array):
        return ndimage.gaussian_filter(array.astype(float), sigma, mode="constant")

    cover = np.maximum(smooth(good), 1e-12)
    rough = np.where(good, mean - smooth(np.where(good, mean, 0)) / cover, 0)
    impulse = np.zeros([8 * int(SMOOTH_PX) + 1 if s else 1 for s in sigma])
    impulse[tuple(n // 2 for n in impulse.shape)] = 1
    left = impulse - ndimage.gaussian_filter(impulse, sigma, mode="constant")
    return rough, float((left**2).sum())
