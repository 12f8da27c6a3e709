"""Scans of the independent simulator against closed forms: frame, noise, and added effects."""

from dataclasses import replace

import numpy as np
import pytest

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import circular
from virtual_phantom.physics.beam.materials import attenuation_per_mm as attenuation
from virtual_phantom.physics.beam.spectra import Anode
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.effect import checked, load
from virtual_phantom.physics.scenes.shapes import NOTHING, DiscScene, ShapesScene, cylinder, ellipsoid
from virtual_phantom.physics.state import State
from virtual_phantom.proof.hiding.catalogue import CATALOGUE
from virtual_phantom.proof.hiding.generate import NOMINAL
from virtual_phantom.proof.hiding.objects import Part, ScannedObject
from virtual_phantom.proof.hiding.unsteady import settling
from virtual_phantom.proof.hiding.xcist import (
    Materials,
    Scan,
    _configured,
    attenuation_of,
    attenuation_per_mm,
    energy_of_water,
    simulate,
)
from virtual_phantom.proof.hiding.xcist_surfaces import CYLINDER, ELLIPSOID, Surface, Surfaces

KEV, PHOTONS, VIEWS = 70.0, 2e4, 24
DETECTOR = {
    "columns": 40,
    "rows": 4,
    "column_pitch_mm": 5.0,
    "row_pitch_mm": 5.0,
    "source_to_isocentre_mm": 500.0,
    "source_to_detector_mm": 900.0,
}
CENTRE, RADIUS = np.array([18.0, -9.0, 0.5]), 22.0  # of a ball of water, mm


def scan(repeats=1, seed=1, surface="flat", **settings):
    order = Scan(views=VIEWS, kev=KEV, photons=PHOTONS, settings=settings, surface=surface, **DETECTOR)
    around = Surface(CYLINDER, "air", (0.0, 0.0, 0.0), (150.0, 150.0, 1000.0), density=0.0)  # XCIST needs a cylinder
    ball = Surface(ELLIPSOID, "water", tuple(CENTRE), (RADIUS,) * 3)
    return simulate(order, Surfaces((around, ball), cells_divided=(8, 2)), repeats, np.random.SeedSequence(seed))


def lines(taken):
    return -np.log(taken.readings / taken.air)


def chords(centre=CENTRE, source_mm=0.0, **changed):
    """Path lengths through the ball in the frame of geometry.py, [view, row, column] in mm.

    center      (3,), or one for every view, (view, 3)
    source_mm   displacement of the source along the columns
    """
    geometry = circular(views=VIEWS, **(DETECTOR | changed))
    sine, cosine = np.sin(geometry.angles_rad), np.cos(geometry.angles_rad)
    along = np.stack([cosine, sine, 0 * sine], axis=1)
    source = geometry.source_to_isocentre_mm * np.stack([-sine, cosine, 0 * sine], axis=1) + source_mm * along
    to_centre = np.broadcast_to(centre, (VIEWS, 3)) - source
    distance = geometry.source_to_detector_mm * np.stack([sine, -cosine, 0 * sine], axis=1)
    columns = (geometry.column_positions_mm() - source_mm)[:, None] * along[:, None, None]
    rows = geometry.row_positions_mm()[:, None, None] * np.array([0, 0, 1.0])
    rays = distance[:, None, None] + columns + rows
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    off = np.linalg.norm(np.cross(to_centre[:, None, None], rays), axis=-1)
    return 2 * np.sqrt(np.maximum(RADIUS**2 - off**2, 0))


@pytest.fixture(scope="module")
def plain():
    return scan(repeats=12)


def test_line_integrals_of_a_ball_follow_the_geometry(plain):
    mean = lines(plain).mean(axis=0)
    finer = {"columns": 200, "rows": 20, "column_pitch_mm": 1.0, "row_pitch_mm": 1.0}
    shape = (VIEWS, DETECTOR["rows"], 5, DETECTOR["columns"], 5)
    expected = attenuation_per_mm("water", KEV) * chords(**finer).reshape(shape).mean(axis=(2, 4))
    inside = expected > 0.5
    assert np.abs(mean - expected)[inside].max() < 0.03  # noise is 0.003
    assert abs((mean - expected)[inside].mean()) < 2e-3
    mirrored = attenuation_per_mm("water", KEV) * chords(CENTRE * (-1, 1, 1))
    assert np.abs(mean - mirrored)[inside].max() > 0.3


