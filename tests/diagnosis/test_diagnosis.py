"""Recordings simulated by the library's own chain: missing effects are named, located and measured."""

import copy
import json
from dataclasses import asdict, replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import special, stats
from simulated_scans import body, chosen, disc_bench, scans_of

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.diagnosis.fitting.linearization import Linearization, LinearizationPoint
from virtual_phantom.diagnosis.fitting.problem import Problem
from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.noise.gain_pattern import estimate
from virtual_phantom.diagnosis.projections import observed, prepared
from virtual_phantom.diagnosis.projections.residual_maps import domain_tests
from virtual_phantom.diagnosis.residuals.residual_tests import ALPHA, HalfResiduals, variance_z
from virtual_phantom.diagnosis.selection.fit_cache import read_trial, write_trial
from virtual_phantom.diagnosis.verdict.verdict import diagnose
from virtual_phantom.io.files import checksum_path
from virtual_phantom.physics.beam.materials import Segmentation
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.effect import load
from virtual_phantom.physics.scenes.scene import VoxelScene
from virtual_phantom.physics.scenes.shapes import DiscScene
from virtual_phantom.recordings.projections import Projections
from virtual_phantom.report.diagnosis import diagnosis_page, residual_maps

PHOTONS = 1e5
GEOMETRY = circular(
    views=60,
    source_to_isocentre_mm=570.0,
    source_to_detector_mm=1040.0,
    columns=40,
    rows=4,
    column_pitch_mm=12.0,
    row_pitch_mm=12.0,
    view_interval_ms=10.0,
)
LIBRARY = (
    "scatter",
    "detector_offset",
    "electronic_noise",
    "optical_crosstalk",
    "gain_pattern",
    "motion",
    "photon_flux",
)
HIDDEN = {
    "scatter": {"amount": 0.02, "width_mm": 60.0},
    "detector_offset": {"columns_px": 0.02},
    "electronic_noise": {"photons": 40.0},
    "optical_crosstalk": {"column": 0.03, "row": 0.03, "tail": 0.0},
    "gain_pattern": {"rms": 0.004, "detector": 3.0},
    "motion": load("motion").values({"x_mm_per_s": 1 / 0.6}),
    "photon_flux": {"factor": 0.8},
}


@pytest.fixture(scope="module")
def scene():
    grid = Grid((16, 64, 64), (4.0, 4.5, 4.5))
    volume = body(grid, (110, 80), 20.0, [((50, 10, 5), 20, 800.0), ((-40, -20, -5), 18, -80.0)])
    return VoxelScene.of(volume, Segmentation(), 0.0193)


def scans(scene, physics, repeats=4, seed=1, geometry=GEOMETRY):
    state = Chain(scene, geometry, PHOTONS).state(physics)
    random = np.random.default_rng(seed)
    white = state.measured_air.mean(axis=0) * state.photons
    dark = np.zeros_like(white)
    view = state.measured_air / state.measured_air.mean(axis=0)
    return observed.scans([Projections(state.counts(random) / view, white, dark) for _ in range(repeats)])


def diagnosed(scene, physics, library=LIBRARY, **options):
    prepared_data = prepared.prepare(
        scans(scene, physics, **options),
        None,
        Chain(scene, GEOMETRY, PHOTONS),
        floor_chain=None,
        nominal_photons=PHOTONS,
    )
    return prepared_data, diagnose("bench", prepared_data, chosen(prepared_data.fitter, library))


def test_complete_physics_is_a_match(scene):
    prepared_data, found = diagnosed(scene, {})
    assert found.content["verdict"] == "match" and found.content["effects"] == []
    assert found.content["remainder_sd"] < 3
    assert prepared_data.photons == pytest.approx(PHOTONS, rel=0.02)
    held_out = found.content["held_out"]
    assert held_out["chi_square_mean"]["before"] == pytest.approx(1, abs=0.05)
    assert held_out["rms_line_integral"]["before"] == pytest.approx(held_out["rms_line_integral"]["floor"], rel=0.03)


