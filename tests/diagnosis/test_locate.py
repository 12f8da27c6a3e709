"""Locations of a difference with measured weights, against Student's distribution and simulated noise."""

import numpy as np
import pytest
from scipy import stats

from virtual_phantom.diagnosis.noise.condensed import Blocks
from virtual_phantom.diagnosis.projections.observed import PARTS, ObservedScans
from virtual_phantom.diagnosis.projections.residual_maps import domain_tests
from virtual_phantom.diagnosis.residuals.residual_tests import HalfResiduals, normal_scores

SHAPE = (24, 4, 32)


@pytest.mark.parametrize("freedom", [10, 30, 144])
def test_scores_of_measured_weights_follow_student_t(freedom):
    """z with unbiased weights is t times sqrt((n - 2) / n)."""
    z = np.array([-6.0, -4.0, -2.0, 0.5, 3.0, 5.0])
    t = z * np.sqrt(freedom / (freedom - 2))
    rare = np.sign(z) * stats.norm.isf(stats.t.sf(np.abs(t), freedom))
    np.testing.assert_allclose(normal_scores(z, 2 / freedom), rare, rtol=4e-3)


def test_scores_of_known_weights_are_unchanged():
    z = np.array([-300.0, 0.0, 7.0])
    np.testing.assert_array_equal(normal_scores(z, 0.0), z)
    assert np.isfinite(normal_scores(1e4 * z, 0.01)).all()


def observed(blocks: Blocks, weights) -> ObservedScans:
    everything = np.ones(SHAPE)
    missing = dict.fromkeys(("variance", "variance_error", "correlation", "correlation_error", "white"))
    return ObservedScans(everything, 2, everything > 0, blocks, everything, **missing, block_weight_variance=weights)


def test_measured_weights_do_not_raise_the_score_of_a_location():
    """Noise variance 1, measured with 20 degrees of freedom per block:

    sums over blocks vary by 6 % more than by their weights.
    """
    random = np.random.default_rng(np.random.SeedSequence(11))
    blocks, freedom = Blocks.of(SHAPE, (4, 2, 4)), 20
    data = observed(blocks, np.full(blocks.count, 2 / (freedom - 4)))
    found: dict[str, list] = {}
    for _ in range(200):
        weight = blocks.spread((freedom - 2) / random.chisquare(freedom, blocks.count)).ravel()
        for place in domain_tests(HalfResiduals([random.normal(size=weight.size)], [weight], data)):
            found.setdefault(place.domain, []).append(place.map.ravel())
    for domain in ("columns", "rows", "views", "pixels", "projections"):
        z = np.concatenate(found[domain])
        assert np.sqrt((z**2).mean()) == pytest.approx(1, abs=4 / np.sqrt(2 * z.size) + 0.005), domain


def test_products_of_both_halves_vary_by_the_square_of_their_weights():
    """The mean square of a weight with relative variance s is 1 + s."""
    one, other = (np.full(np.prod(SHAPE), value) for value in (1.5, 0.5))
    data = observed(Blocks.of(SHAPE, PARTS), np.full(Blocks.of(SHAPE, PARTS).count, 3.0))
    common = HalfResiduals([one], [np.ones(one.size)], data).in_common(
        HalfResiduals([other], [np.ones(one.size)], data)
    )
    assert common.z() == pytest.approx(0.75 * one.size / np.sqrt(4 * one.size))
