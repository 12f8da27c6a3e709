"""Where recorded projections and a model differ beyond noise."""

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
THIN = 0.05  # of the largest line integral: rays with less pass beside the object


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
    """Standardised residuals of every domain.

    A domain counts by its worst place or by the sum of squares over all places, whichever is less likely, times two.

    Parameters
    ----------
    residuals, weights : list of ndarray, shape (data,)
        By part, as Fitter gives them: the mean's noise made white.
    constants : ndarray, shape (rows, columns), optional
        Variance that a fitted gain pattern leaves to every pixel's constant.
    fitted : Half, optional
        The data that the model was fitted to, if those are others.
    more : sequence of Location, optional
        Domains that residuals do not show.
    uncertain : sequence of ndarray, shape (directions, data), optional
        By part: what the errors of the fit's numbers add (left_by_numbers).
    step : int, optional
        One view of so many of the recording's was taken; places are called by the recording's numbers.

    Returns
    -------
    list of Location
        The worst first, p corrected over places (Bonferroni) and domains (Holm).
    """
    shape = data.mean.shape
    residual, weight = residuals[0].reshape(shape), weights[0].reshape(shape)
    predicted = data.mean - data.as_recorded(residual)  # measured values would sort rays by their own noise
    left = np.zeros(shape[1:]) if constants is None else constants
    pixels = weight.sum(axis=0)
    # A sum over views of one pixel also varies by what its constant is not known to.
    extra = pixels**2 * left
    of_views = (weight**2 * left).sum((1, 2))
    numbers = () if uncertain is None else uncertain[0].reshape(-1, *shape)
    alike = Alike(weight, [*data.numerical, *numbers], data.scatter)
    of = f" of {shape[0]}" if step == 1 else f", one in {step} being compared"
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
        if common.there.any():  # halves of the views have no ray in common
            found.append(_both_halves(common, steep(weight, _slope(predicted)).ravel()))
    pairs = [f"neighbouring {name}" for name in AXES[::-1]]
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
    """By line integral: what depends on the amount of matter alone."""
    inside = (weight > 0) & (predicted > THIN * predicted.max())
    return by_value("path length", "line integrals {:.2f} to {:.2f}", residual, weight, predicted, inside, alike)


def _edges(residual, weight, predicted, numbers, data: ObservedScans) -> Location:
    """Where line integrals change most: blur, geometry and motion show there."""
    slope = _slope(predicted)
    # All rays of a block have their weights from one measured variance.
    of_weights = float((data.blocks.sum(steep(weight, slope)) ** 2 * data.weighed).sum())
    return steepest("rays", residual, weight, slope, numbers, of_weights)


def excess_at_edges(half: Half) -> float | None:
    """Share of chi-square beyond noise that the steepest rays hold.

    Returns
    -------
    float or None
        None where nothing is beyond noise.
    """
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
    """What the data fitted and those held out have in common: of all rays, and of the steepest.

    Unlike a sum of squares this does not ask how large the noise is, and it sees what is spread too thinly over all
    rays to stand out at any place.

    Parameters
    ----------
    steep : ndarray of bool, shape (rays,)
    """
    words = ("all rays", f"the {100 * EDGE_SHARE:.0f} % steepest rays")
    return extreme("both halves", np.array([common.z(), common.z(steep)]), lambda i: words[i])


def _pixels(z, pixels) -> Location:
    """Constants of single pixels over all views: rings."""
    square, count = float((z**2).sum()), int((pixels > 0).sum())
    excess = (square - count) / np.sqrt(2 * max(count, 1))
    return Location("pixels", "all pixels, mean over views", float(excess), float(stats.chi2.sf(square, count)), z)