def test_rotated_parts_of_an_object_follow_the_geometry():
    """Elliptic column with an elliptic cavity; turned by +25 degrees, not by -25."""
    axes, hole = (45.0, 30.0, np.inf), ((5.0, 3.0, 1.0), (14.0, 8.0, 6.0))
    parts = Part("body", (0.0, 0.0, 0.0), axes, 25.0, "water"), Part("gas", *hole, 25.0, "air")
    body = Surfaces.of(ScannedObject("body", parts), attenuation_of(KEV), attenuation_per_mm("water", KEV))
    order = Scan(views=VIEWS, kev=KEV, photons=1e8, **DETECTOR)
    found = lines(simulate(order, body, 1, np.random.SeedSequence(1)))[0]

    def expected(turn_deg):
        shapes = [ellipsoid("water", (0, 0, 0), (45.0, 30.0, 5000.0), turn_deg), ellipsoid(NOTHING, *hole, turn_deg)]
        chain = Chain(ShapesScene(shapes, KEV), circular(views=VIEWS, **DETECTOR), samples=4)
        return chain.state({}).line_integrals() * attenuation_per_mm("water", KEV) / attenuation("water", [KEV])[0]

    assert (found - expected(25.0)).std() < 0.005 and (found - expected(-25.0)).std() > 0.1


@pytest.mark.parametrize("wobble_mm", [0.0, 8.0])
def test_arc_and_flying_focal_spot_follow_the_geometry(wobble_mm, plain):
    """XCIST's third-generation detector is an arc of small modules; its focal spot is deflected along the columns."""
    mean = lines(scan(repeats=12, surface="cylindrical", wobble_mm=wobble_mm)).mean(axis=0)
    scene = ShapesScene([ellipsoid("water", CENTRE, 3 * (RADIUS,))])
    finer = {"columns": 200, "rows": 20, "column_pitch_mm": 1.0, "row_pitch_mm": 1.0}
    shape = (VIEWS, DETECTOR["rows"], 5, DETECTOR["columns"], 5)

    def expected(**surface):
        paths = scene.path_lengths(circular(views=VIEWS, **(DETECTOR | finer | surface)))[0]
        return attenuation_per_mm("water", KEV) * paths.reshape(shape).mean(axis=(2, 4))

    spots = ((-wobble_mm, 0.0, 0.0), (wobble_mm, 0.0, 0.0))
    there = expected(surface="cylindrical", spots_mm=spots)
    inside = there > 0.5
    assert np.abs(mean - there)[inside].max() < 0.03 and abs((mean - there)[inside].mean()) < 2e-3
    if wobble_mm:
        assert np.abs(mean - expected(surface="cylindrical", spots_mm=spots[::-1]))[inside].max() > 0.3


def test_water_has_its_published_attenuation():
    # NIST's tables (Hubbell and Seltzer, 1995): 0.1837 and 0.2059 cm2/g at 80 and 60 keV.
    assert attenuation_per_mm("water", 80.0) == pytest.approx(0.01837, rel=0.01)
    assert attenuation_per_mm("water", 60.0) == pytest.approx(0.02059, rel=0.01)
    assert energy_of_water(0.01837) == pytest.approx(80.0, abs=1.5)


def test_zero_energy_has_no_attenuation():
    with pytest.raises(
        InputError,
        match="mu_water_per_mm: the water of the blind validation attenuates 0.016. to 0.026. per mm .*not 0.03",
    ):
        energy_of_water(0.03)


