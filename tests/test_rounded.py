"""Numbers of reports are rounded according to their intervals."""

import pytest

from virtual_phantom.report.html import within


@pytest.mark.parametrize(
    "value, interval, text",
    [
        (0.354, [0.0, 100.0], "0.354"),  # the sensor of the Helsinki disc
        (0.01, [0.01, 100.0], "0.01"),
        (-0.3, [-80.0, -0.01], "−0.3"),
        (100.0, [0.01, 100.0], "100"),
        (3.16, [2.46, 3.86], "3.2"),
        (0.02, [-2.0, 2.1], "0.0"),  # on both sides of zero
        (120.4, [119.0, 122.0], "120.4"),
    ],
)
def test_number_has_the_digits_of_its_interval_or_its_own(value, interval, text):
    assert within(value, interval) == text
