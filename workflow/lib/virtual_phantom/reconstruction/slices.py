"""Slices thicker than they are apart: means over thin ones."""

from __future__ import annotations

import math

import numpy as np

THIN_MM = 0.5  # thin slices are no farther apart: less than the 0.6 mm that rows of body scanners are high


def overlaps(offsets: np.ndarray, half: float) -> np.ndarray:
    """How much of cells of width 1 lies within a distance of 0.

    Parameters
    ----------
    offsets : ndarray
        Centres of the cells.
    half : float
        The distance.

    Returns
    -------
    ndarray
        From 0 to 1, shaped as `offsets`.
    """
    return np.clip(np.minimum(offsets + 0.5, half) - np.maximum(offsets - 0.5, -half), 0, 1)


def thin_slices(count: int, spacing_mm: float, thickness_mm: float) -> tuple[np.ndarray, int, float]:
    """Thin slices around a stack, and how they are averaged to its slices.

    Parameters
    ----------
    count : int
        Slices of the stack.
    spacing_mm : float
        From one of them to the next.
    thickness_mm : float
        Full width of the profile, a box.

    Returns
    -------
    weights : ndarray of float32, shape (count, thin)
        Rows add up to 1.
    thin : int
        Thin slices; their stack has the same centre.
    thin_mm : float
        From one of these to the next.
    """
    parts = max(1, math.ceil(spacing_mm / THIN_MM - 1e-9))
    thin_mm = spacing_mm / parts
    beyond = math.ceil(max(thickness_mm - spacing_mm, 0) / 2 / thin_mm - 1e-9)
    thin = count * parts + 2 * beyond
    at = (np.arange(thin) - (thin - 1) / 2) * thin_mm
    centres = (np.arange(count) - (count - 1) / 2) * spacing_mm
    weights = overlaps((at - centres[:, None]) / thin_mm, thickness_mm / thin_mm / 2)
    return (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32), thin, thin_mm
