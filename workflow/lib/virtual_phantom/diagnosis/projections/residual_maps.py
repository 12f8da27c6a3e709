"""Locations where recorded projections and a model differ beyond noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import stats

from ..residuals.residual_tests import (
    EDGE_SHARE,
    Alike,
    Half,
    HalfProducts,
    Location,
    blocks,
    by_value,
    corrected,
    extreme,
    noise_places,
    steep,
    steepest,
)
from .observed import ObservedScans

AXES = ("views", "rows", "columns")
THIN = 0.05  # of the largest line integral, below which rays miss the object


def locate(
    residuals: list[np.ndarray],
    weights: list[np.ndarray],
    data: ObservedScans,
    constants: np.ndarray | None = None,
    fitted: Half | None = None,
    more: Sequence[Location] = (),
    uncertain: Sequence[np.ndarray] | None = None,
    step: int = 1,
) -> list[Location]:
    """Return the worst location of every domain of residuals.

    A domain has the p-value of its worst place or of the sum of squares over all places, the smaller one, times two.

    Parameters
    ----------
    residuals, weights : list of ndarray, shape (data,)
        By part, with whitened noise (Fitter).
    constants : ndarray, shape (rows, columns), optional
        Variance of each pixel's constant in a fitted gain pattern.
    fitted : Half, optional
        The fitted data, if `residuals` are of held-out data.
    more : sequence of Location, optional
        Domains other than residuals.
    uncertain : sequence of ndarray, shape (directions, data), optional
        Errors of the fitted parameters, by part (left_by_numbers).
    step : int, optional
        Step between the recording's views that were taken. Places have the numbers of the recording.

    Returns
    -------
    list of Location
        The worst first, p corrected over places (Bonferroni) and domains (Holm).
    """
    shape = data.mean.shape
    residual, weight = residuals[0].reshape(shape), weights[0].reshape(shape)
    predicted = data.mean - data.as_recorded(residual)  # recorded values would sort rays by their noise
    left = np.zeros(shape[1:]) if constants is None else constants
    pixels = weight.sum(axis=0)
    # The uncertainty of a pixel's constant adds to the variance of a sum over views.
    extra = pixels**2 * left
    of_views = (weight**2 * left).sum((1, 2))
    numbers = () if uncertain is None else uncertain[0].reshape(-1, *shape)
    alike = Alike(weight, [*data.numerical, *numbers], data.scatter)
    of = f" of {shape[0]}" if step == 1 else f", 1 of {step} views compared"
    found = [
        extreme(
            "columns", _marginal(residual, weight, (0, 1), extra.sum(0), alike), lambda i: f"column {i} of {shape[2]}"
        ),
        extreme("rows", _marginal(residual, weight, (0, 2), extra.sum(1), alike), lambda i: f"row {i} of {shape[1]}"),
        extreme("views", _marginal(residual, weight, (1, 2), of_views, alike), lambda i: f"view {step * i}{of}"),
        blocks("projections", _block_z(residual, weight, data, left, alike), data, AXES, data.weighed, step),
        _path_lengths(residual, weight, predicted, alike),
        _edges(residual, weight, predicted, numbers, data),
        _pixels(_marginal(residual, weight, 0, extra, alike), pixels),
    ]
    if fitted is not None:
        common = Half(residuals, weights, data).in_common(fitted)
        if common.there.any():  # halves of the views share no ray
            found.append(_both_halves(common, steep(weight, _slope(predicted)).ravel()))
    pairs = [f"neighboring {name}" for name in AXES[::-1]]
    found += noise_places(residuals, weights, data, pairs, AXES, fitted, uncertain, step)
    if data.white is not None:
        z = residuals[-1] * np.sqrt(weights[-1])
        found.append(extreme("white field", z, lambda i: f"shape {i + 1} (orders along columns, then rows)"))
    return corrected([*found, *more])


def _marginal(residual, weight, axes, extra, alike: Alike) -> np.ndarray:
    total = weight.sum(axis=axes)
    extra = extra + alike(lambda one: one.sum(axis=axes))
    return (residual * weight).sum(axis=axes) / np.sqrt(np.where(total > 0, total + extra, np.inf))


def _block_z(residual, weight, data, left, alike) -> np.ndarray:
    total = data.blocks.sum(weight)
    views, parts = weight.shape[0], data.blocks.shape[0]
    starts = [-(-views * i // parts) for i in range(parts)]  # as Blocks.of divides them
    pixels = np.add.reduceat(weight, starts, axis=0)
    extra = np.zeros(data.blocks.count) + alike.of_block(data.blocks.sum)
    for part, start in enumerate(starts):
        extra += np.bincount(data.blocks.index[start].ravel(), (pixels[part] ** 2 * left).ravel(), data.blocks.count)
    return data.blocks.sum(residual * weight) / np.sqrt(np.where(total > 0, total + extra, np.inf))


def _path_lengths(residual, weight, predicted, alike) -> Location:
    """Return the worst range of line integrals."""
    inside = (weight > 0) & (predicted > THIN * predicted.max())
    return by_value("path length", "line integrals {:.2f} to {:.2f}", residual, weight, predicted, inside, alike)


def _edges(residual, weight, predicted, numbers, data: ObservedScans) -> Location:
    """Return the rays where line integrals change most, which show blur, geometry and motion."""
    slope = _slope(predicted)
    # All rays of a block share one measured variance.
    of_weights = float((data.blocks.sum(steep(weight, slope)) ** 2 * data.weighed).sum())
    return steepest("rays", residual, weight, slope, numbers, of_weights)


def excess_at_edges(half: Half) -> float | None:
    """Return the share of the chi-square beyond noise in the steepest rays; None if nothing exceeds noise."""
    shape = half.data.mean.shape
    residual, weight = half.residuals[0].reshape(shape), half.weights[0].reshape(shape)
    excess = weight * residual**2 - (weight > 0)
    if not excess.sum() > 0:
        return None
    chosen = steep(weight, _slope(half.data.mean - half.data.as_recorded(residual)))
    return float(excess[chosen].sum() / excess.sum())


def _slope(predicted) -> np.ndarray:
    return np.abs(np.gradient(predicted, axis=2)) if predicted.shape[2] > 1 else np.zeros_like(predicted)


def _both_halves(common: HalfProducts, steep: np.ndarray) -> Location:
    """Return the correlation of fitted and held-out residuals, for all rays or for the steepest.

    Unlike a sum of squares it does not depend on the noise level, and it detects differences that are spread too thinly
    over all rays to be significant at any location.

    Parameters
    ----------
    steep : ndarray of bool, shape (rays,)
    """
    words = ("all rays", f"the {100 * EDGE_SHARE:.0f} % steepest rays")
    return extreme("both halves", np.array([common.z(), common.z(steep)]), lambda i: words[i])


def _pixels(z, pixels) -> Location:
    """Return the sum of squares of each pixel's mean over all views, which shows rings."""
    square, count = float((z**2).sum()), int((pixels > 0).sum())
    excess = (square - count) / np.sqrt(2 * max(count, 1))
    return Location("pixels", "all pixels, mean over views", float(excess), float(stats.chi2.sf(square, count)), z)
