"""Confidence intervals with model errors: closed forms, and data with such errors."""

import numpy as np
import pytest
from simulated_scans import disc_bench, scans_of

from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.projections import prepared
from virtual_phantom.diagnosis.uncertainty import model_error
from virtual_phantom.diagnosis.uncertainty.model_error import errors_with_models, harmonics, shapes
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.shapes import DiscScene

PHOTONS, SHARE, LEVEL = 1e5, 0.1, 400.0
TRUE = {"dark_signal": {"level_units": LEVEL, "drift_units_per_s": 0.0}}
INEXACT = {"default": SHARE, "numerical": 0.0}
GEOMETRY = disc_bench(view_interval_ms=10.0)


@pytest.fixture(scope="module")
def chain():
    return Chain(DiscScene(160.0, "water"), GEOMETRY, PHOTONS)


def fitted(chain, seed, added=0.0, true=TRUE):
    """Fitter of four repeats with `added` line integrals, and fits without and with the true effect."""
    scans = scans_of(chain.state(true), 4, np.random.default_rng(seed), added)
    fitter = prepared.prepare(scans, None, chain, nominal_photons=PHOTONS).fitter
    baseline = trial(fitter, ())
    return fitter, baseline.fit, trial(fitter, tuple(true), baseline).fit


def level(errors):
    return errors.physics["dark_signal"]["level_units"]


def test_exact_models_have_the_errors_of_noise(chain):
    fitter, without, fit = fitted(chain, 1)
    for known, accuracy in (({"dark_signal": without}, {"default": 0.0, "numerical": 0.0}), ({}, INEXACT)):
        errors = errors_with_models(fitter, fit, known, accuracy)
        assert errors.physics["dark_signal"] == pytest.approx(fit.errors["dark_signal"], rel=1e-3)
        assert errors.nuisance == pytest.approx(fit.nuisance_errors, rel=1e-3)


def test_uniform_model_error_shifts_the_parameter_by_its_share(chain, monkeypatch):
    """The change by the effect is J times the parameters' distance from their neutral values; the shift is
    proportional.
    """
    monkeypatch.setattr(model_error, "shapes", lambda mean: {0: np.ones(mean.shape)})
    fitter, without, fit = fitted(chain, 2)
    errors = errors_with_models(fitter, fit, {"dark_signal": without}, INEXACT)
    by_model = np.sqrt(level(errors) ** 2 - fit.errors["dark_signal"]["level_units"] ** 2)
    assert by_model == pytest.approx(SHARE * fit.physics["dark_signal"]["level_units"], rel=0.05)
    # A named effect guards its own intervals.
    exact = errors_with_models(fitter, fit, {"dark_signal": without}, INEXACT | {"dark_signal": 0.0})
    assert level(exact) == pytest.approx(fit.errors["dark_signal"]["level_units"], rel=1e-3)


def test_intervals_are_correct_for_data_with_model_errors(chain):
    """24 scans with random distortions of the assumed size:

    errors divided by total standard errors are standard normal.
    """
    fitter, *fits = fitted(chain, 3)
    there, here = (fitter.predicted(fit).mean for fit in fits)
    random, z, of_noise = np.random.default_rng(8), [], []
    for seed in range(24):
        added = sum(SHARE * random.normal() * shape for shape in shapes(here).values()) * (here - there)
        fitter, without, fit = fitted(chain, 100 + seed, added)
        errors = errors_with_models(fitter, fit, {"dark_signal": without}, INEXACT)
        off = fit.physics["dark_signal"]["level_units"] - LEVEL
        z.append(off / level(errors))
        of_noise.append(off / fit.errors["dark_signal"]["level_units"])
    assert 0.62 < np.sqrt(np.mean(np.square(z))) < 1.45  # 99.7 % of the root mean square of 24 normal values
    assert np.sqrt(np.mean(np.square(of_noise))) > 2  # what intervals from noise alone miss