@pytest.mark.parametrize("name", HIDDEN)
def test_missing_effect_is_named_and_measured(scene, name):
    _, found = diagnosed(scene, {name: HIDDEN[name]}, seed=2)
    content = found.content
    assert content["verdict"] == "mismatch explained", content["sentence"]
    (effect,) = content["effects"]
    assert effect["name"] == name and effect["evidence"]["p"] < 1e-3 and effect["evidence"]["held_out_gain"] > 4
    for key, value in effect["parameters"].items():
        low, high = value["ci95"]
        # 95 % intervals of one realization each: twice the width must contain the truth
        middle, half = (low + high) / 2, (high - low) / 2
        assert abs(HIDDEN[name][key] - middle) <= 2 * half + 1e-12, (key, value)
    assert content["unexplained"] == [] and content["excess_removed"] > 0.9
    assert any(place["p"] < ALPHA for place in content["locations"]) or name in ("motion", "detector_offset")


def test_effect_that_forces_the_alignment_beyond_its_priors_is_detected(scene):
    """A quarter fewer photons than declared: the alignment reaches its limits, and the noise nearly fits."""
    _, found = diagnosed(scene, {"photon_flux": {"factor": 0.75}}, library=("scatter", "motion"))
    places = {place.domain: place for place in found.after}
    assert places["alignment"].significant and places["alignment"].where.startswith("logarithm of the photons, 5.0")
    assert found.content["verdict"] == "unexplained"
    _, found = diagnosed(scene, {"photon_flux": {"factor": 0.75}}, library=("scatter", "photon_flux"))
    assert not {place.domain: place for place in found.after}["alignment"].significant


def test_two_missing_effects_are_both_named(scene):
    hidden = {name: HIDDEN[name] for name in ("scatter", "electronic_noise")}
    _, found = diagnosed(scene, hidden)
    assert {effect["name"] for effect in found.content["effects"]} == set(hidden), found.content["sentence"]


def test_effect_without_candidates_is_not_explained_away(scene):
    """Scatter, without candidates that depend on the amount of matter."""
    library = ("electronic_noise", "optical_crosstalk", "gain_pattern", "photon_flux")
    _, found = diagnosed(scene, {"scatter": {"amount": 0.05, "width_mm": 60.0}}, library)
    assert found.content["verdict"] in ("unexplained", "mismatch partly explained")
    assert found.content["remainder_sd"] > 10
    assert {"path length", "projections"} & {place["domain"] for place in found.content["unexplained"]}
    assert found.content["next_measurement"]


def test_noise_of_a_single_repeat_comes_from_neighboring_views(scene):
    prepared_data, found = diagnosed(scene, {}, ("scatter", "detector_offset"), repeats=1)
    assert prepared_data.single and prepared_data.photons == pytest.approx(PHOTONS, rel=0.2)
    assert found.content["noise_from_one_repeat"] and found.content["verdict"] == "match"
    _, found = diagnosed(
        scene, {"scatter": {"amount": 0.05, "width_mm": 60.0}}, ("scatter", "detector_offset"), repeats=1
    )
    assert [effect["name"] for effect in found.content["effects"]] == ["scatter"]


def test_pixel_pattern_is_distinguished_from_noise_and_smooth_changes():
    random = np.random.default_rng(4)
    weight = np.full((50, 8, 64), 1 / 0.02**2)
    noise = 0.02 * random.normal(size=weight.shape)
    pattern = 0.006 * random.normal(size=weight.shape[1:])
    found = estimate(noise + pattern, weight)
    assert abs(found.rms - 0.006) < 3 * found.error and np.corrcoef(found.values.ravel(), pattern.ravel())[0, 1] > 0.8
    smooth = 0.02 * np.cos(np.linspace(0, 3, 64))
    assert estimate(noise + smooth, weight).rms < 0.002


