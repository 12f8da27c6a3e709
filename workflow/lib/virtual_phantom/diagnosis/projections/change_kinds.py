"""Kinds of change of projections: a basis without physics, ordered by the variables that a change depends on."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.sparse import csr_array, sparray

HARMONICS = 3  # of the view angle, for periodic motion of the object or the source
MOST_VIEWS = 240  # separate directions for views; run time grows with the cube, so more views share directions
PARTS = 8  # of the columns, at least the number of detector modules


def kinds(
    lines: np.ndarray, angles_rad: np.ndarray, usable: np.ndarray, in_all_views: bool = True
) -> Iterator[tuple[str, np.ndarray | sparray]]:
    """Yield the directions of every kind of change, one kind at a time: all together need the memory of 70 scans.

    Parameters
    ----------
    lines : ndarray, shape (views, rows, columns)
        Line integrals that a model predicts.
    angles_rad : ndarray, shape (views,)
        Angles of the source.
    usable : ndarray of bool, shape (views, rows, columns)
    in_all_views : bool, optional
        Whether fitted and held-out data have the same views. Otherwise changes of single views, and of odd and even
        views, cannot be tested.

    Yields
    ------
    words : str
        Description. Kinds that a scan with one view, row or column cannot show are omitted.
    directions : ndarray or sparse array, shape (rays, directions)
        Changes of line integrals.
    """
    views, rows, columns = lines.shape
    time, row, column = (np.linspace(-1, 1, n) if n > 1 else np.zeros(1) for n in lines.shape)
    time, row, column = time[:, None, None], row[:, None], column
    turns = [wave(k * angles_rad)[:, None, None] for k in range(1, HARMONICS + 1) for wave in (np.cos, np.sin)]
    odd = [1 - 2.0 * (np.arange(n) % 2) for n in lines.shape]
    by_view, by_row, by_column = (_slope(lines, axis) for axis in range(3))
    odd_views = [odd[0][:, None, None]] if in_all_views else []
    of_pixels = [column, column**2, row, row**2, odd[2]]
    last = np.minimum(np.arange(columns) * PARTS // columns, PARTS - 1)
    parts = [(last == part).astype(float) for part in range(PARTS)]
    of_views = [*turns, time, time**2]
    dense = {
        "depends on the line integral alone": lambda: [lines**2, lines**3, np.exp(-lines), np.exp(lines - lines.max())],
        "varies from view to view, equally in all pixels": lambda: of_views + odd_views,
        "varies by column and is the same in every view": lambda: [column**k for k in (1, 2, 3, 4)] + [odd[2]],
        "varies by row and is the same in every view": lambda: [row, row**2, odd[1][:, None]],
        "drifts differently by column or row": lambda: [time * k for k in (column, column**2, column**3, row)],
        "scales line integrals by a factor that varies by view": lambda: [lines * factor for factor in of_views],
        "scales line integrals by a factor that varies by pixel": lambda: [lines * factor for factor in of_pixels],
        "blurs along columns": lambda: [_slope(by_column, 2), by_column**2],
        "blurs along rows": lambda: [_slope(by_row, 1), by_row**2],
        "blurs from view to view": lambda: [by_view, _slope(by_view, 0), by_view**2],
        "shifts views along columns": lambda: [by_column * shift for shift in (1.0, column, *of_views)],
        "shifts views along rows": lambda: [by_row * shift for shift in (1.0, row, *of_views)],
        "shifts parts of the detector along columns": lambda: [by_column * part for part in parts],
    }
    for words, fields in dense.items():
        fields = [field for field in fields() if np.ptp(field) > 0]
        if fields:
            yield words, np.stack([np.broadcast_to(field, lines.shape).ravel() for field in fields], axis=1)
    if views > 1 and in_all_views:
        yield "affects single views only", _each_view([np.ones(lines.shape), lines, by_column], usable)


def _slope(values: np.ndarray, axis: int) -> np.ndarray:
    return np.gradient(values, axis=axis) if values.shape[axis] > 1 else np.zeros_like(values)


def _each_view(fields: list[np.ndarray], usable: np.ndarray) -> sparray:
    """Return one direction per field and view, or per group of neighboring views."""
    views = min(len(usable), MOST_VIEWS)
    view = np.broadcast_to((np.arange(len(usable)) * views // len(usable))[:, None, None], usable.shape)[usable]
    ray = np.flatnonzero(usable.ravel())
    values = np.concatenate([field[usable] for field in fields])
    places = np.concatenate([views * k + view for k in range(len(fields))])
    return csr_array((values, (np.tile(ray, len(fields)), places)), shape=(usable.size, len(fields) * views))
