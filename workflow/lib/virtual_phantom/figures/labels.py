"""Labels beside points, where they hide least."""

from collections.abc import Sequence

import numpy as np

STEPS = (6.0, 9.0, 13.0, 18.0)  # from the point to the middle of a label beside the half of its size, points
DIRECTIONS = 12  # that are tried at each step
FARTHER = 0.2  # what a point of distance costs, in hidden obstacles: a near place that hides little wins


def place_labels(
    points: np.ndarray, sizes: np.ndarray, obstacles: Sequence[tuple[float, float, float, float]], frame: np.ndarray
) -> np.ndarray:
    """Where labels stand that hide as few obstacles, and as few labels before them, as possible.

    Parameters
    ----------
    points : ndarray, shape (labels, 2)
        What they belong to: x, y. All lengths are in one unit, points (1/72 inch).
    sizes : ndarray, shape (labels, 2)
        Width and height.
    obstacles : sequence of tuple of float
        Boxes: x low, y low, x high, y high.
    frame : ndarray, shape (4,)
        The box that labels stay in.

    Returns
    -------
    ndarray, shape (labels, 2)
        Their middles.
    """
    boxes = np.array(obstacles, dtype=float).reshape(-1, 4)
    angles = -np.pi / 4 + 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS  # first to the lower right
    placed = []
    for point, size in zip(points, sizes, strict=True):
        best, least = point, np.inf
        for step in STEPS:
            for way in np.stack([np.cos(angles), np.sin(angles)], axis=1):
                middle = point + way * (step + (size / 2 - size.min() / 2))
                box = np.concatenate([middle - size / 2, middle + size / 2])
                if (box[:2] < frame[:2]).any() or (box[2:] > frame[2:]).any():
                    continue
                hidden = ((boxes[:, :2] < box[2:]) & (boxes[:, 2:] > box[:2])).all(axis=1).sum()
                if (cost := hidden + FARTHER * (step - STEPS[0])) < least:
                    best, least = middle, cost
        placed.append(best)
        boxes = np.vstack([boxes, [*(best - size / 2), *(best + size / 2)]])
    return np.array(placed).reshape(-1, 2)