def test_what_a_gain_pattern_absorbs_leaves_the_minimum_of_chi_square():
    """Chi-square of data and priors is minimized over the constants of pixels by least squares."""
    random = np.random.default_rng(8)
    weight = random.uniform(0.5, 2, (6, 2, 12)) / 0.02**2
    residual = 0.02 * random.normal(size=weight.shape) + 0.05 * random.normal(size=weight.shape[1:])
    found = estimate(residual, weight, smooth=True)
    rows = np.sqrt(weight)[..., None, None] * np.eye(24).reshape(2, 12, 2, 12)
    design = np.vstack(
        [rows.reshape(-1, 24), np.eye(24) / np.sqrt(found.share / (1 - found.share) / weight.sum(0)).ravel()]
    )
    data = np.concatenate([(np.sqrt(weight) * residual).ravel(), np.zeros(24)])
    best = np.linalg.lstsq(design, data, rcond=None)[0]
    np.testing.assert_allclose(found.constants(residual, weight).ravel(), best, rtol=1e-9)
    np.testing.assert_allclose(found.values, found.constants(residual, weight))
    left = residual - found.absorbed(residual, weight)
    assert (weight * left**2).sum() == pytest.approx(((data - design @ best) ** 2).sum(), rel=1e-9)


def test_derivatives_include_the_gain_pattern(scene):
    """The pattern takes up a part of every change. Only final fits have errors of other effects."""
    prepared_data, _ = diagnosed(scene, {}, ("scatter",))
    fitter = copy.copy(prepared_data.fitter)
    pattern = 0.02 * np.random.default_rng(6).normal(size=fitter.data.mean.shape[1:])
    fitter.data = replace(fitter.data, mean=fitter.data.mean + pattern)
    problem = Problem(fitter, ("gain_pattern", "scatter"))
    point, moved = problem.start.copy(), problem.start.copy()
    moved[0] += 0.005
    here = problem.recompute_residuals(point)
    slope = problem.derivative(0, point, here)[0]
    change = (here[0] - problem.recompute_residuals(moved)[0]) / 0.005
    assert np.linalg.norm(slope - change) < 0.02 * np.linalg.norm(change)
    fit = fitter.fit(("gain_pattern", "scatter"), final=False)
    assert not fit.nuisance_errors and fit.errors == {"gain_pattern": fit.errors["gain_pattern"], "scatter": {}}
    whole = fitter.fit(("gain_pattern", "scatter"))
    assert fitter.finished(fit).chi_square < whole.chi_square + 0.02


def test_information_beside_a_gain_pattern_is_that_of_correlated_noise():
    """Constants of pixels correlate the noise of all views; the matrix of covariances is inverted as a whole."""
    chain = Chain(DiscScene(160.0, "water"), disc_bench(view_interval_ms=25.0), PHOTONS)
    random = np.random.default_rng(9)
    pattern = 0.01 * random.normal(size=chain.geometry.shape[1:])
    taken = scans_of(chain.state({}), 2, random, pattern)
    fitter = prepared.prepare(taken, None, chain, nominal_photons=PHOTONS).fitter
    problem = Problem.at(fitter, fitter.fit(("gain_pattern", "scatter")))
    weight, total = fitter.weights[0], fitter.data.pattern_sums(fitter.weights[0].reshape(fitter.data.mean.shape))
    used = weight > 0
    assert problem.pattern.smooth and problem.pattern.rms == pytest.approx(0.01, rel=0.3)
    share = problem.pattern.share
    prior = np.broadcast_to(share / (1 - share) / np.maximum(total, 1e-300), fitter.data.mean.shape).ravel()
    pixel = np.broadcast_to(np.arange(total.size).reshape(total.shape), fitter.data.mean.shape).ravel()
    covariance = np.diag(1 / weight[used]) + np.where(pixel[used, None] == pixel[used], prior[used], 0)
    plain, beside = problem.changes_at_start()[0], problem.jacobian_at_start()[0]
    np.testing.assert_allclose(
        (beside * weight) @ beside.T,
        plain[:, used] @ np.linalg.solve(covariance, plain[:, used].T),
        rtol=1e-6,
        atol=1e-9,
    )


def test_locations_of_a_difference_are_found(scene):
    prepared_data, _ = diagnosed(scene, {}, ("scatter",))
    fitter = prepared_data.fitter
    parts = fitter.residuals(trial(fitter, ()).fit, held_out=True)
    shape = prepared_data.held_out.mean.shape
    moved = parts[0].reshape(shape).copy()
    moved[:, :, 17] += 0.01
    worst = domain_tests(HalfResiduals([moved.ravel(), *parts[1:]], fitter.held_weights, prepared_data.held_out))[0]
    assert worst.domain in ("columns", "pixels") and worst.p < ALPHA
    columns = next(
        place
        for place in domain_tests(
            HalfResiduals([moved.ravel(), *parts[1:]], fitter.held_weights, prepared_data.held_out)
        )
        if place.domain == "columns"
    )
    assert columns.where == "column 17 of 40" and columns.z > 0