def test_noise_is_that_of_the_photons(plain):
    quanta = plain.readings / KEV
    middle = quanta[:, :, 1:3, 18:22]
    air = plain.air[1:3, 18:22] / KEV
    assert air.mean() == pytest.approx(PHOTONS, rel=5e-3)
    ratio = middle.var(axis=0, ddof=1) / middle.mean(axis=0)
    assert ratio.mean() == pytest.approx(1.0, abs=4 * np.sqrt(2 / 11 / ratio.size))


def test_repeats_and_seeds_differ_and_seeds_are_reproducible(plain):
    first, again, other = (scan(seed=seed).readings for seed in (3, 3, 4))
    assert np.array_equal(first, again) and not np.array_equal(first, other)
    assert not np.array_equal(plain.readings[0], plain.readings[1])


def test_white_field_decreases_with_the_solid_angle(plain):
    shape = plain.air / plain.air[1:3, 19:21].mean()
    # The scintillator absorbs slightly more of oblique rays: 0.2 % at the edge.
    assert np.abs(shape - circular(views=VIEWS, **DETECTOR).solid_angles()).max() < 5e-3


@pytest.mark.parametrize(
    ("settings", "geometry", "centre"),
    [
        ({"detector_columns_px": 0.4}, {"column_offset_px": 0.4}, CENTRE),
        ({"isocentre_mm": 15.0}, {"source_to_isocentre_mm": 515.0}, CENTRE),
        ({"detector_mm": -20.0}, {"source_to_detector_mm": 880.0}, CENTRE),
    ],
)
def test_displaced_parts_are_at_their_positions(settings, geometry, centre, plain):
    changed = lines(scan(repeats=12, **settings)).mean(axis=0) - lines(plain).mean(axis=0)
    mu = attenuation_per_mm("water", KEV)
    expected = mu * (chords(centre, **geometry) - chords())
    inside = chords() > 25
    assert np.corrcoef(changed[inside], expected[inside])[0, 1] > 0.9
    assert np.polyfit(expected[inside], changed[inside], 1)[0] == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(
    ("settings", "physics"),
    [
        ({"detector_rows_mm": 3.0}, {"detector_row_offset": {"rows_mm": 3.0}}),
        (
            {"source_mm_per_s": (6.0, -3.0, 10.0)},
            checked({"source_drift": {"columns_mm_per_s": 6.0, "rows_mm_per_s": -3.0, "away_mm_per_s": 10.0}}),
        ),
        ({"angle_wave_deg": (1.5, -2.0)}, {"view_angle_error": {"cosine_deg": 1.5, "sine_deg": -2.0}}),
    ],
)
def test_bench_geometry_agrees_with_the_library(settings, physics, plain):
    """Two programs with independent equations: changes of a ball's shadow."""
    taken = scan(repeats=12, **settings)
    geometry = circular(views=VIEWS, view_interval_ms=1000.0 / VIEWS, **DETECTOR)
    scene = ShapesScene([ellipsoid("water", CENTRE, 3 * (RADIUS,))])
    chain = Chain(scene, geometry, samples=4)
    expected, still = chain.state(physics), chain.state({})
    mu = attenuation_per_mm("water", KEV) / chain.scene.attenuation_per_mm[0]
    change = mu * (expected.line_integrals() - still.line_integrals())
    inside = still.line_integrals() > 0.4
    found = (lines(taken).mean(axis=0) - lines(plain).mean(axis=0))[inside]
    assert np.corrcoef(found, change[inside])[0, 1] > 0.9
    assert np.polyfit(change[inside], found, 1)[0] == pytest.approx(1.0, abs=0.1)


def test_axis_offset_shifts_the_object_along_the_columns(plain):
    changed = lines(scan(repeats=12, axis_shift_mm=1.5)).mean(axis=0) - lines(plain).mean(axis=0)
    geometry = circular(views=VIEWS, **DETECTOR)
    mu = attenuation_per_mm("water", KEV)
    along = np.stack([np.cos(geometry.angles_rad), np.sin(geometry.angles_rad), np.zeros(VIEWS)], axis=1)
    expected = mu * (chords(CENTRE + 1.5 * along) - chords())
    inside = chords() > 25
    assert np.polyfit(expected[inside], changed[inside], 1)[0] == pytest.approx(1.0, abs=0.1)


