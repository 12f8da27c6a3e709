"""Locations where recorded projections and a model differ beyond noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import stats

from ..noise.gain_pattern import Pattern
from ..residuals.residual_tests import (
    EDGE_SHARE,
    DomainTest,
    ExtraVariance,
    HalfProducts,
    HalfResiduals,
    blocks,
    by_value,
    extreme,
    holm_corrected,
    noise_tests,
    standardized,
    steep,
    steepest,
)
from .observed import ObservedScans

AXES = ("views", "rows", "columns")
THIN = 0.05  # of the largest line integral, below which rays miss the object


def domain_tests(
    half: HalfResiduals,
    pattern: Pattern | None = None,
    fitted: HalfResiduals | None = None,
    more: Sequence[DomainTest] = (),
    uncertain: Sequence[np.ndarray] | None = None,
    step: int = 1,
) -> list[DomainTest]:
    """Test every domain of residuals for its worst location.

    The p-value of a domain is twice the smaller one of two: of its worst location, and of the sum of squares over all
    locations.

    Parameters
    ----------
    pattern : Pattern, optional
        Fitted pattern of pixels. The uncertainty of its constants adds to the variance of sums.
    fitted : HalfResiduals, optional
        The fitted data, if `half` is held out.
    more : sequence of DomainTest, optional
        Domains other than residuals.
    uncertain : sequence of ndarray, shape (directions, data), optional
        Changes by errors of the fitted parameters, by part (changes_by_parameter_errors).
    step : int, optional
        Step between the used views. Texts have the numbers of the recording.

    Returns
    -------
    list of DomainTest
        The worst first, with p corrected over locations (Bonferroni) and domains (Holm).
    """
    data, shape = half.data, half.data.mean.shape
    residual, weight = half.residuals[0].reshape(shape), half.weights[0].reshape(shape)
    predicted = data.mean - data.as_recorded(residual)  # recorded values would sort rays by their noise
    left = np.zeros(shape[1:]) if pattern is None else pattern.variance
    pixels, moved = weight.sum(axis=0), weight if pattern is None else pattern.over_data(weight)
    extra = moved.sum(axis=0) ** 2 * left
    of_views = (moved**2 * left).sum((1, 2))
    numbers = () if uncertain is None else uncertain[0].reshape(-1, *shape)
    variance = ExtraVariance(weight, [*data.numerical, *numbers], data.weight_variance)
    of = f" of {shape[0]}" if step == 1 else f", 1 of {step} views compared"

    def marginal(axes, extra) -> np.ndarray:
        extra = extra + variance(lambda values: values.sum(axis=axes))
        return standardized((residual * weight).sum(axis=axes), weight.sum(axis=axes), extra)

    z_of_blocks = _block_z(residual, weight, data, moved, left, variance)
    found = [
        extreme("columns", marginal((0, 1), extra.sum(0)), lambda i: f"column {i} of {shape[2]}"),
        extreme("rows", marginal((0, 2), extra.sum(1)), lambda i: f"row {i} of {shape[1]}"),
        extreme("views", marginal((1, 2), of_views), lambda i: f"view {step * i}{of}"),
        blocks("projections", z_of_blocks, data, AXES, data.block_weight_variance, step),
        _path_lengths(residual, weight, predicted, variance),
        _edges(residual, weight, predicted, numbers, data),
        _pixels(marginal(0, extra), pixels),
    ]
    if fitted is not None:
        common = half.in_common(fitted)
        if common.there.any():  # halves of the views share no ray
            found.append(_both_halves(common, steep(weight, _slope(predicted)).ravel()))
    pairs = [f"neighboring {name}" for name in AXES[::-1]]
    found += noise_tests(half, pairs, AXES, fitted, uncertain, step)
    if data.white is not None:
        z = half.residuals[-1] * np.sqrt(half.weights[-1])
        found.append(extreme("white field", z, lambda i: f"shape {i + 1} (orders along columns, then rows)"))
    return holm_corrected([*found, *more])


def _block_z(residual, weight, data, moved, left, variance: ExtraVariance) -> np.ndarray:
    starts = data.blocks.bounds(0)[:-1]
    pixels = np.add.reduceat(moved, starts, axis=0)
    extra = np.zeros(data.blocks.count) + variance.of_block(data.blocks.sum)
    for part, start in enumerate(starts):
        extra += np.bincount(data.blocks.index[start].ravel(), (pixels[part] ** 2 * left).ravel(), data.blocks.count)
    return standardized(data.blocks.sum(residual * weight), data.blocks.sum(weight), extra)


def _path_lengths(residual, weight, predicted, variance: ExtraVariance) -> DomainTest:
    """Test ranges of line integrals."""
    inside = (weight > 0) & (predicted > THIN * predicted.max())
    return by_value("path length", "line integrals {:.2f} to {:.2f}", residual, weight, predicted, inside, variance)


def _edges(residual, weight, predicted, numbers, data: ObservedScans) -> DomainTest:
    """Test the rays where line integrals change most, which show blur, geometry and motion."""
    slope = _slope(predicted)
    # All rays of a block share one measured variance.
    of_weights = float((data.blocks.sum(steep(weight, slope)) ** 2 * data.block_weight_variance).sum())
    return steepest("rays", residual, weight, slope, numbers, of_weights)


def excess_at_edges(half: HalfResiduals) -> float:
    """Return the share of the chi-square beyond noise in the steepest rays; 0 if nothing exceeds noise."""
    shape = half.data.mean.shape
    residual, weight = half.residuals[0].reshape(shape), half.weights[0].reshape(shape)
    excess = weight * residual**2 - (weight > 0)
    if not excess.sum() > 0:
        return 0.0
    chosen = steep(weight, _slope(half.data.mean - half.data.as_recorded(residual)))
    return float(excess[chosen].sum() / excess.sum())


def _slope(predicted) -> np.ndarray:
    return np.abs(np.gradient(predicted, axis=2)) if predicted.shape[2] > 1 else np.zeros_like(predicted)


def _both_halves(common: HalfProducts, steep: np.ndarray) -> DomainTest:
    """Test the correlation of fitted and held-out residuals, for all rays and for the steepest.

    Unlike a sum of squares, the correlation does not depend on the noise level. It also detects small differences in
    all rays that are not significant at any location.

    Parameters
    ----------
    steep : ndarray of bool, shape (rays,)
    """
    words = ("all rays", f"the {100 * EDGE_SHARE:.0f} % steepest rays")
    return extreme("both halves", np.array([common.z(), common.z(steep)]), lambda i: words[i])


def _pixels(z, pixels) -> DomainTest:
    """Test the sum of squares of each pixel's mean over all views, which shows rings."""
    square, count = float((z**2).sum()), int((pixels > 0).sum())
    excess = (square - count) / np.sqrt(2 * max(count, 1))
    return DomainTest("pixels", "all pixels, mean over views", float(excess), float(stats.chi2.sf(square, count)), z)
