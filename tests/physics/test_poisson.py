"""Poisson counts against SciPy's distribution, exact sums, moments, and monotonicity."""

from decimal import Decimal, localcontext

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import special, stats

from virtual_phantom.physics.noise.poisson import poisson_counts, quantiles

MEANS = np.concatenate([[0.0], np.geomspace(1e-6, 1e9, 76), [9.999999, 10.0, 99999.99, 1e5]])


def random(seed=0):
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))


@pytest.mark.parametrize("mean", MEANS)
def test_quantiles_agree_with_scipy(mean):
    """Up to 4.4 standard deviations: beyond 4.5, SciPy's incomplete gamma function is off at large means."""
    rng = random(1)
    uniform = np.concatenate([rng.random(60), 10 ** rng.uniform(-5.2, -1, 20), 1 - 10 ** rng.uniform(-5.2, -1, 20)])
    np.testing.assert_array_equal(quantiles(uniform, np.full(100, mean)), stats.poisson.ppf(uniform, mean))


@pytest.mark.parametrize("mean", MEANS[1:])
def test_counts_change_at_the_jumps_of_the_distribution(mean):
    """A relative 1e-9 of the smaller tail below a jump, and above it."""
    counts = np.unique(stats.poisson.ppf(np.linspace(2e-5, 1 - 2e-5, 40), mean)).astype(int)
    below, above = special.gammaincc(counts + 1.0, mean), special.gammainc(counts + 1.0, mean)
    step = 1e-9 * np.minimum(below, above)
    inside = above > 1e-6  # where 1e-9 of the upper tail exceeds a step of double precision
    counts, below, step = counts[inside], below[inside], step[inside]
    np.testing.assert_array_equal(quantiles(below - step, np.full(below.size, mean)), counts)
    np.testing.assert_array_equal(quantiles(below + step, np.full(below.size, mean)), counts + 1)


@pytest.mark.parametrize("mean", np.geomspace(0.5, 9e4, 24))
def test_both_tails(mean):
    """From the smallest positive number to the largest below 1 that a generator of doubles returns."""
    rng = random(2)
    tail = np.concatenate([10 ** rng.uniform(-16, -4, 200), [2.0**-53]])
    low = quantiles(tail, np.full(tail.size, mean)).astype(float)
    assert np.all(special.gammaincc(low + 1, mean) >= tail * (1 - 1e-12))
    assert np.all(np.where(low > 0, special.gammaincc(np.maximum(low, 1), mean), 0) < tail * (1 + 1e-12))
    uniform = 1 - np.maximum(tail, 2.0**-53)
    tail = 1 - uniform
    high = quantiles(uniform, np.full(tail.size, mean)).astype(float)
    assert np.all(special.gammainc(high + 1, mean) <= tail * (1 + 1e-12))
    assert np.all(np.where(high > 0, special.gammainc(np.maximum(high, 1), mean), 1) > tail * (1 - 1e-12))


def upper_tail(count: int, mean: int) -> float:
    """P(N >= n) summed term by term; the first, exp(-m) m^n / n!, in forty digits with Stirling's series."""
    with localcontext(prec=40):
        n, m = Decimal(count), Decimal(mean)
        factorial = n * n.ln() - n + (Decimal("6.283185307179586476925286766559005768394") * n).ln() / 2
        factorial += 1 / (12 * n) - 1 / (360 * n**3) + 1 / (1260 * n**5)
        first = float((n * m.ln() - m - factorial).exp())
    terms = np.arange(1, int(12 * np.sqrt(mean)))
    return first * (1 + np.cumprod(mean / (count + terms)).sum())


@pytest.mark.parametrize("mean", [10**5, 10**6, 10**7, 10**8, 10**9])
@pytest.mark.parametrize("tail", [1e-4, 1e-7, 1e-10, 1e-13])
def test_upper_tail_of_large_means(mean, tail):
    """At a jump, u = P(N <= n), within the resolution of double precision for 1 - u."""
    count = int(mean + stats.norm.isf(tail) * np.sqrt(mean))
    above = upper_tail(count + 1, mean)
    step = max(1e-9 * above, 2.0**-52)
    found = quantiles(np.array([1 - (above + step), 1 - (above - step)]), np.full(2, float(mean)))
    # A step may be several counts if their probabilities are smaller.
    assert found[0] <= count < found[1]
    assert upper_tail(int(found[0]), mean) > above + step - 2.0**-53
    assert upper_tail(int(found[1]) + 1, mean) <= above - step + 2.0**-53