def test_drift_ends_at_its_final_value(plain):
    drift = np.array([6.0, -4.0, 1.0])
    changed = lines(scan(repeats=12, velocity_mm_per_s=tuple(drift))).mean(axis=0) - lines(plain).mean(axis=0)
    mu = attenuation_per_mm("water", KEV)
    for view in (0, VIEWS - 1):
        at = CENTRE + settling((view + 0.5) / VIEWS) * drift
        expected = mu * (chords(at) - chords())[view]
        inside = chords()[view] > 25
        assert np.polyfit(expected[inside], changed[view][inside], 1)[0] == pytest.approx(1.0, abs=0.15)


def test_electronic_noise_adds_its_variance(plain):
    noisy = scan(repeats=12, electronic_photons=150.0)
    more = (noisy.readings.var(axis=0, ddof=1) - plain.readings.var(axis=0, ddof=1)).mean() / KEV**2
    assert more == pytest.approx(150.0**2, rel=0.1)


def test_electronic_noise_is_in_noise_equivalent_quanta():
    """Polychromatic: relative to the reading in air it is sigma / N, whatever a quantum reads.

    Dark pixels have no other noise.
    """
    taken = scan(repeats=40, electronic_photons=2000.0, kvp=120.0, aluminium_mm=3.0)
    relative = (taken.readings / taken.air).std(axis=0, ddof=1)[:, 1:3, 18:22]
    quantum = np.sqrt((taken.readings.mean(axis=0) / taken.air)[:, 1:3, 18:22] / PHOTONS)
    found = np.sqrt((relative**2 - quantum**2).mean())
    assert found == pytest.approx(2000.0 / PHOTONS, rel=4 * np.sqrt(0.5 / 39 / relative.size))


def test_modulated_current_changes_the_noise_and_not_the_mean(plain):
    taken = scan(repeats=12, modulation=(0.6, 0.0))
    assert np.abs(taken.readings.mean(axis=(0, 2, 3)) / plain.readings.mean(axis=(0, 2, 3)) - 1).max() < 0.01
    ratio = (taken.readings.var(axis=0, ddof=1) / plain.readings.var(axis=0, ddof=1)).mean(axis=(1, 2))
    angles = np.arange(VIEWS) * 2 * np.pi / VIEWS
    # Counts divided by a current m have 1 / m of the counts' variance.
    assert np.corrcoef(ratio, np.exp(-0.6 * np.cos(2 * angles)))[0, 1] > 0.95


def test_optical_crosstalk_correlates_neighbors(plain):
    taken = scan(repeats=12, optical_crosstalk=(0.1, 0.05))
    noise = taken.readings - taken.readings.mean(axis=0)
    noise = noise[..., 2:-2]
    found = (noise[..., 1:] * noise[..., :-1]).mean() / (noise**2).mean()
    kernel = np.array([0.1, 0.8, 0.1])
    expected = np.convolve(kernel, kernel)[3] / np.convolve(kernel, kernel)[2]
    assert found == pytest.approx(expected, abs=0.03)


def test_polychromatic_beam_hardens(plain):
    taken = scan(repeats=12, kvp=80.0, aluminium_mm=3.0)
    length, many, one = chords(), lines(taken).mean(axis=0), lines(plain).mean(axis=0)
    ratio = [many[chosen].mean() / one[chosen].mean() for chosen in ((length > 12) & (length < 20), length > 40)]
    assert ratio[1] < ratio[0] * 0.995 and ratio[0] > 1  # softer than 70 keV, less so behind more water


def test_lag_leaves_part_of_the_last_view(plain):
    changed = lines(scan(repeats=12, lag_share=0.3, lag_ms=29.0)).mean(axis=0)[1:] - lines(plain).mean(axis=0)[1:]
    before = np.diff(
        np.exp(-lines(plain).mean(axis=0)), axis=0
    )  # additional signal of the view compared with the previous one
    assert np.polyfit(before.ravel(), changed.ravel(), 1)[0] > 0.02


