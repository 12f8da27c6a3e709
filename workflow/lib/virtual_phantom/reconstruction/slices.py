"""Slices thicker than their spacing, as means of thin slices."""

from __future__ import annotations

import math

import numpy as np

THIN_MM = 0.5  # largest spacing of thin slices, below the row width of body scanners at the isocenter (0.6 mm)


def overlaps(offsets: np.ndarray, half: float) -> np.ndarray:
    """Return the fraction of each cell of width 1 that lies between -half and half; cell centers are `offsets`."""
    return np.clip(np.minimum(offsets + 0.5, half) - np.maximum(offsets - 0.5, -half), 0, 1)


def thin_slices(count: int, spacing_mm: float, thickness_mm: float) -> tuple[np.ndarray, int, float]:
    """Return the weights that average thin slices to `count` thick ones, and the number and spacing of thin slices.

    A thick slice has a box-shaped profile. The stack of thin slices begins with the first box and ends with the last
    one. A thickness that is a multiple of their spacing therefore has whole thin slices. Thin slices are samples of the
    image: one that counts for half would widen the box and reduce the noise.

    Returns
    -------
    weights : ndarray of float32, shape (count, thin)
        Each row sums to 1.
    thin : int
        Number of thin slices. Their stack has the same center as the stack of thick slices.
    thin_mm : float
        Spacing of the thin slices.
    """
    parts = max(1, math.ceil(spacing_mm / THIN_MM - 1e-9))
    thin_mm = spacing_mm / parts
    within = thickness_mm / thin_mm
    thin = (count - 1) * parts + max(1, math.ceil(within - 1e-9))
    at = np.arange(thin) - (thin - 1) / 2
    centres = (np.arange(count) - (count - 1) / 2) * parts
    weights = overlaps(at - centres[:, None], within / 2)
    return (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32), thin, thin_mm
