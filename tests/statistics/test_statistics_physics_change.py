"""Change of stability by physics: intervals of differences against published ones, and undefined cases."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binomtest

from virtual_phantom.statistics.physics_change import stability_change

# Newcombe, Stat. Med. 17, 873, 1998, table II, method 10: both proportions, and the interval of their difference.
PUBLISHED = [
    ((56, 70), (48, 80), (0.0524, 0.3339)),
    ((9, 10), (3, 10), (0.1705, 0.8090)),
    ((6, 7), (2, 7), (0.0582, 0.8062)),
    ((5, 56), (0, 29), (-0.0381, 0.1926)),
    ((0, 10), (0, 20), (-0.1611, 0.2775)),
    ((10, 10), (0, 10), (0.6075, 1.0000)),
]


def trusted(rows):
    """Table of trusted features with Wilson's intervals, one feature per proportion."""
    found = []
    for number, (count, of) in enumerate(rows):
        interval = binomtest(count, of).proportion_ci(method="wilson")
        values = 100 * np.array([count / of, interval.low, interval.high])
        found.append([f"feature {number}", "first order", *values])
    return pd.DataFrame(found, columns=["feature", "family", "stability_percent", "ci95_low", "ci95_high"])


def test_interval_of_a_difference_equals_newcombes():
    one, other, published = zip(*PUBLISHED, strict=True)
    found = stability_change(trusted(one), trusted(other)[::-1])
    np.testing.assert_allclose(found[["ci95_low", "ci95_high"]] / 100, published, atol=5.1e-5)
    changes = [100 * (a / b - c / d) for (a, b), (c, d) in zip(one, other, strict=True)]
    np.testing.assert_allclose(found["change_percent"], changes)
    assert list(found["changed"]) == ["yes", "yes", "yes", "no", "no", "yes"]


def test_one_repeat_gives_no_interval():
    one = trusted([(3, 8)])
    without = one.assign(ci95_low=np.nan, ci95_high=np.nan)
    assert list(stability_change(one, without)["changed"]) == ["undecided"]


def test_interval_that_ends_before_its_value_is_not_extended():
    """The interval is for the expectation, the value for one study."""
    one = trusted([(3, 8)]).assign(stability_percent=90.0, ci95_low=40.0, ci95_high=80.0)
    other = one.assign(stability_percent=30.0, ci95_low=35.0, ci95_high=60.0)
    found = stability_change(one, other).iloc[0]
    assert (found["ci95_low"], found["ci95_high"]) == pytest.approx((60 - np.hypot(50, 30), 60))
