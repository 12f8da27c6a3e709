"""A detector's gain pattern: one constant per pixel, estimated from the mean residual of all views."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage, stats

from .whitening import Whitening

SMOOTH_FACTOR = 3.0  # of the variance expected of the smooth part
SMOOTH_PX = 3.0  # what varies more slowly than this from pixel to pixel may be other physics


@dataclass(frozen=True)
class Pattern:
    """Constants added to line integrals.

    Attributes
    ----------
    values : ndarray, shape (rows, columns)
        Shrunk towards 0 by how much of each is noise.
    variance : ndarray, shape (rows, columns)
        That the true constants, whitened, have about them.
    rms, error : float
        Standard deviation of the true constants, and its standard error.
    """

    values: np.ndarray
    variance: np.ndarray
    rms: float
    error: float


def chance(rms: float, error: float) -> float:
    """Chance of a pattern of this size where there is none, from its standard error.

    A likelihood ratio would be none: a pattern has as many constants as there are pixels.

    Parameters
    ----------
    rms, error : float
        As in Pattern.
    """
    return float(stats.norm.sf(rms / error)) if rms else 1.0


def estimate(residual: np.ndarray, weight: np.ndarray, whitening: Whitening | None = None) -> Pattern:
    """The pattern in residuals.

    Constants are taken as independent draws of one normal distribution. Its variance is what the mean square of their
    rough part exceeds that of noise by. Where the smooth part is larger than such draws would make it, it is other
    physics (the shadow of a disc looks alike in all views) and not counted as pattern.

    Parameters
    ----------
    residual : ndarray, shape (views, rows, columns)
    weight : ndarray, shape (views, rows, columns)
        1 / variance.
    whitening : Whitening, optional
        That the residuals have been through.
    """
    total = weight.sum(axis=0)
    good = total > 0
    mean = np.where(good, (weight * residual).sum(axis=0) / np.where(good, total, 1), 0)
    noise = np.where(good, 1 / np.where(good, total, 1), 0)
    rough, left = _without_smooth(mean, good)
    square = rough[good] ** 2 / left
    excess = float((square - noise[good]).mean())
    rms = float(np.sqrt(max(0.0, excess)))
    typical = float(square.mean())
    error = typical * np.sqrt(2 / good.sum()) / (2 * max(rms, np.sqrt(typical / np.sqrt(good.sum()))))
    share = np.where(good, rms**2 / np.maximum(rms**2 + noise, 1e-300), 0) if rms else 0
    smooth = (mean - rough)[good]
    expected = (1 - left) * float((rms**2 + noise[good]).mean())
    values = share * (mean if float((smooth**2).mean()) <= SMOOTH_FACTOR * expected else rough)
    if whitening is not None:  # which makes white constants of pixels rougher
        values, larger = whitening.pixels(values), whitening.roughness(_widths(mean.shape))
        rms, error = rms / larger, error / larger
    return Pattern(values, share * noise, rms, float(error))


def _widths(shape: tuple[int, ...]) -> list[float]:
    """Over which the smooth part is averaged; 0 where a detector is no wider."""
    return [SMOOTH_PX if n > 2 * SMOOTH_PX else 0 for n in shape]


def _without_smooth(mean: np.ndarray, good: np.ndarray) -> tuple[np.ndarray, float]:
    """The rough part, and the share of a white pattern's variance that it keeps."""
    sigma = _widths(mean.shape)

    def smooth(array):
        return ndimage.gaussian_filter(array.astype(float), sigma, mode="constant")

    cover = np.maximum(smooth(good), 1e-12)
    rough = np.where(good, mean - smooth(np.where(good, mean, 0)) / cover, 0)
    impulse = np.zeros([8 * int(SMOOTH_PX) + 1 if s else 1 for s in sigma])
    impulse[tuple(n // 2 for n in impulse.shape)] = 1
    left = impulse - ndimage.gaussian_filter(impulse, sigma, mode="constant")
    return rough, float((left**2).sum())