def test_kernel_of_another_shape_shifts_parameters_by_the_counted_error(chain, monkeypatch):
    """Add as much glare of half the width: the parameters move by the error that is counted for it."""
    monkeypatch.setattr(model_error, "kernel_error", lambda parameter, share: float(parameter.kernel))
    glare = {"veiling_glare": {"share": 0.1, "width_mm": 60.0, "beyond": 0.5}}
    narrower = {"veiling_glare": {"share": 0.1, "width_mm": 30.0, "beyond": 0.5}}
    wide, narrow = (chain.state(one).line_integrals() for one in (glare, narrower))
    lines = chain.state({}).line_integrals()
    fitter, without, fit = fitted(chain, 4, 0.0, glare)
    exact = {"default": 0.0, "numerical": 0.0}
    errors = errors_with_models(fitter, fit, {"veiling_glare": without}, exact).physics["veiling_glare"]
    small = 0.1  # small share, for which the fit is linear
    _, _, moved = fitted(chain, 4, small * (narrow - wide), glare)
    assert np.abs(narrow - wide).max() > 0.2 * np.abs(wide - lines).max()
    for key, error in errors.items():
        shift = (moved.physics["veiling_glare"][key] - fit.physics["veiling_glare"][key]) / small
        assert np.sqrt(error**2 - fit.errors["veiling_glare"][key] ** 2) == pytest.approx(abs(shift), rel=0.2)


def test_unexplained_noise_widens_the_interval_by_the_shift_without_it(chain):
    """Electronic noise is not fitted: the data of noise shift the scatter. With larger errors they do not."""
    hidden = {"scatter": {"amount": 0.03, "width_mm": 60.0}, "electronic_noise": {"photons": 150.0}}
    exact, pulls = {"default": 0.0, "numerical": 0.0}, []
    for seed in range(8):
        scans = scans_of(chain.state(hidden), 4, np.random.default_rng(seed))
        fitter = prepared.prepare(scans, None, chain, nominal_photons=PHOTONS).fitter
        fit = fitter.fit(("scatter",))
        error = errors_with_models(fitter, fit, {}, exact).physics["scatter"]["amount"]
        off = fit.physics["scatter"]["amount"] - 0.03
        pulls.append(off / fit.errors["scatter"]["amount"])
        assert abs(off) < 1.96 * error
    assert max(pulls) < -1.96  # intervals of noise alone miss the true value
    both = fitter.fit(("scatter", "electronic_noise"))
    whole = errors_with_models(fitter, both, {}, exact).physics["scatter"]["amount"]
    assert whole == pytest.approx(both.errors["scatter"]["amount"], rel=1e-3)
    numbers = [max(1, (weight > 0).sum()) for weight in fitter.weights]
    ratios = [max(1, square / number) for square, number in zip(fit.parts, numbers, strict=True)]
    fitter.weights = [weight / ratio for weight, ratio in zip(fitter.weights, ratios, strict=True)]
    again = fitter.fit(("scatter",), fit)
    shift = again.physics["scatter"]["amount"] - fit.physics["scatter"]["amount"]
    assert error == pytest.approx(np.hypot(shift, again.errors["scatter"]["amount"]), rel=0.1)


def test_shape_errors_have_equal_size_along_any_axes():
    for shape in ((7, 4, 9), (7, 1, 9), (1, 1, 1)):
        found = shapes(np.random.default_rng(1).normal(size=shape))
        assert all(one.shape == shape and np.mean(one**2) == pytest.approx(1) for one in found.values())
        assert len(found) == 1 + sum(length > 1 for length in shape) + (2 + (shape[2] > 2)) * (max(shape) > 1)


def test_harmonics_of_a_rotation_have_equal_size():
    turned = 2 * np.pi * np.arange(24) / 24
    found = harmonics(turned, (24, 2, 3))
    waves = np.array([one[:, 0, 0] for one in found.values()])
    assert len(found) == 4 and all(one.shape == (24, 2, 3) for one in found.values())
    np.testing.assert_allclose(waves @ waves.T / 24, np.eye(4), atol=1e-12)
    assert np.abs(waves.sum(axis=1)).max() < 1e-12
    assert harmonics(None, (24, 2, 3)) == {}
