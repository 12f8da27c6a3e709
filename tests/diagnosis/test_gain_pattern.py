"""Gain patterns in residuals with noise that differs from pixel to pixel."""

import numpy as np
import pytest
from scipy import stats

from virtual_phantom.diagnosis.noise.gain_pattern import estimate

VIEWS, COLUMNS = 32, 112
# Standard deviation of the noise: a few columns of air beside a thick object.
SD = np.where(abs(np.arange(COLUMNS) - (COLUMNS - 1) / 2) > 45, 0.0015, 0.012)


def estimated(rms: float, random: np.random.Generator):
    residual = SD * random.standard_normal((VIEWS, 4, COLUMNS)) + rms * random.standard_normal((4, COLUMNS))
    return estimate(residual, np.broadcast_to(SD**-2.0, residual.shape))


def test_p_values_are_uniform_without_a_pattern():
    random = np.random.default_rng(3)
    found = np.array([estimated(0.0, random).p for _ in range(400)])
    # Half of the likelihood ratios are 0, with a p-value of 1.
    assert 0.35 < (found == 1).mean() < 0.65
    assert stats.kstest(found[found < 1] * 2, "uniform").pvalue > 0.01


def test_columns_with_little_noise_show_a_pattern_below_the_noise_of_others():
    random = np.random.default_rng(4)
    found = [estimated(0.001, random) for _ in range(40)]
    assert max(pattern.p for pattern in found) < 1e-4
    values, errors = (np.array([getattr(pattern, key) for pattern in found]) for key in ("rms", "error"))
    assert values.mean() == pytest.approx(0.001, rel=0.03)
    assert values.std() == pytest.approx(errors.mean(), rel=0.25)


def test_pixels_without_neighbors_show_no_pattern():
    """They have no rough part: a lone pixel among missing ones, and detectors too small for a smooth part."""
    random = np.random.default_rng(5)
    for shape, good in (
        ((20, 4, 60), np.arange(60) == 30),
        ((20, 4, 5), np.ones(5, bool)),
        ((20, 4, 60), np.zeros(60)),
    ):
        found = estimate(random.standard_normal(shape), np.broadcast_to(good * 1.0, shape))
        assert (found.rms, found.p) == (0.0, 1.0)
        assert not found.values.any()
    residual = 0.01 * random.standard_normal((20, 4, 60))
    weight = np.where((np.arange(60) < 40) | (np.arange(60) == 55), 1e4, 0) * np.ones(residual.shape)
    alone, without = estimate(residual, weight), estimate(residual, np.where(np.arange(60) == 55, 0, weight))
    assert alone.p == pytest.approx(without.p, rel=1e-6)
