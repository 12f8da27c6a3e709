"""Declared physics: part of every model, never reported as missing, and reported if inconsistent with the data."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_scans import body, chosen, scans_of

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.base.settings import from_mapping
from virtual_phantom.diagnosis.candidate_effects import candidates
from virtual_phantom.diagnosis.fitting.joint_fit import JointFitter
from virtual_phantom.diagnosis.fitting.priors import Statement, declared
from virtual_phantom.diagnosis.fitting.problem import Problem
from virtual_phantom.diagnosis.fitting.templates import data_changes
from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.projections import observed, prepared
from virtual_phantom.diagnosis.selection.fit_cache import FitCache
from virtual_phantom.diagnosis.selection.forward_selection import choose
from virtual_phantom.diagnosis.selection.joint_selection import choose_jointly
from virtual_phantom.diagnosis.selection.screening import screened
from virtual_phantom.diagnosis.settings import RecordingSettings
from virtual_phantom.diagnosis.uncertainty.model_error import distortions_of_physics
from virtual_phantom.diagnosis.verdict.verdict import diagnose
from virtual_phantom.physics.beam.materials import Segmentation
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.scene import VoxelScene
from virtual_phantom.recordings.projections import Projections

PHOTONS = 1e5
GEOMETRY = circular(
    views=48,
    source_to_isocentre_mm=570.0,
    source_to_detector_mm=1040.0,
    columns=40,
    rows=4,
    column_pitch_mm=12.0,
    row_pitch_mm=12.0,
)
SCATTER = {"amount": 0.02, "width_mm": 60.0}
STATED = {"scatter": {"amount": {"value": 0.02, "sd": 0.002}, "width_mm": {"value": 60.0, "sd": 5.0}}}
OTHERS = ("electronic_noise", "detector_offset", "optical_crosstalk")


@pytest.fixture(scope="module")
def scene():
    return inserts_in_muscle()


def inserts_in_muscle():
    grid = Grid((16, 64, 64), (4.0, 4.5, 4.5))
    volume = body(grid, (110, 80), 20.0, [((50, 10, 5), 20, 800.0), ((-40, -20, -5), 18, -80.0)])
    return VoxelScene.of(volume, Segmentation(), 0.0193)


def found(scene, physics, baseline, tried=OTHERS, seed=1):
    state = Chain(scene, GEOMETRY, PHOTONS).state(physics)
    random = np.random.default_rng(seed)
    white = state.measured_air[0] * state.photons
    taken = observed.scans([Projections(state.counts(random), white, np.zeros_like(white)) for _ in range(4)])
    chain = Chain(scene, GEOMETRY, PHOTONS)
    prepared_data = prepared.prepare(
        taken, None, chain, nominal_photons=PHOTONS, declared=declared(baseline, "baseline")
    )
    return diagnose("bench", prepared_data, chosen(prepared_data.fitter, tried)).content


def test_declared_physics_is_in_every_model_and_not_reported_as_missing(scene):
    content = found(scene, {"scatter": SCATTER}, STATED)
    assert content["verdict"] == "match" and content["effects"] == [], content["sentence"]
    amount = content["declared"]["scatter"]["amount"]
    assert not amount["off"] and amount["ci95"][0] <= 0.02 <= amount["ci95"][1]
    # The data constrain the parameter more than the declaration does.
    assert amount["ci95"][1] - amount["ci95"][0] < 2 * 1.96 * 0.002


def test_missing_effect_is_named_with_declared_physics(scene):
    content = found(scene, {"scatter": SCATTER, "detector_offset": {"columns_px": 0.03}}, STATED)
    assert [effect["name"] for effect in content["effects"]] == ["detector_offset"], content["sentence"]
    low, high = content["effects"][0]["parameters"]["columns_px"]["ci95"]
    assert abs(0.03 - (low + high) / 2) <= high - low
    assert "scatter" not in content["sentence"]


def test_wrong_declaration_is_reported_with_the_fitted_value(scene):
    wrong = {"scatter": STATED["scatter"] | {"amount": {"value": 0.005, "sd": 0.001}}}
    content = found(scene, {"scatter": SCATTER}, wrong)
    amount = content["declared"]["scatter"]["amount"]
    assert amount["off"] and amount["pull"] > 5
    # Between the declared and the true value, weighted by their errors.
    assert 0.005 < amount["value"] < 0.0205
    assert content["verdict"].startswith("mismatch") and content["effects"] == []
    assert "Contradicts declared physics: scatter: amount" in content["sentence"]


def test_exactly_declared_parameters_are_not_fitted(scene):
    exact = {"scatter": {key: {"value": value, "sd": 0} for key, value in SCATTER.items()}}
    content = found(scene, {"scatter": SCATTER}, exact)
    amount = content["declared"]["scatter"]["amount"]
    assert amount["value"] == 0.02 and amount["ci95"] == [0.02, 0.02] and amount["pull"] == 0 and not amount["off"]
    assert content["verdict"] == "match"


def test_pulls_of_correct_declarations_are_standard_normal(scene):
    """Declared values scatter about the truth by their stated errors; 16 pulls of known mean and SD."""
    random = np.random.default_rng(77)
    pulls = []
    for seed in range(16):
        drawn = {"scatter": {"amount": {"value": float(random.normal(0.02, 0.002)), "sd": 0.002}}}
        drawn["scatter"]["width_mm"] = {"value": 60.0, "sd": 0}
        pulls.append(found(scene, {"scatter": SCATTER}, drawn, (), seed)["declared"]["scatter"]["amount"]["pull"])
    assert abs(np.mean(pulls)) < 3 / np.sqrt(16)
    assert 0.5 < np.std(pulls, ddof=1) < 1.6  # 99.9 % of 16 normal values


STRONG = {"scatter": {"amount": 0.2, "width_mm": 60.0}}
STRONG_STATED = {"scatter": {"amount": {"value": 0.2, "sd": 0.01}, "width_mm": {"value": 60.0, "sd": 5.0}}}
TRUSTED = {"default": 0.02, "numerical": 0.12}
TRIED = ("dark_signal", "veiling_glare", "optical_crosstalk", "detector_saturation", "detector_offset")


def strong_scan(scene, more, seed, added=0.0):
    """Fitter of four repeats with 1e6 photons and declared strong scatter; `added` is added to the line integrals."""
    chain = Chain(scene, GEOMETRY, 1e6)
    state = chain.state(STRONG | more)
    taken = scans_of(state, 4, np.random.default_rng(seed), added)
    stated = declared(STRONG_STATED, "baseline")
    return prepared.prepare(taken, None, chain, nominal_photons=1e6, declared=stated).fitter


@pytest.fixture(scope="module")
def errors_of_scatter(scene):
    """Model errors of line integrals, one standard deviation each, shape (views, rows, columns, errors)."""
    fitter = strong_scan(scene, {}, 0)
    fit = trial(fitter, ()).fit
    columns = data_changes(Problem(fitter, (), fit))
    found = distortions_of_physics(fitter, fit, columns, TRUSTED, list(fitter.model.declared))
    mean = fitter.data.mean
    return (found[: mean.size] / np.sqrt(fitter.weights[0])[:, None]).reshape(*mean.shape, -1)


def test_errors_of_a_declared_model_match_its_stated_accuracy(scene, errors_of_scatter):
    """The uniform error is a share of the change by scatter, less what the alignment absorbs (at most scale and
    offset).
    """
    chain = Chain(scene, GEOMETRY, 1e6)
    here, there = (chain.state(physics).line_integrals().ravel() for physics in (STRONG, {}))
    linear = np.stack([here, np.ones(here.size)], axis=1)
    left = (here - there) - linear @ np.linalg.lstsq(linear, here - there, rcond=None)[0]
    rms = np.sqrt(np.mean(errors_of_scatter[..., 0] ** 2))
    assert 0.02 * left.std() < rms < 0.5 * 0.02 * np.sqrt(np.mean((here - there) ** 2))
    # An exact model has none.
    fitter = strong_scan(scene, {}, 0)
    fit = trial(fitter, ()).fit
    columns = data_changes(Problem(fitter, (), fit))
    assert distortions_of_physics(fitter, fit, columns, {"default": 0.0}, list(fitter.model.declared)).shape == (
        len(columns),
        0,
    )


@pytest.mark.parametrize("seed", [101, 103, 104])
def test_model_errors_of_declared_physics_are_not_named(scene, errors_of_scatter, seed, tmp_path):
    """The errors are drawn from their assumed distribution. With exact models, an absent effect would be named."""
    random = np.random.default_rng(seed)
    added = errors_of_scatter @ random.normal(size=errors_of_scatter.shape[-1])
    fitter = strong_scan(scene, {}, seed, added)
    aligned = trial(fitter, ())
    kept = FitCache(tmp_path, "this recording", str)  # fits do not depend on the accuracy
    exact = choose(fitter, aligned, TRIED, accuracy=TRUSTED | {"default": 0.0}, cache=kept)
    assert exact.chosen.fit.effects
    gains = screened(fitter, aligned.fit, TRIED, accuracy=TRUSTED)
    found = choose(fitter, aligned, TRIED, accuracy=TRUSTED, cache=kept)
    assert found.chosen.fit.effects == ()
    # Significance under exact models is reported nevertheless.
    assert set(exact.chosen.fit.effects) & {
        name for name, one in gains.items() if one.gain > 10 * one.beside_model_error.gain
    }


def test_model_errors_of_declared_physics_are_no_evidence_in_several_recordings(scene, errors_of_scatter):
    """Both recordings have the same errors, as of one scanner. With exact models, an absent effect would be named."""
    added = errors_of_scatter @ np.random.default_rng(103).normal(size=errors_of_scatter.shape[-1])
    together = JointFitter({str(seed): strong_scan(scene, {}, seed, added) for seed in (103, 203)})
    exact = choose_jointly(together, TRIED[:2], TRUSTED | {"default": 0.0})
    assert exact.chosen.effects
    assert choose_jointly(together, TRIED[:2], TRUSTED).chosen.effects == ()


def test_real_effect_exceeds_the_model_errors_of_declared_physics(scene, errors_of_scatter):
    random = np.random.default_rng(104)
    added = errors_of_scatter @ random.normal(size=errors_of_scatter.shape[-1])
    fitter = strong_scan(scene, {"optical_crosstalk": {"column": 0.01, "row": 0.01}}, 104, added)
    found = choose(fitter, trial(fitter, ()), TRIED, accuracy=TRUSTED)
    assert found.chosen.fit.effects == ("optical_crosstalk",)
    assert found.undecided  # significance of the effect with exact models


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ({"scatters": {}}, "scatters"),
        ({"scatter": {"amount": {"value": 0.02, "sd": 0.1}}}, "nothing is stated of width_mm"),
        ({"scatter": {**STATED["scatter"], "depth": {"value": 1, "sd": 1}}}, "depth"),
        ({"scatter": STATED["scatter"] | {"amount": {"value": -3, "sd": 1}}}, "amount"),
        ({"gain_pattern": {}}, "one unknown per detector pixel"),
    ],
)
def test_impossible_declarations_are_rejected_in_one_line(section, words):
    with pytest.raises(InputError, match=words) as caught:
        declared(section, "diagnosis.recordings.bench.baseline")
    assert str(caught.value).startswith("diagnosis.recordings.bench.baseline") and "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["xray_crosstalk", "optical_crosstalk"])
def test_declared_crosstalk_without_a_tail_has_none(name):
    shares = {key: {"value": 0.02, "sd": 0.001} for key in ("column", "row")}
    assert declared({name: shares}, "baseline")[name]["tail"] == Statement(0.0, 0.0)
    found = declared({name: shares | {"tail": {"value": 0.2, "sd": 0.05}}}, "baseline")
    assert found[name]["tail"] == Statement(0.2, 0.05)


def test_declared_effect_is_no_candidate():
    settings, none = (from_mapping(RecordingSettings, one) for one in ({"baseline": STATED}, {}))
    assert "scatter" not in candidates(settings) and "scatter" in candidates(none)
    with pytest.raises(InputError, match="scatter is declared under baseline; remove it"):
        candidates(replace(settings, effects=("scatter",)))
