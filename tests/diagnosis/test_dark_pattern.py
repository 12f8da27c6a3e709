"""Dark signals that differ between pixels, and gains: which pattern is fitted, and what is named."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_scans import disc_bench, scans_of

from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.projections import prepared
from virtual_phantom.diagnosis.projections.discretization import model_and_floor
from virtual_phantom.diagnosis.run import find_missing_physics
from virtual_phantom.diagnosis.selection.fit_cache import FitCache
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.shapes import ShapesScene, cylinder

PHOTONS, UNEVEN = 1e5, 0.2
ACCURACY = {"default": 0.02, "numerical": 0.1}
TRIED = ("dark_signal", "gain_pattern", "scatter", "afterglow")
GEOMETRY = replace(disc_bench(view_interval_ms=10.0), columns=64, rows=4, column_pitch_mm=7.0, row_pitch_mm=7.0)
LEVEL = {"dark_signal": {"level_units": 300.0, "drift_units_per_s": 0.0}}


@pytest.fixture(scope="module")
def scene():
    """Off-center rods, so that line integrals of a pixel differ between views."""
    return ShapesScene([cylinder("water", (0, 0, 0), 90), cylinder("bone", (45, 10, 0), 15)], 60.0)


def deviations(seed):
    return np.random.default_rng(seed).normal(size=GEOMETRY.shape[1:])


def scanned(scene, uneven=0.0, gain=0.0):
    state = Chain(scene, GEOMETRY, PHOTONS, samples=2).state(LEVEL if uneven is not None else {})
    if uneven:
        factor = 1 + uneven * deviations(1)
        state = replace(state, dark=state.dark * factor, dark_air=state.dark_air * factor)
    return replace(state, gain=np.exp(gain * deviations(2))) if gain else state


def ready(scene, state):
    model, floor = model_and_floor(scene, GEOMETRY, 2, photons=PHOTONS)
    taken = scans_of(state, 4, np.random.default_rng(3))
    return prepared.prepare(taken, None, model, floor_chain=floor, nominal_photons=PHOTONS)


def test_change_of_line_integrals_by_the_dark_signal_is_a_derivative(scene):
    state = scanned(scene)
    more = replace(state, dark=1.001 * state.dark, dark_air=1.001 * state.dark_air)
    difference = (more.line_integrals() - state.line_integrals()) / 1e-3
    assert state.change_by_dark_signal() == pytest.approx(difference, rel=2e-3, abs=1e-9)
    assert not Chain(scene, GEOMETRY, PHOTONS).state({}).change_by_dark_signal().any()


def test_dark_signals_of_pixels_are_fitted_and_not_named_as_gains(scene, tmp_path):
    data = ready(scene, scanned(scene, uneven=UNEVEN))
    cache = FitCache(tmp_path, "one", lambda effect: "as it is")
    content = find_missing_physics("bench", data, TRIED, ACCURACY, cache=cache).content
    assert [effect["name"] for effect in content["effects"]] == ["dark_signal"]
    assert content["verdict"] == "mismatch explained"
    assert not (tmp_path / "dark_signal.json").exists() and (tmp_path / "gain_pattern.json").exists()
    fit = data.whole.fit(("dark_signal",))
    assert fit.pattern.rms == pytest.approx(UNEVEN, abs=3 * fit.pattern.error)
    shown = fit.pattern.share > 0.5
    assert np.corrcoef(fit.pattern.values[shown], deviations(1)[shown])[0, 1] > 0.9
    low, high = content["effects"][0]["parameters"]["level_units"]["ci95"]
    assert low < LEVEL["dark_signal"]["level_units"] < high


def test_gains_are_not_taken_for_dark_signals(scene):
    alone = find_missing_physics("bench", ready(scene, scanned(scene, None, 0.004)), TRIED, ACCURACY).content
    assert [effect["name"] for effect in alone["effects"]] == ["gain_pattern"]
    assert alone["verdict"] == "mismatch explained" and not alone["ambiguous_with"].get("gain_pattern")
    both = find_missing_physics("bench", ready(scene, scanned(scene, 0.0, 0.01)), TRIED, ACCURACY).content
    assert {effect["name"] for effect in both["effects"]} == {"dark_signal", "gain_pattern"}


def test_an_even_dark_signal_has_no_pattern(scene):
    data = ready(scene, scanned(scene))
    baseline = trial(data.whole, ())
    found = trial(data.whole, ("dark_signal",), baseline, against=baseline)
    assert found.fit.pattern.rms < 3 * found.fit.pattern.error and found.fit.pattern.penalty < 3
    assert found.p < 1e-6
