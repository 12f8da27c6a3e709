"""Faults for which the library has no effect, against closed forms and conservation laws."""

import numpy as np
import pytest

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.base.proof_settings import ProofScan, ProofSettings
from virtual_phantom.base.settings import from_mapping
from virtual_phantom.physics.effect import load, names
from virtual_phantom.proof.hiding.catalogue import CATALOGUE
from virtual_phantom.proof.hiding.changed_object import changed
from virtual_phantom.proof.hiding.faults import charge_shared, chosen, displaced_tile, faulty, refracted, warmed
from virtual_phantom.proof.hiding.missing_effects import MISSING_EFFECTS
from virtual_phantom.proof.hiding.objects import Part, ScannedObject
from virtual_phantom.proof.hiding.orbits import orbit_of
from virtual_phantom.proof.hiding.suite import truths
from virtual_phantom.proof.hiding.unsteady import breathed, jittered, settling, swung, triangle_wave, turned
from virtual_phantom.proof.hiding.voxels import stated_hu
from virtual_phantom.proof.hiding.xcist import Acquired, Scan
from virtual_phantom.recordings.scan import scan_geometry

VIEWS, COLUMNS, KEV = 40, 30, 70.0
PROTOCOL = ProofScan(36, 1e5, 1000.0, 4, columns=64, rows=6)


def order(**settings):
    return Scan(VIEWS, COLUMNS, 4, 2.0, 2.0, 500.0, 900.0, kev=KEV, photons=1e5, settings=settings)


@pytest.fixture
def taken():
    random = np.random.default_rng(1)
    readings = KEV * random.poisson(800.0, (3, VIEWS, 4, COLUMNS))
    return Acquired(readings.astype(np.float32), np.full((4, COLUMNS), 1000 * KEV, np.float32))


def read(taken, **settings):
    return faulty(taken, order(**settings), np.random.default_rng(2))


def test_no_fault_changes_nothing(taken):
    found = read(taken)
    assert np.array_equal(found.readings, taken.readings) and np.array_equal(found.air, taken.air)


def test_ten_kinds_or_more_have_a_correct_verdict_and_no_effect_of_their_name():
    assert len(MISSING_EFFECTS) >= 10 and not set(MISSING_EFFECTS) & set(names())
    for name, one in MISSING_EFFECTS.items():
        assert not one.known and "left" in one.right, name
        for effect in {effect for group in one.equals for effect in group}:
            assert load(effect) and effect.replace("_", " ").split()[-1] in one.right
        sizes = one.ranges
        assert all(low < high for low, high in sizes) and sizes[0][1] <= sizes[1][0] < sizes[1][1] <= sizes[2][0]
        assert one.draw("medium", np.random.default_rng(1)) == one.draw("medium", np.random.default_rng(1))
        assert CATALOGUE[name] is one


def test_dim_view_has_a_line_integral_that_is_higher_by_a_logarithm(taken):
    found = read(taken, dim_share=0.1, dim_views=0.1, dim_seed=5)
    shift = -np.log(found.readings / taken.readings).mean(axis=(0, 2, 3))
    dim = chosen(VIEWS, 0.1, 5)
    assert len(dim) == 4 and 0 not in dim
    np.testing.assert_allclose(shift[dim], -np.log(0.9), rtol=1e-5)
    assert np.array_equal(np.delete(found.readings, dim, axis=1), np.delete(taken.readings, dim, axis=1))


def test_lost_view_repeats_the_previous_one(taken):
    found = read(taken, lost_views=0.1, lost_seed=8)
    lost = chosen(VIEWS, 0.1, 8)
    np.testing.assert_array_equal(found.readings[:, lost], found.readings[:, lost - 1])
    stored = np.setdiff1d(np.arange(VIEWS), lost)
    np.testing.assert_array_equal(found.readings[:, stored], taken.readings[:, stored])


def test_warming_detector_approaches_a_limit_and_keeps_the_mean_of_a_view():
    gain = warmed(1000, COLUMNS, 0.02, 0.3)
    np.testing.assert_allclose(gain.mean(axis=1), 1.0)
    # After the time constant, 1 - 1/e is reached.
    assert gain[300, -1] - 1 == pytest.approx(0.02 * (1 - np.exp(-1)), rel=2e-3)
    np.testing.assert_allclose(gain[:, 0] - 1, 1 - gain[:, -1])