def test_difference_spread_over_all_rays_is_detected_in_both_halves(scene):
    """Random sign, a third of the noise of every ray: no location is significant, but the halves agree."""
    prepared_data, _ = diagnosed(scene, {}, ("scatter",))
    fitter, fit = prepared_data.fitter, trial(prepared_data.fitter, ()).fit
    random = np.random.default_rng(5)
    noise = 1 / np.sqrt(np.maximum(fitter.held_weights[0], 1e-30)) * (fitter.held_weights[0] > 0)
    thin = noise * random.choice([-1.0, 1.0], noise.size) / 3

    def both_halves(added):
        parts, fitted = (fitter.residuals(fit, held_out) for held_out in (True, False))
        parts[0], fitted[0] = parts[0] + added, fitted[0] + added
        places = domain_tests(
            HalfResiduals(parts, fitter.held_weights, prepared_data.held_out),
            fitted=HalfResiduals(fitted, fitter.weights, prepared_data.data),
        )
        return next(place for place in places if place.domain == "both halves"), places

    calm, _ = both_halves(0)
    seen, places = both_halves(thin)
    assert not calm.significant
    assert seen.significant and seen.where == "all rays"
    count = int((noise > 0).sum())
    assert seen.map[0] - calm.map[0] == pytest.approx(np.sqrt(count) / 9, rel=0.25)
    assert not any(place.significant for place in places if place.domain in ("columns", "rows", "views", "projections"))


def test_numerical_errors_do_not_correlate_the_halves():
    """A model error c D with c ~ N(0, 1) in both halves: z has its null distribution."""
    random = np.random.default_rng(6)
    rays = 4000
    error = 0.5 * random.normal(size=rays)  # in standard deviations of the noise
    data = SimpleNamespace(numerical=(error,), variance=None, weight_variance=0.0)

    def z(common):
        first, second = (HalfResiduals([random.normal(size=rays) + common], [np.ones(rays)], data) for _ in range(2))
        return first.in_common(second).z()

    found = np.array([z(random.normal() * error) for _ in range(400)])
    assert (found > 2.5).mean() < 0.05  # (c^2 - 1) / sqrt(2) of a normal c exceeds 2.5 with probability 3.3 %
    assert z(3.5 * error) > 5


@pytest.mark.parametrize("freedom", [10, 40, 2000])
def test_scores_of_variances_follow_chi_square(freedom):
    """Scores follow chi-square far into its tails. With logarithms at 10 degrees of freedom, -4.3 would become -6."""
    likely = np.array([1e-5, 1e-3, 0.05, 0.5, 0.95, 1 - 1e-3, 1 - 1e-5])
    logarithm = np.log(stats.chi2.ppf(likely, freedom) / freedom) - (special.digamma(freedom / 2) - np.log(freedom / 2))
    z = variance_z(logarithm, np.full(likely.size, freedom / 2))
    np.testing.assert_allclose(z, stats.norm.ppf(likely), atol=0.3)
    assert variance_z(np.zeros(2), np.array([0.0, 1e4]))[0] == 0


def test_one_fitted_repeat_is_compared_with_several(scene):
    """Only the noise of the held-out data is then known."""
    prepared_data, _ = diagnosed(scene, {}, ("scatter",))
    fitter, fit = prepared_data.fitter, trial(prepared_data.fitter, ()).fit
    parts = fitter.residuals(fit, held_out=True)
    alone = HalfResiduals(parts[:1], fitter.weights[:1], replace(prepared_data.data, variance=None))
    places = domain_tests(HalfResiduals(parts, fitter.held_weights, prepared_data.held_out), fitted=alone)
    assert {"noise level", "noise correlation", "both halves"} <= {place.domain for place in places}


