"""How well an ideal observer sees hidden effects, against closed forms."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from virtual_phantom.base.proof_settings import ProofSettings
from virtual_phantom.base.settings import from_mapping
from virtual_phantom.base.streams import branch
from virtual_phantom.io.schema import defaults_of
from virtual_phantom.proof.hiding.generate import ENERGY_OF_WATER, acquire, hidden_settings, scan_of
from virtual_phantom.proof.hiding.imperfections import DOSE_SD
from virtual_phantom.proof.hiding.suite import World, truths, with_effects
from virtual_phantom.proof.hiding.visibility import _beside, snr

MU_WATER = 0.0193


def suite(**given) -> ProofSettings:
    return from_mapping(ProofSettings, defaults_of("proof") | {"seed": 4, "none": 0, "pairs": 0, "unknown": 0} | given)


@cache
def seen(effect: str) -> tuple[ProofSettings, dict, float]:
    """Return a suite, and the truth and the signal-to-noise ratio of its only case, a strong effect in XCIST."""
    of_suite = suite(effects=[effect], strengths=["strong"], images={"strengths": [], "effects": [], "tried": []})
    (case,) = with_effects(of_suite)
    truth = truths(of_suite)[case]
    return of_suite, truth, snr(truth, of_suite, MU_WATER)[effect]


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_the_ratio_is_that_of_a_known_signal_in_correlated_noise(seed, count):
    random = np.random.default_rng(seed)
    signal, errors = random.normal(size=30), random.normal(size=(count, 30))
    weight = random.uniform(0.1, 10, 30)
    covariance = np.diag(1 / weight) + errors.T @ errors
    expected = np.sqrt(signal @ np.linalg.solve(covariance, signal))
    assert _beside(signal, list(errors), weight) == pytest.approx(expected, rel=1e-6)


def test_photons_show_in_the_noise_as_far_as_the_dose_is_known():
    """The logarithm of each sample variance has a variance of 2 / (repeats - 1), and the dose is common to all."""
    of_suite, truth, found = seen("photon_flux")
    factor, taken = truth["effects"][0]["comparable"]["factor"], of_suite.scan
    orbit = World.of(truth).orbits(of_suite)[0]
    information = orbit.views * taken.rows * taken.columns * (taken.repeats - 1) / 2
    expected = abs(np.log(factor)) * np.sqrt(information / (1 + information * DOSE_SD**2))
    assert found == pytest.approx(expected, rel=1e-3)


def test_a_scan_without_noise_is_the_mean_of_scans_with_noise():
    of_suite, truth, _ = seen("electronic_noise")
    world, taken = World.of(truth), of_suite.scan
    orbit, hidden = world.orbits(of_suite)[0], hidden_settings(truth)
    scan = scan_of(orbit, taken.photons, taken.rotation_time_ms, ENERGY_OF_WATER[world.simulator](MU_WATER), hidden)
    quiet, noisy = (
        acquire(
            world.simulator, scan, world.stated(of_suite.seed), truth["imperfections"], MU_WATER, repeats, branch(3, 0)
        )
        for repeats in (0, 40)
    )
    assert quiet.readings.shape == (1, *noisy.readings.shape[1:])
    error = noisy.readings.std(axis=0, ddof=1) / np.sqrt(40)
    assert np.mean(((noisy.readings.mean(axis=0) - quiet.readings[0]) / error) ** 2) == pytest.approx(39 / 37, rel=0.05)
