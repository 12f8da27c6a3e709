"""Effects of clinical scanners: anti-scatter grid, slow afterglow, vendor's water correction, tube current along z."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from simulated_scans import noisy_lines

from virtual_phantom.base.geometry import circular, helical
from virtual_phantom.io.exchange import write_line_integrals
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.effect import acts_on_images, load, names
from virtual_phantom.physics.effects.afterglow import of_views
from virtual_phantom.physics.scenes.shapes import DiscScene, ShapesScene, box
from virtual_phantom.physics.spread import TRUNCATED, spread
from virtual_phantom.physics.state import CORRECTION_LIMIT, State, correction_polynomial
from virtual_phantom.physics.stored_state import read_state, to_store

SCANNER = {"source_to_isocentre_mm": 500.0, "source_to_detector_mm": 1000.0}
GEOMETRY = circular(
    views=24, columns=60, rows=6, column_pitch_mm=6.0, row_pitch_mm=6.0, view_interval_ms=20.0, **SCANNER
)
HELIX = helical(views=48, volume_height_mm=60.0, columns=60, rows=6, column_pitch_mm=6.0, row_pitch_mm=6.0, **SCANNER)
PHOTONS = 2e4
TUBE = {"spectrum": {"kvp": 120.0, "filtration_mm": 6.0, "sensor_mm": 0.6}}


def chain(geometry=GEOMETRY, **options):
    return Chain(DiscScene(160.0, "water"), geometry, PHOTONS, **options)


def through_septa(beside_mm, away_mm, ratio, random):
    """Calculated share of rays from a distance that pass between plates of height `ratio` and distance 1."""
    entered = random.random(20_000)  # between two plates
    left = entered + ratio * beside_mm[:, None] / away_mm  # position of the ray at the exit
    return ((left > 0) & (left < 1)).mean(axis=1)


def test_scatter_passes_a_grid_as_often_as_rays_pass_its_plates():
    """Scatter of a bright pixel over the columns, against rays traced between the plates."""
    ratio, width_mm, away_mm = 8.0, 60.0, 500.0
    bright = np.zeros((1, 1, 61))
    bright[0, 0, 30] = 1.0
    detector = circular(views=1, columns=61, rows=1, column_pitch_mm=3.0, row_pitch_mm=3.0, **SCANNER)
    free = spread(bright, detector, width_mm)[0, 0]
    found = spread(bright, detector, width_mm, (away_mm / ratio, np.inf))[0, 0]
    passed = through_septa(detector.column_positions_mm(), away_mm, ratio, np.random.default_rng(1))
    np.testing.assert_allclose(found, free * passed, atol=4 * free.max() * 0.5 / math.sqrt(20_000))
    assert found.sum() < 0.5 * free.sum()


@pytest.mark.parametrize("beyond, mode", [(0.0, "constant"), (1.0, "nearest")])
def test_spread_continues_beyond_the_detector_as_scipy_does(beyond, mode):
    views = np.random.default_rng(1).random((2, 7, 9))
    detector = circular(views=2, columns=9, rows=7, column_pitch_mm=3.0, row_pitch_mm=2.0, **SCANNER)
    expected = gaussian_filter(views, (0, 3.0, 2.0), mode=mode, truncate=TRUNCATED)
    np.testing.assert_allclose(spread(views, detector, 6.0, beyond=beyond), expected, rtol=1e-12)


def test_grid_reduces_scatter_only():
    scatter = {"scatter": {"amount": 0.1, "width_mm": 60.0}}
    grid = {"anti_scatter_grid": {"ratio": 10.0, "ratio_along_rows": 0.0}}
    clean, with_scatter, with_grid = (chain().state(one) for one in ({}, scatter, scatter | grid))
    assert (with_grid.signal < with_scatter.signal).all() and (with_grid.signal > clean.signal).all()
    alone = chain().state(grid)
    np.testing.assert_array_equal(alone.signal, clean.signal)
    # A single row represents a beam that is constant along z; plates across the rows absorb a share there too.
    row = replace(GEOMETRY, rows=1)
    crossed = {"anti_scatter_grid": {"ratio": 10.0, "ratio_along_rows": 10.0}}
    less, more = (chain(row).state(scatter | one).signal - chain(row).state({}).signal for one in (crossed, grid))
    share = less / more
    np.testing.assert_allclose(share, share.mean(), rtol=1e-6)
    assert 0.1 < share.mean() < 0.6


def test_two_afterglows_decay_independently():
    """Readings after a flash of one view: each afterglow with its own share and time."""
    fast, slow = (0.06, 30.0), (0.02, 400.0)
    physics = {
        name: {"share": share, "time_constant_ms": constant, "before": 0.0}
        for name, (share, constant) in (("afterglow", fast), ("slow_afterglow", slow))
    }
    state = chain().state(physics)
    flash = np.zeros((6, 1, 1))
    flash[0] = 1.0
    expected = np.zeros(6)
    expected[0] = 1.0
    for share, constant in (fast, slow):
        share, memory = of_views(share, constant, 20.0)
        expected[0] -= share
        expected[1:] += share * (1 - memory) * memory ** np.arange(5)
    np.testing.assert_allclose(state.read_out(flash, step=1)[:, 0, 0], expected, rtol=1e-12)
    np.testing.assert_allclose(
        state.read_out(np.ones((3, 1, 1)), before_scan=np.ones((1, 1)), step=1)[0], 1 - 0.08, atol=0.03
    )


def test_noise_with_slow_afterglow_matches_simulation():
    physics = {
        "afterglow": {"share": 0.1, "time_constant_ms": 40.0, "before": 1.0},
        "slow_afterglow": {"share": 0.05, "time_constant_ms": 800.0, "before": 1.0},
    }
    state = chain().state(physics)
    scans = noisy_lines(state, 60, np.random.default_rng(4))
    ratio = (scans.var(axis=0, ddof=1) / state.log_noise()[1]).mean()
    assert ratio == pytest.approx(1, abs=4 * math.sqrt(2 / 59 / state.signal.size) + 2e-3)


def test_polynomial_continues_as_a_straight_line():
    lines, (square, cube) = np.array([0.0, 2.0, CORRECTION_LIMIT, 14.0]), (0.02, 0.001)
    values, slopes = correction_polynomial(lines, (square, cube))
    np.testing.assert_allclose(values[:3], (lines + square * lines**2 + cube * lines**3)[:3])
    assert values[3] - values[2] == pytest.approx(4 * slopes[3]) and slopes[3] == slopes[2]


def straightened(material):
    """Line integrals behind slabs relative to a straight line, without and with a water correction."""
    thick = np.arange(5.0, 260.0, 15.0)

    def behind(one, length, physics):
        slab = ShapesScene([box(one, (0, 0, 0), (1000, length, 1000))])
        thin = circular(views=1, columns=1, rows=1, column_pitch_mm=1.0, row_pitch_mm=1.0, **SCANNER)
        return float(Chain(slab, thin, PHOTONS).state(physics).line_integrals()[0, 0, 0])

    water = np.array([behind("water", length, TUBE) for length in thick])
    # Least squares for a straight line of any slope through water: a p^2 + b p^3 - s L = -p.
    columns = np.stack([water**2, water**3, -thick], axis=1)
    square, cube, _ = np.linalg.lstsq(columns, -water, rcond=None)[0]
    physics = TUBE | {"water_correction": {"quadratic": square, "cubic": cube}}
    lengths = thick if material == "water" else thick[thick < 100]
    plain, corrected = (
        np.array([behind(material, length, effects) for length in lengths]) / lengths for effects in (TUBE, physics)
    )
    return plain / plain[0], corrected / corrected[0]


def test_water_correction_linearizes_water_and_not_bone():
    plain, corrected = straightened("water")
    assert plain[-1] < 0.94 and np.abs(corrected - 1).max() < 0.01
    plain, corrected = straightened("bone")
    assert plain[-1] < corrected[-1] < 0.95


def test_noise_after_a_correction_follows_its_slope():
    physics = {"water_correction": {"quadratic": 0.05, "cubic": 0.002}, "electronic_noise": {"photons": 40.0}}
    state, plain = chain().state(physics), chain().state({"electronic_noise": {"photons": 40.0}})
    lines = plain.line_integrals()
    np.testing.assert_allclose(state.line_integrals(), lines + 0.05 * lines**2 + 0.002 * lines**3, atol=1e-12)
    slope = 1 + 0.1 * lines + 0.006 * lines**2
    np.testing.assert_allclose(state.variance(), plain.variance() * slope**2, rtol=1e-9)
    scans = noisy_lines(state, 60, np.random.default_rng(5))
    ratio = (scans.var(axis=0, ddof=1) / state.log_noise()[1]).mean()
    assert ratio == pytest.approx(1, abs=4 * math.sqrt(2 / 59 / state.signal.size) + 2e-3)


@pytest.mark.parametrize("name", [name for name in names() if not acts_on_images(name)])
def test_study_draws_noise_from_stored_line_integrals(name, tmp_path):
    """The file of line integrals contains all that the counts depend on."""
    effect = load(name)
    there = {} if effect.beside is None else {effect.beside: load(effect.beside).values({})}
    state = chain(replace(HELIX, view_interval_ms=20.0)).state(there | {name: effect.values({})})
    write_line_integrals(tmp_path / "clean.h5", state.line_integrals(), state.geometry, to_store(state))
    stored = read_state(tmp_path / "clean.h5")
    counts, again = (one.counts(np.random.default_rng(1)) for one in (state, stored))
    # Means are stored in single precision, which changes a few counts by one.
    assert np.mean(np.abs(counts - again) > 1.5) == 0 and np.mean(np.abs(counts - again) > 0.1) < 0.01


def test_readings_without_logarithm_are_corrected_as_the_smallest_positive_ones():
    one = np.ones((1, 1, 1))
    state = State(GEOMETRY, photons=100.0, signal=one, air=one, correction=(0.02, 0.0))
    found = state.apply_correction(np.array([-1.0, 0.0, 1e-6]).reshape(3, 1, 1)).ravel()
    assert (found > 0).all() and found[0] == found[1] == found[2]


def test_tube_current_along_z_changes_the_noise_only():
    helix, slope, curve = HELIX, 0.01, -1e-4
    plain = chain(helix).state({})
    state = chain(helix).state({"current_along_z": {"linear_per_mm": slope, "quadratic_per_mm2": curve}})
    z = helix.source_z_mm - (helix.source_z_mm[0] + helix.source_z_mm[-1]) / 2
    np.testing.assert_allclose(state.line_integrals(), plain.line_integrals(), atol=1e-12)
    expected = np.exp(-slope * z - curve * z**2)
    np.testing.assert_allclose((state.variance() / plain.variance()).mean(axis=(1, 2)), expected, rtol=1e-9)
