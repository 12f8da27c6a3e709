"""Locations where recorded images and a model differ beyond noise."""

from __future__ import annotations

import numpy as np

from ...base.units import HU_BODY
from ..residuals.residual_tests import Location, blocks, by_value, corrected, extreme, noise_places, steepest
from .observed import LAGS, ObservedImages

AXES = ("slices", "rows", "columns")
RINGS = 16  # of equal width around the isocenter


def locate(residuals, weights, data: ObservedImages, fitted=None, more=()) -> list[Location]:
    """Return the worst location of every domain, from whitened voxels.

    Parameters
    ----------
    residuals, weights, data, fitted, more
        See projections.residual_maps.locate.
    """
    shape = data.mean.shape
    residual, weight = residuals[0].reshape(shape), weights[0].reshape(shape)
    total = data.blocks.sum(weight)
    z = data.blocks.sum(residual * weight) / np.sqrt(np.where(total > 0, total, np.inf))
    expected = data.expected
    rows, columns = (np.arange(n) - (n - 1) / 2 for n in shape[1:])
    ring = np.broadcast_to(np.hypot(rows[:, None], columns) * 2 * RINGS / max(shape[1:]), shape)
    ring = np.minimum(ring.astype(int), RINGS - 1)
    inside = (weight > 0) & (expected > HU_BODY)
    slope = np.hypot(*np.gradient(expected, axis=(1, 2)))
    found = [
        blocks("image", z, data, AXES),
        extreme("slices", _sums(residual, weight, (1, 2)), lambda i: f"slice {i} of {shape[0]}"),
        extreme("distance from the axis", _by(ring, residual, weight), lambda i: f"ring {i + 1} of {RINGS}"),
        by_value("tissue", "voxels of {:.0f} to {:.0f} HU", residual, weight, expected, inside),
        steepest("voxels", residual, weight, slope),
        *noise_places(residuals, weights, data, [_words(lag) for lag in LAGS], AXES, fitted),
    ]
    return corrected([*found, *more])


def _sums(residual, weight, axes) -> np.ndarray:
    total = weight.sum(axis=axes)
    return (residual * weight).sum(axis=axes) / np.sqrt(np.where(total > 0, total, np.inf))


def _by(index, residual, weight) -> np.ndarray:
    total = np.bincount(index.ravel(), weight.ravel(), RINGS)
    return np.bincount(index.ravel(), (residual * weight).ravel(), RINGS) / np.sqrt(np.where(total > 0, total, np.inf))


def _words(lag: tuple[int, int, int]) -> str:
    axis = int(np.argmax(lag))
    return f"voxels {lag[axis]} {AXES[axis]} apart"