def test_second_slower_lag_is_the_slow_afterglow():
    """A scan without initial afterglow and with a flash in the middle of every view: XCIST's two exponentials."""
    lag = {"lag_share": 0.05, "lag_ms": 60.0, "slow_lag_share": 0.03, "slow_lag_ms": 500.0}
    rod = ShapesScene([cylinder("water", CENTRE, RADIUS)], KEV)
    geometry = circular(views=VIEWS, view_interval_ms=1000.0 / VIEWS, exposure_ms=1e-6, **DETECTOR)
    order = Scan(views=VIEWS, kev=KEV, photons=1e8, **DETECTOR)
    body = Surfaces((Surface(CYLINDER, "water", tuple(CENTRE), (RADIUS, RADIUS, 1000.0)),), cells_divided=(3, 3))
    plain, glowing = (
        lines(simulate(replace(order, settings=settings), body, 1, np.random.SeedSequence(1)))[0]
        for settings in ({}, lag)
    )
    physics = {
        "afterglow": {"share": 0.05, "time_constant_ms": 60.0, "before": 0.0},
        "slow_afterglow": {"share": 0.03, "time_constant_ms": 500.0, "before": 0.0},
    }
    chain = Chain(rod, geometry, 1e8, samples=3)
    expected = chain.state(physics).line_integrals() - chain.state({}).line_integrals()
    assert np.abs(glowing - plain - expected).max() < 0.02 * np.abs(expected).max()
    without = chain.state({"afterglow": physics["afterglow"]}).line_integrals() - chain.state({}).line_integrals()
    assert np.abs(glowing - plain - without).max() > 0.2 * np.abs(expected).max()


def test_heel_is_the_mean_over_depths_in_tungsten(plain):
    """For depths with a mean of 10 um under an anode of 7 degrees, by numerical integration.

    Above its K edge, tungsten has 11.2 cm2/g at 70 keV (NIST's XCOM), so 21.5 per mm.
    """
    depth, anode = 0.01, np.deg2rad(7)
    taken = scan(heel_depth_mm=depth)
    rows = circular(views=VIEWS, **DETECTOR).row_positions_mm()
    leaving = anode + np.append(np.arctan(rows / DETECTOR["source_to_detector_mm"]), 0.0)
    depths = depth * -np.log1p(-(np.arange(20000) + 0.5) / 20000)
    expected = np.exp(-21.5 * depths / np.sin(leaving)[:, None]).mean(axis=1)
    found = np.log((taken.air / plain.air)[:, 15:25].mean(axis=1))
    np.testing.assert_allclose(found, np.log(expected[:-1] / expected[-1]), rtol=0.06, atol=1e-4)
    assert np.ptp(found) > 0.02


def test_heel_of_the_library_has_the_same_sides(plain):
    """Both signs: the white field along the rows, by the library's equation, with one depth."""
    for random in (np.random.default_rng(seed) for seed in (0, 1)):
        settings, _ = CATALOGUE["heel"].make(0.01, random)
        taken = scan(**settings)
        found = np.log((taken.air / plain.air)[:, 15:25].mean(axis=1))
        chain = Chain(DiscScene(10.0, "water", attenuation("water", [KEV])[0]), circular(views=VIEWS, **DETECTOR))
        anode = Anode(NOMINAL["anode"], NOMINAL["anode_angle_deg"])
        depth = {"depth_um": -1000 * settings["heel_depth_mm"]}
        expected = np.log(chain.state({"heel": depth}, anode=anode).air[0, :, 20])
        assert np.corrcoef(found, expected)[0, 1] > 0.999 and np.ptp(found) > 0.02


