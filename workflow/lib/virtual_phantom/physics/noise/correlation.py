"""Noise correlation between neighboring rays, caused by crosstalk and afterglow."""

from __future__ import annotations

import numpy as np

from ..state import Sharing, State, interpolate_views, with_afterglow, with_crosstalk

AXES = (2, 1, 0)  # columns, rows, views: order of the correlations, as axes of arrays [view, row, column]


def correlations(state: State, weight: np.ndarray | None = None) -> np.ndarray:
    """Return the expected noise correlation of neighboring columns, rows and views.

    This is the mean covariance of pairs divided by the mean variance. It is exact to first order in the noise and
    includes detector edges, electronic noise and steep signals.

    Parameters
    ----------
    weight : ndarray, shape (views, rows, columns), optional
        Factor of the variances before they are averaged; 0 excludes a ray. None: the inverse variance.

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
    slope = np.broadcast_to(1 / state.signal_per_line_integral, state.signal.shape)  # d(line integral) / d(signal)
    root = np.sqrt(weight) * np.abs(slope)
    mean = float((weight * variance).sum()) / max(1, np.count_nonzero(weight))
    for index, axis in enumerate(AXES):
        covariance = _covariance(state, axis)
        if covariance is None or not mean:
            continue
        length = root.shape[axis]
        weights = np.take(root, range(length - 1), axis) * np.take(root, range(1, length), axis)
        pairs = np.count_nonzero(weights)
        found[index] = float((weights * covariance).sum()) / max(1, pairs) / mean
    return found


def _covariance(state: State, axis: int) -> np.ndarray | None:
    """Return the covariance of neighbors along an axis due to quantum noise; None without correlation."""
    quantum, length = state.noise / state.photons, state.signal.shape[axis]
    if length < 2:
        return None
    others = tuple(0.0 if of == axis else share for of, share in zip((2, 1), state.neighbours, strict=True))
    quantum = with_crosstalk(quantum, others, state.tail, squared=True)
    if axis == 0:
        return _covariance_of_views(quantum, state.lag, state.geometry.views_apart) if state.lag[0] else None
    share = state.neighbours[0 if axis == 2 else 1]
    if not share:
        return None
    pairs = Sharing.of(share, state.tail, length).between_neighbors(quantum, axis)
    return with_afterglow(pairs, state.lag, squared=True, step=state.geometry.views_apart)


def _covariance_of_views(quantum: np.ndarray, lag: tuple[float, float, float], step: int) -> np.ndarray:
    """Return the covariance of views i and i + step for y_i = (1 - k) n_i + k g_i, g_(i+1) = d g_i + (1 - d) n_i.

    Parameters
    ----------
    quantum : ndarray, shape (views, rows, columns)
    lag : tuple of 3 float
        As State.lag.
    step : int
        Scanner views from one view to the next; views in between are interpolated.
    """
    share, memory, before = lag
    quantum = interpolate_views(quantum, step)
    glow = before**2 * quantum[0] * (1 - memory) / (1 + memory)  # variance of g
    found = np.empty((len(quantum) - 1, *quantum.shape[1:]))
    for view in range(len(found)):
        found[view] = (1 - share) * share * (1 - memory) * quantum[view] + share**2 * memory * glow
        glow = memory**2 * glow + (1 - memory) ** 2 * quantum[view]
    return found[::step] * memory ** (step - 1)
