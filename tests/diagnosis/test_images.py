"""Diagnosis of images: whitening of noise with a known spectrum, errors against realizations, and effect recovery."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage
from simulated_scans import body, chosen, noisy_lines

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.base.settings import FbpSettings
from virtual_phantom.diagnosis.comparison.regions import complete
from virtual_phantom.diagnosis.fitting.linearization import BASE, Linearization, LinearizationPoint
from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.images.model import noise_lines
from virtual_phantom.diagnosis.images.observed import LAGS, Condenser
from virtual_phantom.diagnosis.images.prepared import prepare
from virtual_phantom.diagnosis.images.setting import central_slices
from virtual_phantom.diagnosis.images.whitening import image_whitening, local_variance
from virtual_phantom.diagnosis.projections.discretization import model_and_floor
from virtual_phantom.diagnosis.verdict.verdict import diagnose
from virtual_phantom.physics.beam.materials import Segmentation
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.effect import acts_on_images, load
from virtual_phantom.physics.scenes.scene import VoxelScene
from virtual_phantom.reconstruction.images import reconstruct_hu
from virtual_phantom.simulation.reconstruct import apply_image_effects

MU, PHOTONS, REPEATS = 0.0193, 1e5, 4
SHAPE = (6, 40, 40)
GEOMETRY = circular(
    views=40,
    source_to_isocentre_mm=570.0,
    source_to_detector_mm=1040.0,
    columns=50,
    rows=8,
    column_pitch_mm=10.0,
    row_pitch_mm=10.0,
)
GRID = Grid(SHAPE, (5.4, 6.4, 6.4))


def blurred_noise(random, count, sigma=1.0):
    noise = random.normal(size=(count, *SHAPE))
    noise = ndimage.gaussian_filter(noise, (0, 0, sigma, sigma), mode="wrap")
    return 20 * noise / noise.std()


def test_whitened_noise_is_white():
    random = np.random.default_rng(1)
    used = np.ones(SHAPE, bool)
    white = image_whitening(blurred_noise(random, 40, 0.6), used, np.zeros(SHAPE), 2)
    fresh = np.stack([white(one) for one in blurred_noise(random, 40, 0.6)])
    assert fresh.var() == pytest.approx(1, abs=0.05)
    neighbours = (fresh[..., 1:] * fresh[..., :-1]).mean()
    before = blurred_noise(random, 40, 0.6)
    assert (before[..., 1:] * before[..., :-1]).mean() / before.var() > 0.4 > 0.05 > abs(neighbours)
    assert np.abs(local_variance(white, blurred_noise(random, 40, 0.6)) - 1).max() < 0.3


def test_floor_acts_like_noise_common_to_all_repeats():
    random = np.random.default_rng(2)
    used, noise = np.ones(SHAPE, bool), blurred_noise(random, 40, 0.3)
    floor = 10 * random.normal(size=SHAPE)
    bare, with_floor = (image_whitening(noise, used, error, 4) for error in (np.zeros(SHAPE), floor))
    # The noise of a mean of 4 repeats is 20 / 2 = 10 HU. A floor of the same size halves the inverse variance.
    assert (with_floor(floor) ** 2).mean() / (bare(floor) ** 2).mean() == pytest.approx(0.5, abs=0.1)


def test_noise_statistics_scatter_by_their_errors():
    random = np.random.default_rng(3)
    used = np.ones(SHAPE, bool)
    used[:, :4] = False
    white = image_whitening(blurred_noise(random, 60), used, np.zeros(SHAPE), 2)
    condenser = Condenser(white, blurred_noise(random, 40), 10**9, np.zeros(SHAPE))
    z, pairs = [], []
    for _ in range(60):
        found = condenser.observe(blurred_noise(random, 3), used)
        z.append((found.variance - 1) / found.variance_error)
        pairs.append((found.correlation, found.correlation_error))
    assert np.std(z) == pytest.approx(1, abs=0.15)
    values = np.array([one for one, _ in pairs])
    assert values.std(axis=0) == pytest.approx(pairs[0][1], rel=0.5)
    # A Gaussian of standard deviation s gives a correlation of exp(-d^2 / 4 s^2) between voxels at distance d.
    expected = [np.exp(-sum(step**2 for step in lag[1:]) / 4) if not lag[0] else 0 for lag in LAGS]
    assert values.mean(axis=0) == pytest.approx(expected, abs=0.03)


def test_central_slices_are_symmetric_about_the_middle():
    valid = np.zeros((30, 4, 4), bool)
    valid[3:28] = True
    assert central_slices(valid) == slice(3, 27)
    valid[:] = True
    assert central_slices(np.ones((40, 4, 4), bool)) == slice(8, 32)
    with pytest.raises(InputError, match="needs 4"):
        few = np.zeros((30, 4, 4), bool)
        few[14:16] = True
        central_slices(few)


@pytest.fixture(scope="module")
def scene():
    grid = Grid((20, 80, 80), (4.0, 3.5, 3.5))
    volume = body(grid, (110, 80), 20.0, [((50, 10, None), 20, 800.0), ((-40, -20, -5), 18, -80.0)])
    return VoxelScene.of(volume, Segmentation(), MU)


def reconstruct(lines):
    return reconstruct_hu(np.asarray(lines, np.float32), GEOMETRY, GRID, "fbp", FbpSettings("coverage"), "cpu", MU)


def recorded(scene, physics, seed, repeats=REPEATS):
    """Images reconstructed from Poisson counts, as of a scanner."""
    before = {name: values for name, values in physics.items() if not acts_on_images(name)}
    after = {name: values for name, values in physics.items() if name not in before}
    state = Chain(scene, GEOMETRY, PHOTONS, samples=2).state(before)
    lines = noisy_lines(state, repeats, np.random.default_rng(seed))
    return np.stack([apply_image_effects(image, GRID.spacing, after) for image in reconstruct(lines)])


def prepared(scene, physics, seed=1, repeats=REPEATS):
    chains = model_and_floor(scene, GEOMETRY, 2, photons=PHOTONS)
    return prepare(
        recorded(scene, physics, seed, repeats),
        None,
        *chains,
        reconstruct,
        GRID.spacing,
        complete(GEOMETRY, GRID),
        np.random.SeedSequence(7),
        nominal_photons=PHOTONS,
    )


def found(prepared_data, candidates):
    return diagnose("images", prepared_data, chosen(prepared_data.fitter, candidates))


def test_realizations_use_the_same_random_numbers_with_and_without_afterglow(scene):
    state = Chain(scene, GEOMETRY, PHOTONS).state({})
    states = (state, replace(state, lag=(1e-4, 0.0, 1.0)))
    plain, glowing = (noise_lines(state, 2, np.random.SeedSequence(3)) for state in states)
    assert np.corrcoef(plain.ravel(), glowing.ravel())[0, 1] > 0.999
    assert np.abs(plain - glowing).max() > 0


CANDIDATES = ("hu_calibration", "reconstruction_kernel", "photon_flux")


def test_no_hidden_effect_is_a_match(scene):
    prepared_data = prepared(scene, {})
    assert prepared_data.photons == pytest.approx(PHOTONS, rel=0.15)
    content = found(prepared_data, (*CANDIDATES, "rings")).content
    assert content["verdict"] == "match" and content["effects"] == [], content["sentence"]
    rms = content["held_out"]["rms_hu"]
    assert rms["before"] == pytest.approx(rms["floor"], rel=0.05)


@pytest.mark.parametrize(
    "name, key, value, seeds",
    [
        ("reconstruction_kernel", "sigma_mm", 2.5, (1,)),
        # In one realization, noise common to the halves can look like half of a faint effect.
        ("hu_calibration", "offset_hu", 12.0, (1, 2, 3)),
        ("slice_thickness", "thickness_mm", 7.0, (1,)),
        ("photon_flux", None, None, (1,)),
        ("scatter", "amount", 0.03, (1,)),
    ],
)
def test_hidden_effect_is_named(scene, name, key, value, seeds):
    effect = load(name)
    key = key or effect.parameters[0].name
    values = {
        parameter.name: parameter.neutral if parameter.neutral is not None else parameter.typical
        for parameter in effect.parameters
    }
    values[key] = 0.6 if value is None else value
    removed = []
    for seed in seeds:
        content = found(prepared(scene, {name: values}, seed), dict.fromkeys([*CANDIDATES, name])).content
        named = {effect["name"]: effect["parameters"] for effect in content["effects"]}
        assert list(named)[:1] == [name], content["sentence"]
        low, high = named[name][key]["ci95"]
        assert low - (high - low) / 2 < values[key] < high + (high - low) / 2
        removed.append(content["excess_removed"])
    assert np.median(removed) > 0.9


def test_gain_errors_of_detector_elements_are_named_as_rings(scene):
    """The truth is a gain of every element in the projections; test_no_hidden_effect_is_a_match has none."""
    physics = {"gain_pattern": {"rms": 0.008, "detector": 5.0}}
    prepared_data = prepared(scene, physics)
    diagnosis = found(prepared_data, (*CANDIDATES, "rings"))
    assert [effect["name"] for effect in diagnosis.content["effects"]] == ["rings"]
    images = [
        reconstruct(Chain(scene, GEOMETRY, PHOTONS).state(one).line_integrals()[None])[0] for one in ({}, physics)
    ]
    data = prepared_data.data
    rings = data.pattern_field(diagnosis.choice.chosen.fit.pattern.values)
    used = data.usable & (rings != 0)
    found_rings = data.white.inverse(np.where(data.usable, rings, 0))[used]
    assert np.corrcoef(found_rings, (images[1] - images[0])[used])[0, 1] > 0.5


def test_single_repeat_states_the_source_of_its_noise(scene):
    """Mean of six realizations: chi-square of one realization scatters by 0.05."""
    chi_square = []
    for seed in range(1, 7):
        prepared_data = prepared(scene, {}, seed, repeats=1)
        assert prepared_data.single and "slices" in prepared_data.held_out_text
        assert prepared_data.photons == pytest.approx(PHOTONS, rel=0.15)
        fitter = prepared_data.fitter
        baseline = trial(fitter, ())
        square = (fitter.residuals(baseline.fit, held_out=True)[0] ** 2 * fitter.held_weights[0]).sum()
        chi_square.append(square / (fitter.held_weights[0] > 0).sum())
    assert np.mean(chi_square) == pytest.approx(1, abs=0.2)


def test_noise_does_not_depend_on_earlier_calls(scene):
    """The position of the object at which the noise is computed is part of the linearization."""
    fresh, used = (prepared(scene, {}).fitter.model for _ in range(2))
    expected = {one.name: one.expected for one in fresh.base_nuisances}
    moved = expected | {"x_mm": 4.0}
    there = Linearization(LinearizationPoint({}, {"x_mm": 4.0}))
    used.images({}, moved)
    used.images({}, moved, there)
    for nuisance, linearization in ((expected, BASE), (moved, BASE), (moved, there)):
        for one, other in zip(*(m.images({}, nuisance, linearization) for m in (fresh, used)), strict=True):
            np.testing.assert_array_equal(one, other)
    assert not np.array_equal(fresh.images({}, moved)[1], fresh.images({}, moved, there)[1])
    assert fresh.needs_relinearization(BASE.errors, expected | {"x_mm": 7.0}, None, None)
    assert not fresh.needs_relinearization(BASE.errors, expected | {"x_mm": 6.0}, None, None)