def test_off_focal_radiation_comes_from_outside_of_the_spot(plain):
    """All of it: the signal is that of six sources spread along the columns by a Gaussian, averaged over pixels."""
    width = 30.0
    taken = scan(repeats=12, off_focal_share=1.0, off_focal_width_mm=width)
    mu, places = attenuation_per_mm("water", KEV), (np.arange(6) - 2.5) * width / 3
    weights = np.exp(-4 * np.log(2) * (places / width) ** 2)

    def signal(source_mm):
        within = [(u, v) for u in np.linspace(-0.4, 0.4, 5) for v in (-0.25, 0.25)]  # pixels
        rays = [chords(source_mm=source_mm, column_offset_px=u, row_offset_px=v) for u, v in within]
        return np.exp(-mu * np.array(rays)).mean(axis=0)

    expected = sum(w * signal(s) for s, w in zip(places, weights / weights.sum(), strict=True)) - signal(0.0)
    changed = np.exp(-lines(taken).mean(axis=0)) - np.exp(-lines(plain).mean(axis=0))
    there = np.abs(expected) > 0.05
    assert np.corrcoef(changed[there], expected[there])[0, 1] > 0.99
    assert np.polyfit(expected[there], changed[there], 1)[0] == pytest.approx(1.0, abs=0.05)


def test_collimator_hides_off_focal_radiation_from_the_outer_columns(plain):
    """By the library's own equation, with a uniform source of the variance of the simulator's Gaussian."""
    fwhm, collimator = 20.0, 200.0
    taken = scan(off_focal_share=0.2, off_focal_width_mm=fwhm, off_focal_collimator_mm=collimator)
    found = (taken.air / plain.air).mean(axis=0)
    chain = Chain(DiscScene(1e-3, "water", attenuation("water", [KEV])[0]), circular(views=VIEWS, **DETECTOR))
    width = fwhm * np.sqrt(12 / (8 * np.log(2)))
    physics = {"share": 0.2, "width_mm": width, "collimator_mm": collimator}
    expected = chain.state({"off_focal_radiation": physics}).air[0].mean(axis=0)
    assert found[19:21] == pytest.approx(1.0, abs=1e-3) and found[[0, -1]] == pytest.approx(0.9, abs=0.02)
    np.testing.assert_allclose(found, expected, atol=0.03)


def track(angles):
    """Position of the ball's center along the columns, mm."""
    depth = DETECTOR["source_to_isocentre_mm"] + CENTRE[0] * np.sin(angles) - CENTRE[1] * np.cos(angles)
    return (CENTRE[0] * np.cos(angles) + CENTRE[1] * np.sin(angles)) * DETECTOR["source_to_detector_mm"] / depth


def moments(taken):
    """Mean position and variance of the shadow along the columns in every view, mm and mm2."""
    geometry = circular(views=VIEWS, **DETECTOR)
    u = geometry.column_positions_mm()
    seen = np.abs(u - track(geometry.angles_rad)[:, None]) < 60
    shadow = np.where(seen, 1 - np.exp(-lines(taken).mean(axis=0)).mean(axis=1), 0)
    mean = (shadow * u).sum(axis=1) / shadow.sum(axis=1)
    return mean, (shadow * (u - mean[:, None]) ** 2).sum(axis=1) / shadow.sum(axis=1)


def test_rotation_during_a_view_blurs_the_shadow_by_its_path(plain):
    """Its variance grows by the variance of the center's positions over the arc."""
    duty = 0.95
    settings, comparable = CATALOGUE["view_blur"].make(duty, np.random.default_rng(3))
    grown = moments(scan(repeats=12, **settings))[1] - moments(plain)[1]
    geometry = circular(views=VIEWS, **DETECTOR)
    arc = duty * ((np.arange(200) + 0.5) / 200 - 0.5) * 2 * np.pi / VIEWS
    expected = track(geometry.angles_rad + arc[:, None]).var(axis=0)
    assert np.polyfit(expected, grown, 1)[0] == pytest.approx(1.0, abs=0.1) and expected.max() > 6
    state = State(geometry)
    load("view_blur").apply(state, comparable)
    moments_of = np.array(state.turns)
    actual = (moments_of[:, 1] * moments_of[:, 0] ** 2).sum() * (2 * np.pi / VIEWS) ** 2
    assert actual == pytest.approx(arc.var(), rel=1e-4)


