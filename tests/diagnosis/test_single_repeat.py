"""Diagnosis of a single repeat: the excess noise between views shows changes from view to view."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_scans import body, noisy_lines

from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.projections import first_noise, observed, prepared
from virtual_phantom.diagnosis.projections.observed import NOISE_OF_VIEWS, VIEW_PARTS
from virtual_phantom.diagnosis.selection.forward_selection import choose
from virtual_phantom.diagnosis.verdict.verdict import diagnose
from virtual_phantom.physics.beam.materials import Segmentation
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.scene import IN_PLACE, Pose, VoxelScene

PHOTONS = 1e5
GEOMETRY = circular(
    views=96,
    source_to_isocentre_mm=570.0,
    source_to_detector_mm=1040.0,
    columns=64,
    rows=8,
    column_pitch_mm=8.0,
    row_pitch_mm=8.0,
)
TRIED = ("current_modulation", "detector_offset", "optical_crosstalk", "electronic_noise", "scatter", "dark_signal")
MODULATED = {"current_modulation": {"cosine": -0.2, "sine": 0.25}}


@pytest.fixture(scope="module")
def chain():
    grid = Grid((16, 64, 64), (4.0, 4.5, 4.5))
    volume = body(grid, (120, 70), 20.0, [((50, 10, 5), 20, 800.0), ((-40, -20, -5), 18, -80.0)])
    return Chain(VoxelScene.of(volume, Segmentation(), 0.0193), GEOMETRY, PHOTONS)


def prepare_recording(chain, physics, seed, pose=IN_PLACE, **more):
    """Prepare one repeat."""
    state = chain.state(physics, pose)
    lines = noisy_lines(state, 1, np.random.default_rng(np.random.SeedSequence((20261125, seed))))
    white = state.measured_air.mean(axis=0) * PHOTONS
    taken = observed.Scans(lines.astype(np.float32), white, np.ones(lines.shape[1:], bool))
    return prepared.prepare(taken, None, chain, nominal_photons=PHOTONS, **more)


def named(prepared_data, tried=TRIED):
    choice = choose(prepared_data.fitter, trial(prepared_data.fitter, ()), tried)
    return diagnose("scan", prepared_data, choice).content


def test_current_changes_between_views_are_found_in_one_scan(chain):
    content = named(prepare_recording(chain, MODULATED, 1))
    (effect,) = content["effects"]
    assert effect["name"] == "current_modulation" and content["noise_from_one_repeat"]
    for key, truth in MODULATED["current_modulation"].items():
        low, high = effect["parameters"][key]["ci95"]
        assert abs(effect["parameters"][key]["value"] - truth) < (high - low) and high - low < 0.2


def test_current_changes_are_found_if_every_nth_view_is_fitted(chain, monkeypatch):
    """The noise is measured in neighboring views only."""
    monkeypatch.setattr(first_noise, "MOST_RAYS_FOR_NOISE", 0)
    content = named(prepare_recording(chain, MODULATED, 2, step=3))
    assert [effect["name"] for effect in content["effects"]] == ["current_modulation"]


@pytest.mark.parametrize(
    ("physics", "pose"),
    [({}, IN_PLACE), ({"scatter": {"amount": 0.05, "width_mm": 60.0}}, Pose(x_mm=0.8, y_mm=-0.6, turn_deg=0.4))],
)
def test_constant_current_is_not_reported(chain, physics, pose):
    """An elongated, shifted body differs from the baseline twice per turn, like a varying current."""
    content = named(prepare_recording(chain, physics, 3, pose))
    assert {effect["name"] for effect in content["effects"]} == set(physics)


def test_noise_is_measured_with_a_shifted_object(chain):
    """Its edges move between views, but hardly between rows: photons agree within five standard errors, and 3 %."""
    prepared_data = prepare_recording(chain, {}, 6, Pose(x_mm=0.8, y_mm=-0.6, turn_deg=0.4))
    rays = prepared_data.variance.size
    assert prepared_data.photons == pytest.approx(PHOTONS, rel=5 * np.sqrt(8 / rays) + 0.03)


def test_noise_of_few_rows_is_not_part_of_the_data(chain):
    chain = chain.copy(replace(GEOMETRY, rows=3))
    data = prepare_recording(chain, {}, 7).data
    assert data.variance is None and data.parts[0] == "mean"


def test_noise_of_views_has_its_stated_scatter(chain):
    """12 scans of the baseline: the scatter is at least 0.7 of that of noise, and below the allowed maximum."""
    squares, floors = [], []
    for seed in range(12):
        data = prepare_recording(chain, {}, 100 + seed).data
        assert data.variance.shape == (VIEW_PARTS[0],) and not np.isfinite(data.correlation).any()
        left = np.log(data.variance)
        squares.append(((left - left.mean()) ** 2).sum() / (left.size - 1))
        floors.append((data.variance_error**2).mean())
    noise = np.mean(floors) - NOISE_OF_VIEWS**2
    assert 0.7 * noise < np.mean(squares) < np.mean(floors)


def test_noise_level_is_unknown(chain):
    """Twice the photons change no residual of the noise, and chi-square of no fit beyond the prior of the photons."""
    prepared_data = prepare_recording(chain, {}, 4)
    fit = prepared_data.fitter.fit(())
    photons = fit.nuisance["log_photons"]
    twice = replace(fit, nuisance=fit.nuisance | {"log_photons": photons + np.log(2)})
    one, other = (prepared_data.fitter.residuals(each, held_out=False)[1] for each in (fit, twice))
    assert other == pytest.approx(one, abs=1e-3) and abs(one @ prepared_data.fitter.weights[1]) < 1e-6 * np.sum(
        prepared_data.fitter.weights[1]
    )
