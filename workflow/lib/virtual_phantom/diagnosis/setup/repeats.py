"""Repeats that are none: copies of one file, and scans of something else."""

from __future__ import annotations

import numpy as np

from ..noise.condensed import Blocks

PARTS = (12, 4, 8)  # blocks along views, rows and columns: their means show what noise hides in single rays
APART = 50.0  # mean square of block means beyond that of noise by which a repeat is of another scan
TIMES = 20.0  # as much, against the others among themselves
LEAST_RAYS = 16  # of a block


def copies(lines: np.ndarray) -> list[tuple[int, int]]:
    """Pairs of repeats that are the same numbers, of shape (repeats, views, rows, columns)."""
    count = len(lines)
    return [(a, b) for a in range(count) for b in range(a + 1, count) if np.array_equal(lines[a], lines[b])]


def odd_ones(lines: np.ndarray, usable: np.ndarray) -> list[tuple[int, float]]:
    """Repeats that differ from the mean of the others by more than noise, a scale and an offset.

    Parameters
    ----------
    lines : ndarray, shape (repeats, views, rows, columns)
    usable : ndarray of bool, shape (views, rows, columns)

    Returns
    -------
    list of tuple of int and float
        Which, and the mean square of its block means over that of noise; none or one. Of two, either stands for both.
    """
    count = len(lines)
    if count < 2:
        return []
    blocks = Blocks.of(usable.shape, PARTS)
    squares = [_apart(lines, k, usable, blocks) for k in range(count)]
    worst = int(np.argmax(squares))
    rest = np.delete(lines, worst, axis=0)
    # One that is odd pulls the mean of the others for all of them: the others are judged without it.
    others = [_apart(rest, k, usable, blocks) for k in range(count - 1)] if count > 2 else [1.0]
    odd = squares[worst] > APART and squares[worst] > TIMES * max(float(np.median(others)), 1.0)
    return [(worst, squares[worst])] if odd else []


def _apart(lines: np.ndarray, which: int, usable: np.ndarray, blocks: Blocks) -> float:
    """Mean square of block means of a repeat's difference from the others, over that of noise."""
    mean = np.delete(lines, which, axis=0).mean(axis=0, dtype=np.float64)
    scale, offset = np.polyfit(mean[usable], lines[which][usable].astype(np.float64), 1)
    difference = np.where(usable, lines[which] - scale * mean - offset, 0.0)
    rays = blocks.sum(usable)
    full = rays >= LEAST_RAYS
    if not full.any():
        return 0.0
    sums, squares, rays = blocks.sum(difference)[full], blocks.sum(difference**2)[full], rays[full]
    variance = (squares - sums**2 / rays) / (rays - 1)
    return float(np.mean(sums**2 / rays / np.maximum(variance, 1e-300)))