def test_spot_jumps_as_in_the_library(plain):
    """A source shifted by s has the shadow of a point at s + (t - s) D / r, r from the source."""
    settings, comparable = CATALOGUE["focal_spot_wobble"].make(6.0, np.random.default_rng(3))
    moved = moments(scan(repeats=12, **settings))[0] - moments(plain)[0]
    state = State(circular(views=VIEWS, **DETECTOR))
    load("focal_spot_wobble").apply(state, comparable)
    angles = state.geometry.angles_rad
    depth = DETECTOR["source_to_isocentre_mm"] + CENTRE[0] * np.sin(angles) - CENTRE[1] * np.cos(angles)
    expected = state.jump_mm[:, 0] * (1 - DETECTOR["source_to_detector_mm"] / depth)
    assert np.ptp(expected) > 9
    np.testing.assert_allclose(moved, expected, atol=0.3)


def test_swinging_object_has_another_position_in_every_view(plain):
    swung = scan(repeats=12, swing_deg=4.0, swing_per_turn=1.0, swing_phase=0.0)
    changed = lines(swung).mean(axis=0) - lines(plain).mean(axis=0)
    turn = np.deg2rad(4.0 * np.sin(2 * np.pi * np.arange(VIEWS) / VIEWS))
    (x, y, z), cosine, sine = CENTRE, np.cos(turn), np.sin(turn)
    centres = np.stack([cosine * x - sine * y, sine * x + cosine * y, np.full(VIEWS, z)], axis=1)
    expected = attenuation_per_mm("water", KEV) * (chords(centres) - chords())
    inside = chords() > 25
    assert np.polyfit(expected[inside], changed[inside], 1)[0] == pytest.approx(1.0, abs=0.15)


def test_focal_spot_blurs_by_its_full_width(plain):
    """A shadow's variance grows by w^2/12 (D - r)^2/r^2 along the columns, r from the source to the ball.

    Three points that share the width evenly would give 8/9 of that.
    """
    width = 20.0
    geometry = circular(views=VIEWS, **DETECTOR)
    u, angles = geometry.column_positions_mm(), geometry.angles_rad
    depth = geometry.source_to_isocentre_mm + CENTRE[0] * np.sin(angles) - CENTRE[1] * np.cos(angles)
    distance = geometry.source_to_detector_mm
    middle = (CENTRE[0] * np.cos(angles) + CENTRE[1] * np.sin(angles)) * distance / depth
    off = u - middle[:, None]
    seen = np.abs(off) < RADIUS * distance / depth.min() + width

    def spread(taken):
        shadow = np.where(seen, 1 - np.exp(-lines(taken).mean(axis=0)).mean(axis=1), 0)
        return (shadow * off**2).sum(axis=1) / shadow.sum(axis=1)

    grown = spread(scan(repeats=12, focal_spot_mm=(width, 0.0))) - spread(plain)
    expected = width**2 / 12 * (distance / depth - 1) ** 2
    assert grown.mean() / expected.mean() == pytest.approx(1.0, abs=0.03)


def test_end_of_a_focal_spot_at_plus_z_is_nearer_as_in_recordings(tmp_path):
    """Positive nominal.anode_angle_deg. XCIST's source is at +y."""
    from gecatsim.pyfiles.SetFocalspot import SetFocalspot

    order = Scan(views=VIEWS, kev=KEV, photons=PHOTONS, settings={"focal_spot_mm": (1.0, 2.0)}, **DETECTOR)
    water = Materials({"water": np.ones((2, 2, 2), np.float32)}, (1.0, 1.0))
    samples = SetFocalspot(_configured(order, water, tmp_path)).src.samples
    nearer = DETECTOR["source_to_isocentre_mm"] - samples[:, 1]
    np.testing.assert_allclose(nearer, samples[:, 2] / np.tan(np.deg2rad(NOMINAL["anode_angle_deg"])), atol=1e-3)
    assert np.ptp(nearer) > 5
