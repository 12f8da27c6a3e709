"""Processing of readings after detection, against its equations."""

from dataclasses import replace

import numpy as np
import pytest

from virtual_phantom.proof.hiding.catalogue import CATALOGUE
from virtual_phantom.proof.hiding.readout import gains, glare, read_out, wide
from virtual_phantom.proof.hiding.xcist import Acquired

PITCH = (2.0, 3.0)


@pytest.fixture
def taken():
    random = np.random.default_rng(1)
    readings = random.uniform(100, 900, (2, 5, 6, 30)).astype(np.float32)
    return Acquired(readings, np.full((6, 30), 1000, np.float32))


def read(taken, **settings):
    return read_out(taken, settings, PITCH, 2.0, np.random.default_rng(2))


def test_no_effect_changes_nothing(taken):
    found = read(taken)
    assert np.array_equal(found.readings, taken.readings) and np.array_equal(found.air, taken.air)


def test_dark_signal_is_added_to_scan_and_air_and_warms_up(taken):
    """In photons of 60 keV, per second of a scan of 2 s; the first view is below the mean, the last above it."""
    found = read(taken, dark_photons=0.2, dark_photons_per_s=0.1)
    added = (found.readings - taken.readings).mean(axis=(0, 2, 3))
    warming = 1 - np.exp(-(np.arange(5) + 0.5) / 5)
    expected = 12 + 6 * 2 * (warming - np.exp(-1)) / (1 - np.exp(-1))
    assert added == pytest.approx(expected * (found.air - 1000).mean() / 12, rel=1e-3)
    assert (found.air - 1000).std() / 12 == pytest.approx(0.2, rel=0.2)
    assert (found.air - 1000).mean() == pytest.approx(12, rel=0.05)


def test_monitor_corrects_the_tube_current_after_the_readout(taken):
    """A dark signal does not follow the current and is therefore divided by it; gains of the signal are not."""
    current = np.array([0.5, 1.0, 1.5, 1.0, 2.0])
    found = read(replace(taken, current=current), dark_photons=0.2)
    added = (found.readings - taken.readings).mean(axis=(0, 2, 3))
    assert added == pytest.approx((found.air - 1000).mean() / current, rel=1e-3)
    lossy = read(replace(taken, current=current), saturation_per_photon=0.1 * 60 / 1000)
    reads = taken.readings * current[:, None, None]
    assert lossy.readings == pytest.approx(reads * (1 - reads / 10000) / current[:, None, None], rel=1e-5)


def test_saturation_is_largest_for_the_largest_signal(taken):
    """Per photon of 60 keV: a tenth of the 1000 keV in air."""
    found = read(taken, saturation_per_photon=0.1 * 60 / 1000)
    assert found.air == pytest.approx(900.0)
    assert found.readings == pytest.approx(taken.readings * (1 - taken.readings / 10000), rel=1e-5)


def test_gains_drift_in_the_scan_and_not_in_the_air_scan(taken):
    found = read(taken, gain_rms=0.05)
    gain = found.readings / taken.readings - 1
    assert np.ptp(gain, axis=(0, 1)).max() < 1e-5
    many = gains(0.05, (4, 16000), np.random.default_rng(3)) - 1
    assert many.std() == pytest.approx(0.05, rel=0.05)
    modules = many.reshape(4, 1000, 16).mean(axis=(0, 2))
    assert np.sqrt((modules**2).mean() / (many**2).mean()) == pytest.approx(np.sqrt(0.5), rel=0.2)
    _, comparable = CATALOGUE["gain_pattern"].make(0.05, np.random.default_rng(3))
    within = many - modules[:, None].repeat(16, axis=1).ravel()
    assert within.std() == pytest.approx(comparable["rms"], rel=0.05)
    assert np.array_equal(found.air, taken.air)


def test_glare_conserves_the_signal_and_keeps_a_uniform_field(taken):
    assert glare(20.0, PITCH).sum() == pytest.approx(1)
    found = read(taken, glare_share=0.2, glare_range_mm=20.0)
    assert found.air == pytest.approx(1000.0, rel=1e-5)
    assert found.readings.std() < taken.readings.std()


def test_glare_decays_as_its_equation_states():
    spread = glare(20.0, (1.0, 1.0))
    middle = spread.shape[0] // 2
    at = lambda r: spread[middle, middle + r]  # noqa: E731
    assert at(10) / at(30) == pytest.approx(np.exp(1.0) * 3, rel=1e-6)
    point = np.zeros((1, 81, 81))
    point[0, 40, 40] = 1
    assert wide(point, spread)[0, 40, 50] == pytest.approx(at(10), rel=1e-6)
