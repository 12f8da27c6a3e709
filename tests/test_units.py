"""Hounsfield units."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from virtual_phantom.units import attenuation_to_hu, hu_to_attenuation


def test_fixed_points():
    np.testing.assert_allclose(hu_to_attenuation(np.array([-1000.0, 0.0, 1000.0]), 0.02), [0, 0.02, 0.04])
    assert hu_to_attenuation(np.array([-1100.0]), 0.02)[0] == 0
    assert attenuation_to_hu(np.array([-0.002]), 0.02)[0] == -1100


@given(st.floats(-1000, 3000), st.floats(0.01, 0.1))
def test_there_and_back(hu, mu_water):
    np.testing.assert_allclose(attenuation_to_hu(hu_to_attenuation(np.array([hu]), mu_water), mu_water), hu, atol=1e-9)


def test_stored_integers_are_not_truncated():
    np.testing.assert_allclose(hu_to_attenuation(np.array([0, 500], np.int16), 0.02), [0.02, 0.03], rtol=1e-6)
