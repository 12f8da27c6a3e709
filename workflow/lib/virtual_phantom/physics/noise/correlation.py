"""Correlations of the noise of neighbouring rays, as a detector reads it that shares light or glows on."""

from __future__ import annotations

import numpy as np

from ..state import State, between, blurred, lagged

AXES = (2, 1, 0)  # of [view, row, column], in the order in which correlations are given


def correlations(state: State, weight: np.ndarray | None = None) -> np.ndarray:
    """Correlations of the noise of neighbouring columns, rows and views, as repeats show them on average.

    The mean covariance of pairs over the mean variance. Exact to first order in the noise, the detector's edges,
    electronic noise and steep signals included.

    Parameters
    ----------
    weight : ndarray, shape (views, rows, columns), optional
        What variances are multiplied by before they are averaged; 0 leaves a ray out; None: the inverse of each ray's
        variance.

    Returns
    -------
    ndarray, shape (3,)
        0 along an axis of one pixel.
    """
    found = np.zeros(3)
    if not (any(state.neighbours) or state.lag[0]):
        return found
    variance = state.variance()
    weight = 1 / variance if weight is None else weight
    root = np.sqrt(weight) * np.abs(_of_line_integrals(state))
    mean = float((weight * variance).sum()) / max(1, np.count_nonzero(weight))
    for place, axis in enumerate(AXES):
        covariance = _covariance(state, axis)
        if covariance is None or not mean:
            continue
        both = _neighbours(root, axis)
        pairs = np.count_nonzero(both)
        found[place] = float((both * covariance).sum()) / max(1, pairs) / mean
    return found


def _of_line_integrals(state: State) -> np.ndarray:
    """Change of a line integral with the signal that is read: [view, row, column]."""
    return np.broadcast_to(1 / state.per_line, state.signal.shape)


def _neighbours(array: np.ndarray, axis: int) -> np.ndarray:
    """Products of neighbours along an axis."""
    length = array.shape[axis]
    return np.take(array, range(length - 1), axis) * np.take(array, range(1, length), axis)


def _covariance(state: State, axis: int) -> np.ndarray | None:
    """Of the quantum noise of neighbours along an axis, of the signal as it is read.

    Returns
    -------
    ndarray or None
        One place less along the axis; None if there is none. Electronic noise has none.
    """
    quantum, length = state.noise / state.photons, state.signal.shape[axis]
    if length < 2:
        return None
    for other, share in zip((2, 1), state.neighbours, strict=True):
        if other != axis and share and quantum.shape[other] > 1:
            quantum = blurred(quantum, share, other, squared=True)
    if axis == 0:
        return _of_views(quantum, state.lag, state.geometry.views_apart) if state.lag[0] else None
    share = state.neighbours[0 if axis == 2 else 1]
    if not share:
        return None
    # Both pixels see both: by what each keeps, and what it gets of the other. Edges keep what would leave them.
    keeps = np.full(length, 1 - 2 * share)
    keeps[[0, -1]] += share
    kept = quantum * (keeps if axis == 2 else keeps[:, None])
    pairs = share * (np.take(kept, range(length - 1), axis) + np.take(kept, range(1, length), axis))
    return lagged(pairs, state.lag, squared=True, apart=state.geometry.views_apart)


def _of_views(quantum: np.ndarray, lag: tuple[float, float, float], apart: int) -> np.ndarray:
    """read_i = (1 - k) n_i + k g_i and g_(i+1) = d g_i + (1 - d) n_i: of i and i + a.

    Parameters
    ----------
    quantum : ndarray, shape (views, rows, columns)
    lag : tuple of 3 float
        As State.lag.
    apart : int
        a, of the scanner's views; those between are interpolated.

    Returns
    -------
    ndarray, shape (views - 1, rows, columns)
    """
    share, memory, before = lag
    quantum = between(quantum, apart)
    glow = before**2 * quantum[0] * (1 - memory) / (1 + memory)
    found = np.empty((len(quantum) - 1, *quantum.shape[1:]))
    for view in range(len(found)):
        found[view] = (1 - share) * share * (1 - memory) * quantum[view] + share**2 * memory * glow
        glow = memory**2 * glow + (1 - memory) ** 2 * quantum[view]
    return found[::apart] * memory ** (apart - 1)
