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


@dataclass(frozen=True)
class Pattern:
    """Constants added to line integrals.

    Attributes
    ----------
    values : ndarray, shape (rows, columns) or (slices, rings)
        Estimates, shrunk towards 0 for noise.
    variance : ndarray, shaped as `values`
        Variance of the true constants, whitened, about them.
    rms, error : float
        Standard deviation of the true constants, and its standard error.
    of : callable
        Returns the estimates for other residuals, with the same shrinkage: a linear function.
    """

    values: np.ndarray
    variance: np.ndarray
    rms: float
    error: float
    of: Callable[[np.ndarray], np.ndarray]


def pattern_p_value(rms: float, error: float) -> float:
    """Return the p-value of a pattern's rms, by its standard error.

    A likelihood ratio has no known distribution here: a pattern has as many constants as there are pixels.
    """
    return float(stats.norm.sf(rms / error)) if rms else 1.0


def over_views(values: np.ndarray) -> np.ndarray:
    """Return sums over the data of every pixel, shape (rows, columns)."""
    return values.sum(axis=0)


def estimate(
    residual: np.ndarray,
    weight: np.ndarray,
    whitening: Whitening | None = None,
    sums: Callable[[np.ndarray], np.ndarray] = over_views,
) -> Pattern:
    """Estimate the pattern in residuals with weights 1 / variance, shape (views, rows, columns).

    `sums` returns the sums over the data that share a constant.

    The constants are modeled as independent normal values, whose variance is the mean square of their rough part less
    noise. A smooth part that is larger than expected of such values is other physics (the shadow of a disc is
    equal in all views), and not part of the pattern.
    """
    total = sums(weight)
    good = total > 0
    noise = np.where(good, 1 / np.where(good, total, 1), 0)

    def averaged(values: np.ndarray) -> np.ndarray:
        return np.where(good, sums(weight * values) / np.where(good, total, 1), 0)

    mean = averaged(residual)
    if not good.any():
        return Pattern(mean, noise, 0.0, 0.0, averaged)
    rough, left = _without_smooth(mean, good)
    square = rough[good] ** 2 / left
    excess = float((square - noise[good]).mean())
    rms = float(np.sqrt(max(0.0, excess)))
    typical = float(square.mean())
    error = typical * np.sqrt(2 / good.sum()) / (2 * max(rms, np.sqrt(typical / np.sqrt(good.sum()))))
    share = np.where(good, rms**2 / np.maximum(rms**2 + noise, 1e-300), 0) if rms else np.zeros_like(noise)
    smooth = (mean - rough)[good]
    expected = (1 - left) * float((rms**2 + noise[good]).mean())
    with_smooth = float((smooth**2).mean()) <= SMOOTH_FACTOR * expected

    def constants(values: np.ndarray) -> np.ndarray:
        found = averaged(values)
        found = share * (found if with_smooth else _without_smooth(found, good)[0])
        return found if whitening is None else whitening.pixels(found)

    values = constants(residual)
    if whitening is not None:  # which makes white constants of pixels rougher
        larger = whitening.roughness(_widths(mean.shape))
        rms, error = rms / larger, error / larger
    return Pattern(values, share * noise, rms, float(error), constants)


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