def test_charge_sharing_keeps_the_mean_of_a_uniform_field_and_correlates_neighbors():
    """A share c of Poisson counts n is also counted in a neighbor: variance n (1 + c), covariance of neighbors n c."""
    share, random = 0.3, np.random.default_rng(3)
    counts = random.poisson(500.0, (400, 60)) * KEV
    found = charge_shared(counts, share, KEV, random)
    even = Acquired(counts[None, :, None].astype(np.float32), np.full((1, 60), 500 * KEV, np.float32))
    lines = faulty(even, order(charge_share=share), np.random.default_rng(4))
    # Relative to the air scan, edges included, a uniform field stays uniform.
    ratio = (lines.readings / lines.air)[0, :, 0].mean(axis=0)
    assert np.abs(ratio - 1).max() < 5 / np.sqrt(400 * 500)
    inner = found[:, 1:-1] / KEV
    assert inner.mean() == pytest.approx(500 * (1 + share), rel=2e-3)
    noise = inner - inner.mean(axis=0)
    assert (noise**2).mean() == pytest.approx(500 * (1 + share), rel=0.05)
    correlation = (noise[:, 1:] * noise[:, :-1]).mean() / (noise**2).mean()
    assert correlation == pytest.approx(share / (1 + share), abs=0.03)
    assert abs((noise[:, 2:] * noise[:, :-2]).mean() / (noise**2).mean()) < 0.03


def test_refraction_conserves_photons_and_sharpens_an_edge():
    photons = np.random.default_rng(1).uniform(10, 1000, (20, 6, 2))
    found = refracted(photons, 0.05)
    np.testing.assert_allclose(found.sum(axis=(0, 1)), photons.sum(axis=(0, 1)))
    # The Laplacian of x^2 is 2: means decrease by 2 k inside.
    square = np.broadcast_to((np.arange(20.0) ** 2)[:, None, None], (20, 6, 1))
    np.testing.assert_allclose((refracted(square, 0.05) - square)[1:-1], -0.1)
    edge = np.where(np.arange(20) < 10, 100.0, 1000.0)[:, None, None] * np.ones((1, 6, 1))
    there = refracted(edge, 0.05)
    assert there[9, 0, 0] < 100 and there[10, 0, 0] > 1000


def test_displaced_tile_sees_the_neighboring_position():
    slope = np.arange(40.0)[:, None] * [1.0, 2.0]
    found = displaced_tile(slope, 0.25, 0.5, 0.6)
    np.testing.assert_allclose((found - slope)[10:20], 0.6 * np.ones((10, 1)) * [1.0, 2.0])
    assert np.array_equal(found[:10], slope[:10]) and np.array_equal(found[20:], slope[20:])


def test_breathing_and_swinging_are_periodic():
    settings = {"breathing_mm": (1.0, -2.0, 0.5), "breathing_per_turn": 4.0, "breathing_phase": 0.3}
    np.testing.assert_allclose(breathed(0.1, settings), breathed(0.1 + 0.25, settings))
    many = np.array([breathed(turn, settings) for turn in np.arange(400) / 400])
    np.testing.assert_allclose(many.mean(axis=0), 0, atol=1e-12)
    np.testing.assert_allclose((many**2).mean(axis=0), np.square((1.0, -2.0, 0.5)) / 2)
    swing = {"swing_deg": 2.0, "swing_per_turn": 1.0, "swing_phase": 0.0}
    assert swung(0.25, swing) == pytest.approx(2.0) and swung(0.5, swing) == pytest.approx(0, abs=1e-12)


def test_settling_starts_fast_and_has_a_mean_of_zero():
    time = np.arange(2000) / 2000 + 1 / 4000
    many = np.array([settling(one) for one in time])
    assert abs(many.mean()) < 1e-6 and settling(1.0) - settling(0.0) == pytest.approx(1.0)
    speed = np.diff(many)
    np.testing.assert_allclose(speed[1:] / speed[:-1], np.exp(-1 / 2000), rtol=1e-6)


def test_fundamental_of_the_triangle_wave_has_the_stated_amplitudes():
    turns = np.arange(720) / 720
    wave = np.array([triangle_wave(turn, (0.3, -0.4)) for turn in turns])
    found = [2 * (wave * np.cos(2 * np.pi * turns)).mean(), 2 * (wave * np.sin(2 * np.pi * turns)).mean()]
    assert found == pytest.approx([0.3, -0.4], abs=1e-4) and np.abs(np.diff(wave)).std() < 1e-3