def test_zero_mean_gives_zero_and_zero_the_smallest_count():
    np.testing.assert_array_equal(quantiles(np.array([0.0, 0.3, 1 - 2.0**-53]), np.zeros(3)), 0)
    np.testing.assert_array_equal(quantiles(np.zeros(3), np.array([3.0, 300.0, 3e7])), 0)
    assert poisson_counts(np.zeros((0, 3)), random()).shape == (0, 3)


@pytest.mark.parametrize("mean", [0.02, 0.7, 3.0, 9.9, 10.1, 40.0, 2e3, 1.7e5, 3e8])
def test_moments(mean):
    """Mean and central moments m, m, m and m + 3 m^2; standard errors from the eighth moment."""
    n = 400_000
    drawn = poisson_counts(np.full(n, mean), random(3)) - mean
    moments = [(drawn, 0.0), (drawn**2, mean), (drawn**3, mean), (drawn**4, mean + 3 * mean**2)]
    z = [(power.mean() - expected) / (power.std() / np.sqrt(n)) for power, expected in moments]
    assert np.abs(z).max() < 4


@pytest.mark.parametrize("mean", [0.3, 6.0, 14.0])
def test_frequencies(mean):
    n = 200_000
    drawn = poisson_counts(np.full(n, mean), random(4))
    kinds = np.arange(int(stats.poisson.ppf(1 - 1e-3, mean)) + 1)
    expected = n * stats.poisson.pmf(kinds, mean)
    expected = np.append(expected, n - expected.sum())
    found = np.append(np.bincount(drawn, minlength=60)[kinds], (drawn > kinds[-1]).sum())
    assert stats.chisquare(found, expected).pvalue > 1e-4


numbers = st.floats(0, 1, exclude_max=True)
means = st.floats(0, 1e9)


@settings(deadline=None)  # the kernel is compiled in the first case
@given(numbers, numbers, means)
def test_counts_are_monotonic_in_the_uniform_number(first, second, mean):
    # Numbers that differ by less than rounding are equal.
    low, high = sorted((first, second))
    if high - low > 1e-11 * min(high, 1 - low):
        few, many = quantiles(np.array([low, high]), np.full(2, mean))
        assert few <= many


@settings(deadline=None)
@given(numbers, means, st.floats(1e-9, 1e3))
def test_counts_are_monotonic_in_the_mean(uniform, mean, more):
    few, many = quantiles(np.full(2, uniform), np.array([mean, mean * (1 + more)]))
    assert few <= many


def test_one_number_per_pixel_in_the_order_of_the_array():
    means = random(5).gamma(2.0, 500.0, (7, 60, 91))
    rng, alone = random(6), random(6)
    whole = poisson_counts(means, rng)
    np.testing.assert_array_equal(whole, np.concatenate([poisson_counts(view[None], alone) for view in means]))
    numbers = random(6)
    np.testing.assert_array_equal(whole.ravel(), quantiles(numbers.random(means.size), means.ravel()))
    assert rng.random() == numbers.random()


def test_rounding_of_the_means_changes_few_counts_and_by_one():
    """The quantile shifts with the mean: a count changes with the probability of the difference in photons."""
    means = random(7).uniform(1e4, 1.6e5, 400_000)
    here, there = (poisson_counts(each, random(8)) for each in (means, means * (1 + 1e-7)))
    moved = there - here
    assert set(np.unique(moved)) == {0, 1}
    expected = 1e-7 * means.sum()
    assert abs(moved.sum() - expected) < 4 * np.sqrt(expected)


def test_numbers_outside_the_bounds_are_rejected():
    for mean in (-1e-9, np.nan, np.inf, 1e17):
        with pytest.raises(ValueError, match="means of Poisson counts"):
            poisson_counts(np.array([1.0, mean]), random())
    for uniform in (-0.1, 1.0, np.nan):
        with pytest.raises(ValueError, match="uniform numbers"):
            quantiles(np.array([uniform]), np.ones(1))
