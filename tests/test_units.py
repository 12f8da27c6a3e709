"""Hounsfield units."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.units import attenuation_to_hu, hu_to_attenuation, rounded_hu


def test_fixed_points():
    np.testing.assert_allclose(hu_to_attenuation(np.array([-1000.0, 0.0, 1000.0]), 0.02), [0, 0.02, 0.04])
    assert hu_to_attenuation(np.array([-1100.0]), 0.02)[0] == 0
    assert attenuation_to_hu(np.array([-0.002]), 0.02)[0] == -1100


@given(st.floats(-1000, 3000), st.floats(0.01, 0.1))
def test_round_trip(hu, mu_water):
    np.testing.assert_allclose(attenuation_to_hu(hu_to_attenuation(np.array([hu]), mu_water), mu_water), hu, atol=1e-9)


def test_stored_integers_are_not_truncated():
    np.testing.assert_allclose(hu_to_attenuation(np.array([0, 500], np.int16), 0.02), [0.02, 0.03], rtol=1e-6)


def test_integer_hu_round_half_to_even_and_count_clipped_values():
    whole, beyond = rounded_hu(np.array([0.5, 1.5, -2.5, 32767.4, 32768, -40000]), "never")
    assert whole.dtype == np.int16 and beyond == 2
    assert whole.tolist() == [0, 2, -2, 32767, 32767, -32768]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_non_finite_hu_are_rejected(bad):
    with pytest.raises(InputError, match="^a repeat: repair it$"):
        rounded_hu(np.array([0.0, bad]), "a repeat: repair it")
