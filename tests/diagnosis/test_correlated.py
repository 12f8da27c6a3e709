"""Noise that is correlated between neighbors: whitening, and tests with correct errors."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_scans import body, noisy_lines

from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.diagnosis.fitting.priors import Statement
from virtual_phantom.diagnosis.fitting.problem import Problem
from virtual_phantom.diagnosis.fitting.templates import data_changes
from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.noise.gain_pattern import estimate
from virtual_phantom.diagnosis.noise.whitening import WHITE, Correlations, Whitening, estimated, of_state
from virtual_phantom.diagnosis.projections import observed, prepared
from virtual_phantom.diagnosis.projections.residual_maps import domain_tests
from virtual_phantom.diagnosis.residuals.residual_tests import HalfResiduals
from virtual_phantom.diagnosis.uncertainty.prediction_error import changes_by_parameter_errors
from virtual_phantom.physics.beam.materials import Segmentation
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.noise.correlation import correlations
from virtual_phantom.physics.scenes.scene import VoxelScene
from virtual_phantom.physics.scenes.shapes import DiscScene
from virtual_phantom.physics.state import State

PHOTONS = 1e5
SHAPE = (14, 4, 6)


def geometry_of(views, rows, columns, pitch_mm=12.0):
    return circular(
        views=views,
        source_to_isocentre_mm=570.0,
        source_to_detector_mm=1040.0,
        columns=columns,
        rows=rows,
        column_pitch_mm=pitch_mm,
        row_pitch_mm=pitch_mm,
        view_interval_ms=1.0,
    )


def shared_by(column, row, share, memory, tail=0.0, reach=1) -> Correlations:
    """Correlations of shares 1 - 2c and c (1 - q) q^(n - 1), and 1 - k, k (1 - d), k (1 - d) d, ... along views.

    Shares of columns and rows end at a reach, where the last share includes all further ones.
    """
    pixels = []
    for c in (column, row):
        side = [c * (1 - tail) * tail**n for n in range(reach - 1)] + [c * tail ** (reach - 1)]
        kernel = np.array([*side[::-1], 1 - 2 * c, *side])
        square = (kernel**2).sum()
        pixels.append(tuple(float((kernel[lag:] * kernel[:-lag]).sum() / square) for lag in range(1, len(kernel))))
    weights = np.array([1 - share, *(share * (1 - memory) * memory ** np.arange(400))])
    first = (weights[1:] * weights[:-1]).sum() / (weights**2).sum()
    return Correlations(*pixels, (first, memory if share else 0.0))


def state_of(lines, neighbours=(0.0, 0.0), lag=(0.0, 0.0, 1.0), electronic=0.0, tail=0.0):
    signal = np.exp(-lines)
    air = np.ones((1, *lines.shape[1:]))
    return State(
        geometry_of(*lines.shape),
        photons=PHOTONS,
        signal=signal,
        air=air,
        neighbours=neighbours,
        tail=tail,
        lag=lag,
        electronic=electronic,
    )


def covariance_of(state) -> np.ndarray:
    """Covariance [ray, ray] of the line integrals from the share of each photon in each ray, without earlier views."""
    shape = state.signal.shape
    units = np.eye(state.signal.size).reshape(-1, *shape)
    read = np.stack([state.read_out(unit, before_scan=np.zeros(shape[1:])).ravel() for unit in units], axis=1)
    found = read @ np.diag(state.signal.ravel() / state.photons) @ read.T
    found += np.eye(len(found)) * (state.electronic / state.photons) ** 2
    change = 1 / state.measured.ravel()
    return found * np.outer(change, change)


@pytest.mark.parametrize("tail", [0.0, 0.4])
def test_correlations_of_neighbors_equal_those_of_the_covariance(tail):
    """Steep signals, detector edges, a missing ray and electronic noise; every pair is evaluated separately."""
    random = np.random.default_rng(1)
    state = state_of(random.uniform(0, 2, SHAPE), (0.1, 0.06), (0.2, 0.5, 0.0), electronic=50.0, tail=tail)
    covariance, number = covariance_of(state), np.arange(state.signal.size).reshape(SHAPE)
    weight = random.uniform(0.5, 2, SHAPE) / state.variance()
    weight[3, 1, 2] = 0
    flat = weight.ravel()
    mean = (flat * np.diag(covariance)).sum() / (flat > 0).sum()
    for axis, found in zip((2, 1, 0), correlations(state, weight), strict=True):
        low, high = (np.take(number, range(a, SHAPE[axis] - 1 + a), axis).ravel() for a in (0, 1))
        both = np.sqrt(flat[low] * flat[high])
        assert found == pytest.approx((both * covariance[low, high]).sum() / (both > 0).sum() / mean, rel=1e-9)
    assert not correlations(state_of(np.zeros(SHAPE)))[:].any()


@pytest.mark.parametrize(
    ("column", "row", "share", "memory", "tail"),
    [(0.15, 0.1, 0, 0, 0), (0, 0, 0.2, 0.5, 0), (0.1, 0, 0.1, 0.8, 0), (0.15, 0.1, 0, 0, 0.4)],
)
def test_whitened_noise_is_white(column, row, share, memory, tail):
    """Compare with the covariance of the chain's own detector, for a signal that is steep along columns and rows."""
    random = np.random.default_rng(2)
    lines = np.broadcast_to(random.uniform(0, 1.5, SHAPE[1:]), SHAPE).copy()
    # The covariance omits afterglow from before the scan. The last views are compared, where it has decayed.
    views = 3
    state = state_of(np.concatenate([lines] * 4), (column, row), (share, memory, 0.0), tail=tail)
    shape = state.signal.shape
    of_columns, of_rows = (shared_by(column, row, share, memory, tail, length // 2) for length in SHAPE[:0:-1])
    true = replace(of_columns, rows=of_rows.rows)
    white = Whitening(true, np.concatenate([lines] * 4), np.ones(shape, bool))
    units = np.eye(state.signal.size).reshape(-1, *shape)
    change = np.stack([white(unit).ravel() for unit in units], axis=1)
    last = slice(-views * SHAPE[1] * SHAPE[2], None)
    found = (change @ covariance_of(state) @ change.T)[last, last]
    scale = np.sqrt(np.outer(np.diag(found), np.diag(found)))
    assert np.abs(found / scale - np.eye(len(found))).max() < 2e-3
    # Each ray keeps its own quantum noise before sharing, relative to the signal: S / I0 / (H S)^2.
    alone = white.variance(np.concatenate([lines] * 4)).ravel()[last] / PHOTONS
    np.testing.assert_allclose(np.diag(found), alone, rtol=2e-3)
    own_noise = state.signal / state.photons / state.measured**2
    np.testing.assert_allclose(alone, own_noise.ravel()[last], rtol=1e-5)
    np.testing.assert_allclose(white.inverse(white(lines_like := random.normal(size=shape))), lines_like, atol=1e-9)


def random_noise(true: Correlations, shape, random, count) -> np.ndarray:
    """Normal noise [realization, view, row, column] with these correlations."""
    roots = [np.linalg.cholesky(true.covariance(axis, length)) for axis, length in enumerate(shape)]
    return np.einsum("ai,bj,ck,nijk->nabc", *roots, random.normal(size=(count, *shape)), optimize=True)


@pytest.mark.parametrize(
    "setting",
    [(0.1, 0.03, 0.0, 0.0), (0.0, 0.0, 0.2, 0.5), (0.15, 0.05, 0.1, 0.8), (0.15, 0.1, 0.0, 0.0, 0.4, 4)],
)
def test_correlations_are_estimated_from_differences_of_repeats(setting):
    random, shape, repeats = np.random.default_rng(3), (72, 8, 48), 4
    true = shared_by(*setting)
    noise = random_noise(true, shape, random, repeats)
    found = estimated(list(noise - noise.mean(axis=0)), np.zeros(shape), np.ones(shape, bool), repeats - 1)
    error = 2 / np.sqrt(72 * 8 * 48 * 3)  # which correlated noise makes larger than 1 / sqrt(pairs)
    for axis in ("columns", "rows"):
        lags = np.zeros((2, 8))
        for row, one in zip(lags, (found, true), strict=True):
            row[: len(getattr(one, axis))] = getattr(one, axis)
        np.testing.assert_allclose(*lags, atol=4 * error)
    # The correlations that sums over views depend on.
    whole = [1 + 2 * first / (1 - memory) for first, memory in (found.views, true.views)]
    assert whole[0] == pytest.approx(whole[1], rel=0.07)


def test_white_noise_is_unchanged():
    random, shape = np.random.default_rng(4), (72, 8, 48)
    ones = np.ones(shape, bool)
    found = []
    for _ in range(5):
        noise = random.normal(size=(4, *shape))
        found.append(estimated(list(noise - noise.mean(axis=0)), np.zeros(shape), ones, 3))
    assert sum(not one.white for one in found) <= 1
    assert WHITE.white and WHITE.variance_of_neighbors(2, shape) == 1


def test_variances_of_sums_of_squares_and_correlations_match_simulation():
    """4000 realizations of a small field, in which edges have a large share."""
    random, shape, draws = np.random.default_rng(5), (12, 4, 10), 4000
    true = shared_by(0.15, 0.1, 0.2, 0.5)
    noise = random_noise(true, shape, random, draws)
    part = noise[:, 3:7, :2, 5:]
    square = (part**2).sum(axis=(1, 2, 3))
    places = (slice(3, 7), slice(0, 2), slice(5, 10))
    fewer = np.prod([true.variance_of_squares(axis, shape[axis], place) for axis, place in enumerate(places)])
    assert square.var() / square.mean() ** 2 * part[0].size / 2 == pytest.approx(fewer, rel=0.12)
    assert fewer > 1.2
    noise = random_noise(true, (24, 8, 24), random, 800)
    mean = (noise**2).mean(axis=(1, 2, 3))
    for axis in range(3):
        low, high = (np.take(noise, range(a, noise.shape[axis + 1] - 1 + a), axis + 1) for a in (0, 1))
        ratio = (low * high).mean(axis=(1, 2, 3)) / mean
        pairs = low[0].size
        assert ratio.var() * pairs == pytest.approx(true.variance_of_neighbors(axis, (24, 8, 24)), rel=0.2)


def test_rays_next_to_missing_rays_do_not_count():
    usable = np.ones((20, 6, 12), bool)
    usable[:, 2, 5] = False
    white = Whitening(shared_by(0.1, 0.1, 0, 0), np.zeros(usable.shape), usable)
    lost = usable[0] & ~white.counted[0]
    np.testing.assert_array_equal(np.argwhere(lost), [[1, 5], [2, 4], [2, 6], [3, 5]])
    # Every second view: the afterglow of a view is in the next view only, which is missing.
    usable = np.ones((20, 6, 12), bool)
    usable[1::2] = False
    white = Whitening(shared_by(0, 0, 0.2, 0.0), np.zeros(usable.shape), usable)
    assert white.counted[::2].all() and not white.counted[1::2].any()
    residual = np.random.default_rng(6).normal(size=usable.shape) * usable
    np.testing.assert_array_equal(white(residual), residual)
    # Long afterglow is in all later views: weights 0.8 and 0.2 0.5 0.5^j.
    true = shared_by(0, 0, 0.2, 0.5)
    assert true.of_every(2).views == pytest.approx((true.views[0] * 0.5, 0.25))


def test_gain_pattern_is_estimated_in_correlated_noise():
    """White constants per pixel plus noise that pixels share: neither is mistaken for the other."""
    random, shape = np.random.default_rng(7), (60, 8, 64)
    true = shared_by(0.1, 0.1, 0, 0)
    white = Whitening(true, np.zeros(shape), np.ones(shape, bool))
    noise = 0.02 * random_noise(true, shape, random, 1)[0]
    weight = np.full(shape, 1 / (0.02**2 * white.correlations.amplification))
    found = estimate(white(noise), weight, white)
    # The mean of 512 mean squares varies by 1/16 of the variance of the pixels' noise.
    assert found.rms * white.roughness((3, 3)) < np.sqrt(3 / 16 / weight[:, 0, 0].sum())
    pattern = 0.006 * random.normal(size=shape[1:])
    found = estimate(white(noise + pattern), weight, white)
    assert abs(found.rms - pattern.std()) < 3 * found.error
    assert np.std(found.values - pattern) < 0.5 * pattern.std()


@pytest.fixture(scope="module")
def scene():
    grid = Grid((16, 64, 64), (4.0, 4.5, 4.5))
    volume = body(grid, (110, 80), 20.0, [((50, 10, 5), 20, 800.0), ((-40, -20, -5), 18, -80.0)])
    return VoxelScene.of(volume, Segmentation(), 0.0193)


def scans(chain, physics, random, repeats=4):
    state = chain.state(physics)
    lines = noisy_lines(state, repeats, random).astype(np.float32)
    white = state.measured_air.mean(axis=0) * state.photons
    return observed.Scans(lines, white, np.ones(lines.shape[1:], bool))


CORRELATED = {
    "optical_crosstalk": {"column": 0.1, "row": 0.1},
    # A time constant of half a view interval: 0.2 of the signal of a view is read with later views.
    "afterglow": {"share": 0.4 / (1 - np.exp(-2)), "time_constant_ms": 0.5, "before": 1.0},
}


@pytest.mark.parametrize("name", CORRELATED)
def test_no_residual_remains_with_the_true_effect_in_correlated_noise(scene, name):
    """If rays were treated as independent, the standard deviation of z of blocks would be 1.4 and 1.2."""
    chain, z = Chain(scene, geometry_of(60, 4, 40), PHOTONS), {}
    draws = 3
    for draw in range(draws):
        random = np.random.default_rng(np.random.SeedSequence(11, spawn_key=(draw,)))
        prepared_data = prepared.prepare(
            scans(chain, {name: CORRELATED[name]}, random), None, chain, nominal_photons=PHOTONS
        )
        fitter = prepared_data.fitter
        fit = trial(fitter, (name,)).fit
        places = prepared_data.domains(
            prepared_data.half(fit, held_out=True), fit, prepared_data.half(fit, held_out=False)
        )
        assert not places[0].significant, places[0]
        for place in places:
            z.setdefault(place.domain, []).append(place.map.ravel())
    for domain in ("projections", "noise variance", "views", "columns", "pixels"):
        of_all = np.concatenate(z[domain])
        assert np.sqrt((of_all**2).mean()) == pytest.approx(1, abs=3 / np.sqrt(2 * of_all.size)), domain


def test_errors_of_a_fit_are_those_of_the_directions_that_parameters_span():
    """Summed over all data:

    tr(J'WJ (J'WJ + K)^-1), the number of directions constrained by the data more than by the prior.
    """
    chain = Chain(DiscScene(200.0, "water"), geometry_of(24, 2, 40), PHOTONS)
    prepared_data = prepared.prepare(scans(chain, {}, np.random.default_rng(8)), None, chain, nominal_photons=PHOTONS)
    fitter = prepared_data.fitter
    fit = trial(fitter, ("electronic_noise",)).fit
    found = changes_by_parameter_errors(fitter, fit)
    total = sum(float((weight * one**2).sum()) for weight, one in zip(fitter.weights, found, strict=True))
    problem = Problem(fitter, fit.effects, fit)
    changes = data_changes(problem)
    information = changes.T @ changes
    expected = np.trace(np.linalg.solve(information + np.diag(problem.prior_precision), information))
    assert total == pytest.approx(expected, rel=1e-3) and 3 < total < len(problem.start)


def test_halves_share_no_noise_if_weights_are_measured():
    """Weights from deviations from the mean of all repeats would depend on the difference of the halves."""
    chain = Chain(DiscScene(200.0, "water"), geometry_of(36, 4, 16, 20.0), PHOTONS)
    z = []
    for draw in range(40):
        prepared_data = prepared.prepare(
            scans(chain, {}, np.random.default_rng(draw)), None, chain, nominal_photons=PHOTONS
        )
        fitter = prepared_data.fitter
        place = {one.name: one.expected for one in fitter.model.base_nuisances}
        parts = [
            data.residuals(fitter.model.predict({}, place, data))
            for data in (prepared_data.data, prepared_data.held_out)
        ]
        halves = [
            HalfResiduals(part, weights, data)
            for part, weights, data in zip(
                parts, (fitter.weights, fitter.held_weights), (prepared_data.data, prepared_data.held_out), strict=True
            )
        ]
        common = halves[1].in_common(halves[0])
        z.append(common.products.sum() / np.sqrt(common.there.sum()))
    assert abs(np.mean(z)) < 4 / np.sqrt(len(z))
    # Uncorrelated: 1 / (3 rays) for the products of every block, 384 blocks of 2304 rays.
    assert 384 / 3 / np.sqrt(2304) > 4 / np.sqrt(len(z))


def test_correlations_of_a_state_are_those_of_a_uniform_signal():
    true = shared_by(0.1, 0.05, 0.2, 0.5)
    found = of_state(state_of(np.zeros((400, 40, 40)), (0.1, 0.05), (0.2, 0.5, 1.0)))
    for axis in ("columns", "rows", "views"):
        np.testing.assert_allclose(getattr(found, axis), getattr(true, axis), rtol=1e-6)
    found = of_state(state_of(np.zeros((4, 40, 60)), (0.1, 0.05), tail=0.3))
    right = shared_by(0.1, 0.05, 0.0, 0.0, 0.3, 20)
    for axis in ("columns", "rows"):
        lags = getattr(found, axis)
        np.testing.assert_allclose(lags, getattr(right, axis)[: len(lags)], atol=1e-6)
        assert getattr(right, axis)[len(lags)] < 1e-4 < lags[-1]
    assert of_state(state_of(np.zeros((4, 4, 4)), electronic=50.0)).white
    # Electronic noise equal to a pixel's own quantum noise halves all correlations, but not their decay.
    found = of_state(state_of(np.zeros((4, 4, 400)), (0.1, 0.0), (0.0, 0.0, 1.0), np.sqrt(PHOTONS * 0.66)))
    np.testing.assert_allclose(found.columns, np.array(true.columns) / 2, rtol=0.01)


def test_single_repeat_takes_its_correlations_from_the_fit(scene):
    """Crosstalk blurs the mean that the noise is measured from.

    The spread of blocks is then correct, not 1.5 times as large. The object varies along z, since a disc does not show
    crosstalk of rows.
    """
    physics = {"optical_crosstalk": {"column": 0.1, "row": 0.1}}
    chain = Chain(scene, geometry_of(60, 8, 40), PHOTONS)
    prepared_data = prepared.prepare(
        scans(chain, physics, np.random.default_rng(12), repeats=1), None, chain, nominal_photons=PHOTONS
    )
    first = trial(prepared_data.fitter, ("optical_crosstalk",)).fit
    found = prepared_data.with_noise_of(first)
    assert found.fitter is not prepared_data.fitter and found.with_noise_of(first) is found
    assert prepared_data.with_noise_of(trial(prepared_data.fitter, ()).fit) is prepared_data
    fit = trial(found.fitter, ("optical_crosstalk",)).fit

    def spread(one, of):
        half = one.half(fit, held_out=True)
        uncertain = changes_by_parameter_errors(of, fit)
        places = domain_tests(half, uncertain=uncertain)
        z = next(place.map for place in places if place.domain == "projections")
        return np.sqrt((z**2).mean())

    assert spread(found, found.fitter) == pytest.approx(1, abs=3 / np.sqrt(2 * 384))
    assert spread(prepared_data, prepared_data.fitter) > 1.2


def test_declared_physics_sets_the_noise_correlation_of_a_single_repeat():
    """No effect is then selected twice; effects found in addition still count."""
    glow = {"share": 0.3, "time_constant_ms": 5.0, "before": 0.0}
    physics = {"optical_crosstalk": {"column": 0.1, "row": 0.1}, "afterglow": glow}
    declared = {name: {key: Statement(value, 0.0) for key, value in one.items()} for name, one in physics.items()}
    chain = Chain(DiscScene(200.0, "water"), geometry_of(60, 8, 40), PHOTONS)
    taken = scans(chain, physics, np.random.default_rng(12), repeats=1)
    declared_only = {"optical_crosstalk": declared["optical_crosstalk"]}
    whole, part, none = (
        prepared.prepare(taken, None, chain, nominal_photons=PHOTONS, declared=one)
        for one in (declared, declared_only, {})
    )
    fit = trial(whole.fitter, ()).fit
    assert whole.with_noise_of(fit) is whole
    # The noise follows the physics that was found, whatever was declared.
    after = [one.with_noise_of(fit) for one in (part, none)]
    for one in after:
        power, right = (each.data.whitening.noise.power(2, 40) for each in (one, whole))
        np.testing.assert_allclose(power, right, rtol=1e-3)
        assert one.data.whitening.noise.views == pytest.approx(whole.data.whitening.noise.views, rel=1e-3)
        # Except where the object's edge moves through a block, which counts as noise until it is modeled.
        assert np.median(one.variance / whole.variance) == pytest.approx(1, abs=0.05)
        counted = whole.fitter.weights[0] > 0
        assert np.median(one.fitter.weights[0][counted] / whole.fitter.weights[0][counted]) == pytest.approx(
            1, abs=0.05
        )
