"""Poisson noise against its moments, and the two models against their definitions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from virtual_phantom.base import streams
from virtual_phantom.base.counts import Counts
from virtual_phantom.base.errors import InputError
from virtual_phantom.simulation.acquire import simulate_counts

SEED = np.random.SeedSequence(7)


@pytest.mark.parametrize("noise_level", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("model", ["physical", "astra"])
def test_counts_have_poisson_mean_and_variance(noise_level, model):
    """Chi-square of the dispersion and z of the mean, each at the 0.1 % level, over 20000 pixels with the count of one
    ray.
    """
    p, p_max = 1.3, 4.0
    line_integrals = np.full((20, 40, 50), p)
    line_integrals[0, 0, 0] = p_max
    counts = simulate_counts(line_integrals, noise_level, model, SEED)
    mean = np.exp(-p / (p_max if model == "astra" else 1)) / noise_level
    sample = counts.data.ravel()[1:].astype(float)
    n = sample.size
    z = (sample.mean() - mean) / np.sqrt(mean / n)
    assert abs(z) < stats.norm.isf(0.0005)
    dispersion = np.sum((sample - mean) ** 2) / mean
    low, high = stats.chi2.interval(0.999, n)
    assert low < dispersion < high


def test_line_integrals_are_unbiased_with_the_theoretical_variance():
    """var(-s ln N) = s^2 / mean N to first order (delta method)."""
    line_integrals = np.full((10, 100, 100), 2.0)
    line_integrals[0, 0, 0] = 5.0
    counts = simulate_counts(line_integrals, 1e-5, "astra", SEED)
    back = counts.line_integrals(0.5).ravel()[1:]
    assert counts.scale == 5.0
    assert back.mean() == pytest.approx(2.0, abs=1e-3)
    assert back.var() == pytest.approx(25 * 1e-5 * np.exp(2 / 5), rel=0.03)


SINOGRAM = np.linspace(0, 7.3, 48).reshape(6, 8) ** 1.2
REPEATS, PHOTONS = 3000, 800.0  # few enough photons for skewed counts, and always over 200


@pytest.fixture(scope="module")
def astra_sinograms():
    """Result of ASTRA's own function for one sinogram, [repeat, view, column], with NumPy's global state seeded."""
    functions = pytest.importorskip("astra.functions", reason="ASTRA is not installed")
    return np.stack([functions.add_noise_to_sino(SINOGRAM, PHOTONS, seed=seed) for seed in range(REPEATS)])


def test_astra_model_equals_astras_function(astra_sinograms):
    """Mean and variance of every pixel over repeats, and the distribution of all counts of three pixels."""
    sinograms = np.broadcast_to(SINOGRAM, (REPEATS, *SINOGRAM.shape))
    counts = simulate_counts(sinograms, 1 / PHOTONS, "astra", SEED)
    actual, theirs = counts.line_integrals(0.5).astype(float), astra_sinograms
    variances = actual.var(axis=0, ddof=1), theirs.var(axis=0, ddof=1)
    z = (actual.mean(axis=0) - theirs.mean(axis=0)) / np.sqrt(sum(variances) / REPEATS)
    assert np.abs(z).max() < 4.5 and 0.7 < z.std() < 1.3
    # The logarithm of a variance of normal values has the variance 2 / n; logarithms of counts are nearly normal.
    z = np.log(variances[0] / variances[1]) / np.sqrt(4 / REPEATS)
    assert np.abs(z).max() < 4.5 and 0.7 < z.std() < 1.3
    drawn = np.rint(PHOTONS * np.exp(-theirs / SINOGRAM.max()))
    for place in ((0, 1), (3, 0), (5, 7)):
        both = stats.ks_2samp(counts.data[:, *place], drawn[:, *place])
        assert both.pvalue > 1e-4, place


def test_astra_model_has_the_scaling_of_astra(astra_sinograms):
    """Counts of ASTRA's own realization as line integrals: equal up to rounding to single precision."""
    drawn = PHOTONS * np.exp(-astra_sinograms / SINOGRAM.max())
    np.testing.assert_allclose(drawn, np.rint(drawn), atol=1e-9)
    scale = simulate_counts(SINOGRAM[None], 1 / PHOTONS, "astra", SEED).scale
    actual = Counts(np.rint(drawn).astype(np.uint32), PHOTONS, scale).line_integrals(0.5)
    np.testing.assert_allclose(actual, astra_sinograms, atol=2e-6 * SINOGRAM.max())


@given(st.floats(0.01, 1.0))
def test_zero_photons_are_read_as_the_configured_number(zero_counts_as):
    counts = Counts(np.zeros((1, 1, 2), np.uint16), 1000.0, 1.0)
    np.testing.assert_allclose(counts.line_integrals(zero_counts_as), -np.log(zero_counts_as / 1000), rtol=1e-5)


def test_bad_arguments():
    good = np.ones((2, 2, 2))
    with pytest.raises(InputError, match="noise.model 'gauss'"):
        simulate_counts(good, 1e-3, "gauss", SEED)
    for level in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(InputError, match="noise level"):
            simulate_counts(good, level, "astra", SEED)
    with pytest.raises(InputError, match="projections are empty"):
        simulate_counts(np.zeros((2, 2, 2)), 1e-3, "astra", SEED)
    with pytest.raises(InputError, match="zero_counts_as"):
        Counts(np.ones(3, np.uint16), 10.0, 1.0).line_integrals(0)


def test_streams_differ_in_every_argument_and_repeat():
    arguments = [
        (1, "views150", "dose10", 0),
        (2, "views150", "dose10", 0),
        (1, "views200", "dose10", 0),
        (1, "views150", "dose1", 0),
        (1, "views150", "dose10", 1),
    ]
    first = [np.random.Generator(np.random.PCG64(streams.acquisition(*a))).integers(2**63) for a in arguments]
    again = [np.random.Generator(np.random.PCG64(streams.acquisition(*a))).integers(2**63) for a in arguments]
    assert first == again
    assert len(set(first)) == len(first)


def test_counts_beyond_sixteen_bits_are_stored():
    counts = simulate_counts(np.array([[[0.0, 1.0]]]), 1e-7, "physical", SEED)
    assert counts.data.max() > 2**16
