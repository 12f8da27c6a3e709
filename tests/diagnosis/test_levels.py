"""Confidence intervals of any level: closed forms, random realizations of the error, and the printed text."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some
from scipy import stats

from virtual_phantom.diagnosis.uncertainty.intervals import half_width, intervals

levels = some.floats(0.01, 0.99)


@given(level=levels, error=some.floats(1e-6, 1e6))
def test_errors_of_noise_alone_are_normal(level, error):
    assert half_width(level, error, error) == pytest.approx(error * stats.norm.ppf(0.5 + level / 2), rel=1e-3)


@given(level=levels, error=some.floats(1e-6, 1e6))
def test_model_errors_alone_follow_student_t_with_the_stated_95_percent(level, error):
    t = stats.t(2)
    expected = 1.959964 * error * t.ppf(0.5 + level / 2) / t.ppf(0.975)
    assert half_width(level, 0.0, error) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("by_noise", [0.2, 0.5, 0.8])
def test_combined_intervals_cover_random_errors_at_their_level(by_noise):
    random = np.random.default_rng(5)
    by_models = 1.959964 / stats.t(2).ppf(0.975) * stats.t(2).rvs(400_000, random_state=random)
    errors = 3 * np.abs(by_noise * random.normal(size=400_000) + np.sqrt(1 - by_noise**2) * by_models)
    for level in (0.5, 0.8, 0.95):
        assert np.mean(errors <= half_width(level, 3 * by_noise, 3.0)) == pytest.approx(level, abs=0.004)


@given(by_noise=some.floats(0, 1))
def test_at_95_percent_the_combined_interval_is_as_wide_as_a_normal_one(by_noise):
    assert half_width(0.95, by_noise, 1.0) == pytest.approx(1.959964, rel=0.03)


@given(by_noise=some.floats(0, 0.9), level=some.floats(0.01, 0.5))
def test_inner_intervals_are_narrower_with_larger_model_errors(by_noise, level):
    assert 0 < half_width(level, by_noise, 1.0) <= stats.norm.ppf(0.5 + level / 2)


def test_unknown_and_exactly_known_values():
    assert half_width(0.5, 0.0, 0.0) == 0.0
    assert half_width(0.5, 1.0, np.inf) == half_width(0.5, np.inf, np.inf) == np.inf


def test_printed_interval_lies_within_the_plausible_range():
    reported = intervals(1.0, 1.0, 2.0, 0.0, 1.5)
    assert list(reported) == ["ci50", "ci95", "ci95_noise"]
    assert reported["ci50"] == pytest.approx([max(0.0, 1 - half_width(0.5, 1.0, 2.0)), 1.5])
    assert reported["ci95"] == reported["ci95_noise"] == [0.0, 1.5]
