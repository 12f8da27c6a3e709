"""Placement of labels next to points, with least overlap."""

from collections.abc import Sequence

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.transforms import Affine2D, Transform

from . import style

POINT = 4.0  # diameter of a marker, points
LETTER = 0.64 * style.FONT_POINTS  # width of a digit with its spacing
HALO = [patheffects.withStroke(linewidth=1.5, foreground="white")]
STEPS = (6.0, 9.0, 13.0, 18.0)  # tried distances between a point and its label, in points (1/72 inch)
DIRECTIONS = 12  # tried directions at each distance
FARTHER = 0.2  # cost of one point of distance, relative to the cost of covering one obstacle


def to_points(axes: Axes) -> Transform:
    """Return the transform from data coordinates to points (1/72 inch)."""
    return axes.transData + axes.get_figure().dpi_scale_trans.inverted() + Affine2D().scale(72)


def marker_boxes(axes: Axes, positions: np.ndarray) -> list[tuple[float, ...]]:
    """Return boxes, in points, around markers at `positions` (data coordinates)."""
    half = POINT / 2
    return [(x - half, y - half, x + half, y + half) for x, y in to_points(axes).transform(positions)]


def label_points(axes: Axes, names: Sequence[str], positions: np.ndarray, obstacles: Sequence[tuple[float, ...]]):
    """Write names next to positions (data coordinates) where they cover few obstacles (boxes in points)."""
    transform = to_points(axes)
    sizes = np.array([(LETTER * len(name), style.FONT_POINTS) for name in names])
    frame = transform.transform(np.transpose([axes.get_xlim(), axes.get_ylim()])).ravel()
    centers = transform.inverted().transform(place_labels(transform.transform(positions), sizes, obstacles, frame))
    for name, center in zip(names, centers, strict=True):
        axes.text(*center, name, ha="center", va="center", zorder=4, path_effects=HALO)


def place_labels(
    points: np.ndarray, sizes: np.ndarray, obstacles: Sequence[tuple[float, float, float, float]], frame: np.ndarray
) -> np.ndarray:
    """Place labels next to their points such that they cover few obstacles and few earlier labels.

    All lengths are in points (1/72 inch).

    Parameters
    ----------
    points, sizes : ndarray, shape (labels, 2)
        Position (x, y) of the points, and width and height of the labels.
    obstacles : sequence of tuple of float
        Boxes: x low, y low, x high, y high.
    frame : ndarray, shape (4,)
        Box that contains all labels.

    Returns
    -------
    ndarray, shape (labels, 2)
        Centers of the labels.
    """
    boxes = np.array(obstacles, dtype=float).reshape(-1, 4)
    angles = -np.pi / 4 + 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS  # the lower right first
    placed = []
    for point, size in zip(points, sizes, strict=True):
        best, least = point, np.inf
        for step in STEPS:
            for direction in np.stack([np.cos(angles), np.sin(angles)], axis=1):
                center = point + direction * (step + (size / 2 - size.min() / 2))
                box = np.concatenate([center - size / 2, center + size / 2])
                if (box[:2] < frame[:2]).any() or (box[2:] > frame[2:]).any():
                    continue
                covered = ((boxes[:, :2] < box[2:]) & (boxes[:, 2:] > box[:2])).all(axis=1).sum()
                if (cost := covered + FARTHER * (step - STEPS[0])) < least:
                    best, least = center, cost
        placed.append(best)
        boxes = np.vstack([boxes, [*(best - size / 2), *(best + size / 2)]])
    return np.array(placed).reshape(-1, 2)