def test_jitter_is_white_and_reproducible():
    settings = {"jitter_deg": 0.5, "jitter_seed": 7}
    many = np.array([jittered(view, settings) for view in range(400)])
    assert many.std() == pytest.approx(0.5, rel=0.1) and abs(np.corrcoef(many[1:], many[:-1])[0, 1]) < 0.15
    assert many[3] == jittered(3, settings)


def test_rotation_goes_from_x_to_y():
    np.testing.assert_allclose(turned(np.array([[1.0, 0, 0], [0, 1.0, 0]]), 90.0), [[0, 1, 0], [-1, 0, 0]], atol=1e-12)


BODY = ScannedObject(
    "body",
    (
        Part("body", (0, 0, 0), (70, 50, np.inf), hu=40.0),
        Part("gas", (30, 0, 0), (8, 8, np.inf), material="air"),
        Part("bone", (-30, 0, 0), (8, 8, np.inf), hu=600.0),
    ),
)
GRID = Grid((4, 75, 100), (2.0, 2.0, 2.0))


def added_mm2(found):
    """Additional area in every slice, where the added part has one CT number."""
    return (stated_hu(found, GRID) - stated_hu(BODY, GRID)).sum(axis=(1, 2)) * 4 / (found.outside[0].hu + 1000)


def test_table_is_below_the_body():
    found = changed(BODY, {"table_mm": 7.0, "table_hu": -100.0})
    np.testing.assert_allclose(added_mm2(found), np.pi * 3.5 * 56, rtol=0.03)
    low, high = found.outside[0].shape.bounds_mm()
    assert high[1] == pytest.approx(-53) and low[1] == pytest.approx(-60) and found.parts == BODY.parts


def test_arm_is_outside_of_the_field_of_view_of_all_views():
    found = changed(BODY, {"arm_radius_mm": 12.0, "arm_side": -1.0, "arm_height_mm": 5.0})
    orbit = orbit_of("flat", BODY, PROTOCOL, PROTOCOL, 0.0)
    seen = scan_geometry(orbit.recorded(1000.0), "orbit").field_of_view_radius_mm
    assert found.outside[0].shape.bounds_mm()[1][0] < -seen


def test_insert_changes_one_part_that_is_not_air():
    chosen = [changed(BODY, {"insert_hu": 100.0, "insert": share}) for share in (0.1, 0.9)]
    assert all(one.parts[2].density == pytest.approx(1.1) and one.parts[:2] == BODY.parts[:2] for one in chosen)
    assert changed(BODY, {"insert_hu": -5000.0, "insert": 0.1}).parts[2].density > 0 and changed(BODY, {}) is BODY


SUITE = {
    "seed": 3,
    "simulators": ["xcist"],
    "declared": 0,
    "effects": ["scatter"],
    "strengths": [],
    "none": 0,
    "pairs": 0,
    "unknown": 2 * len(MISSING_EFFECTS),
    "images": {"strengths": [], "effects": [], "tried": ["scatter"], "views_times": 2},
    "scan": {"views": 36, "rows": 4},
    "held_out_protocol": {"views": 30},
}


def section(settings):
    return from_mapping(ProofSettings, settings)


def test_all_kinds_are_equally_frequent_and_their_correct_verdict_is_sealed():
    drawn = [truth["effects"][0] for truth in truths(section(SUITE)).values()]
    counted = [one["name"] for one in drawn]
    assert {counted.count(name) for name in MISSING_EFFECTS} == {2}
    assert all(one["right"] == MISSING_EFFECTS[one["name"]].right and not one["known"] for one in drawn)
    other = [truth["effects"][0]["name"] for truth in truths(section(SUITE | {"seed": 4, "unknown": 5})).values()]
    assert len(set(other)) == 5
    few = truths(section(SUITE | {"unknown_kinds": ["dim_views"], "unknown": 3}))
    assert {truth["effects"][0]["name"] for truth in few.values()} == {"dim_views"}
    with pytest.raises(InputError, match="proof.unknown_kinds: there is no 'dimviews'; use some of periodic_motion"):
        truths(section(SUITE | {"unknown_kinds": ["dimviews"]}))