def test_fits_are_read_from_files_and_the_report_states_the_findings(scene, tmp_path):
    prepared_data, found = diagnosed(scene, {"gain_pattern": HIDDEN["gain_pattern"]}, ("gain_pattern", "scatter"))
    errors = LinearizationPoint({"detector_offset": {"columns_px": 0.3}}, {"x_mm": 0.1})
    moved = Linearization(errors, LinearizationPoint({}, {"y_mm": 0.2}))
    elsewhere = replace(found.choice.chosen, fit=replace(found.choice.chosen.fit, linearization=moved, corrected=2.5))
    write_trial(elsewhere, tmp_path / "fit.json", "of this")
    again, made_of = read_trial(tmp_path / "fit.json")
    assert made_of == "of this"
    assert again.fit.linearization == moved and again.fit.linearization.errors.key == errors.key
    assert again.fit.corrected == 2.5
    assert again.fit.physics == found.choice.chosen.fit.physics and again.score == found.choice.chosen.score
    for name, values in asdict(found.choice.chosen.fit.pattern).items():
        np.testing.assert_array_equal(getattr(again.fit.pattern, name), values)
    (tmp_path / "fit.json").write_text("{}")
    checksum_path(tmp_path / "fit.json").unlink()
    with pytest.raises(InputError, match="is no fit of a diagnosis"):
        read_trial(tmp_path / "fit.json")
    text = diagnosis_page(found, residual_maps(found))
    assert found.content["verdict"] in text and "gain pattern" in text and text.count("data:image/png;base64,") == 4
    assert "http" not in text  # one file, no external resources
    json.dumps(found.content, allow_nan=False)


def test_copies_of_one_file_are_rejected(scene):
    taken = scans(scene, {}, repeats=1)
    same = observed.Scans(np.repeat(taken.repeats, 4, axis=0), taken.white, taken.usable)
    with pytest.raises(InputError, match="the repeats are identical; remove the copies from repeats"):
        prepared.prepare(same, None, Chain(scene, GEOMETRY, PHOTONS))


def test_disc_needs_no_image():
    geometry = circular(
        views=90,
        source_to_isocentre_mm=410.0,
        source_to_detector_mm=553.0,
        columns=120,
        rows=1,
        column_pitch_mm=0.9,
        row_pitch_mm=0.9,
    )
    scene = DiscScene(70.0, "pmma")
    physics = {"spectrum": {"kvp": 90.0, "filtration_mm": 3.0, "sensor_mm": 0.6}}
    taken = scans(scene, physics, 4, geometry=geometry)
    prepared_data = prepared.prepare(
        taken, None, Chain(scene, geometry, PHOTONS), tube_kvp=90.0, known={"scale": 0.3, "size": 0.01}
    )
    baseline = trial(prepared_data.fitter, ())
    found = trial(prepared_data.fitter, ("spectrum",), baseline, baseline)
    assert found.score - baseline.score > 100
    assert found.fit.physics["spectrum"]["filtration_mm"] == pytest.approx(
        3.0, abs=3 * found.fit.errors["spectrum"]["filtration_mm"]
    )


def test_logarithms_of_sample_variances_are_unbiased():
    random = np.random.default_rng(8)
    shape = (24, 4, 16)
    flat = np.ones(shape)
    z = []
    for _ in range(200):
        repeats = random.normal(size=(2, *shape)).astype(np.float32)
        found = observed.observe(observed.Scans(repeats, None, flat.astype(bool)), flat)
        z.append(np.log(found.variance) / found.variance_error)
    # 76 800 blocks of 4 rays: the mean is -0.34 without the correction.
    assert np.mean(z) == pytest.approx(0, abs=0.02)
    assert np.std(z) == pytest.approx(1, abs=0.02)


def test_alignment_at_its_limit_changes_the_verdict_text(scene):
    """A quarter fewer photons than declared, and scatter: scatter is named with a caution."""
    hidden = {"photon_flux": {"factor": 0.75}, "scatter": {"amount": 0.05, "width_mm": 60.0}}
    _, found = diagnosed(scene, hidden, library=("scatter", "motion"))
    content = found.content
    assert [effect["name"] for effect in content["effects"]] == ["scatter"]
    assert content["verdict"] == "mismatch partly explained"
    assert any(line.startswith("logarithm of the photons is") for line in content["doubts"])
    assert content["verdict_lines"][0].startswith("Best explanation: scatter")
    assert "RMS" in content["sentence"]
