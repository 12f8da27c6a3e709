"""Wide, jumping and rotating sources, and saturating detectors, against closed forms."""

import math

import numpy as np
import pytest
from simulated_scans import noisy_lines

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import circular, helical
from virtual_phantom.physics.beam.materials import attenuation_per_mm
from virtual_phantom.physics.beam.spectra import Anode
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.effect import check_readings, checked, load
from virtual_phantom.physics.scenes.sampling import later_geometry, sources
from virtual_phantom.physics.scenes.scene import DISC_ENERGY_KEV, Pose
from virtual_phantom.physics.scenes.shapes import DiscScene
from virtual_phantom.physics.state import State

RADIUS, DISTANCE, PHOTONS = 500.0, 1000.0, 2e4
SCANNER = {"source_to_isocentre_mm": RADIUS, "source_to_detector_mm": DISTANCE}
GEOMETRY = circular(
    views=24, columns=60, rows=2, column_pitch_mm=6.0, row_pitch_mm=6.0, view_interval_ms=20.0, **SCANNER
)
WATER = attenuation_per_mm("water", [DISC_ENERGY_KEV])[0]


def chain(diameter_mm=160.0, geometry=GEOMETRY, samples=1):
    return Chain(DiscScene(diameter_mm, "water"), geometry, PHOTONS, samples=samples)


def thin(columns=801, views=4):
    return circular(views=views, columns=columns, rows=1, column_pitch_mm=0.25, row_pitch_mm=1.0, **SCANNER)


def saturation(loss=0.0, exponent=1.0):
    return {"detector_saturation": {"loss_per_photon": loss, "exponent": exponent}}


def test_power_of_the_signal_scales_line_integrals_and_their_noise():
    plain, power = chain().state({}), chain().state(saturation(exponent=1.1))
    np.testing.assert_allclose(power.line_integrals(), 1.1 * plain.line_integrals(), rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(power.variance(), 1.21 * plain.variance())
    np.testing.assert_allclose(power.log_noise()[0], 1.1 * plain.log_noise()[0], rtol=5e-3)


def test_saturation_equals_that_of_a_dead_time():
    """If each of n events per interval blocks the counter for the share t, n / (1 + n t) are counted."""
    loss = 0.2 / PHOTONS
    plain, less = chain().state({}), chain().state(saturation(loss))
    arriving = plain.signal * PHOTONS
    np.testing.assert_allclose(less.measured * PHOTONS, arriving / (1 + loss * arriving))
    np.testing.assert_allclose(less.measured_air, 1 / 1.2)
    # Behind the thickest part almost nothing is lost, in air a sixth.
    np.testing.assert_allclose(
        plain.line_integrals() - less.line_integrals(), np.log(1.2 / (1 + 0.2 * plain.signal)), atol=1e-12
    )


@pytest.mark.parametrize("beside", [{}, {"dark_signal": {"level_units": 300.0, "drift_units_per_s": 0.0}}])
@pytest.mark.parametrize(("loss", "exponent"), [(0.3 / PHOTONS, 1.0), (0.0, 1.2), (0.2 / PHOTONS, 0.8)])
def test_noise_after_a_response_follows_its_slope(loss, exponent, beside):
    physics = saturation(loss, exponent) | {"electronic_noise": {"photons": 60.0}} | beside
    state = chain().state(physics)
    scans = noisy_lines(state, 60, np.random.default_rng(3))
    above, variance = state.log_noise()
    assert (scans.var(axis=0, ddof=1) / variance).mean() == pytest.approx(1, abs=4 * math.sqrt(2 / 59 / variance.size))
    found = (scans.mean(axis=0) - state.line_integrals() - above) / np.sqrt(variance / 60)
    assert abs(found.mean()) < 4 / math.sqrt(found.size)


def test_mean_of_the_logarithm_scales_with_the_exponent():
    """With few counts, where the difference is visible:

    n of 100 to the power 1.3 has 1.3 times the mean of its logarithm.
    """
    one = np.ones((1, 1, 1))
    state = State(GEOMETRY, photons=100.0, signal=one, air=one, response=(1.3, 0.0))
    drawn = np.random.default_rng(1).poisson(100.0, 1_000_000)
    lines = -1.3 * np.log(np.maximum(drawn, 0.5) / 100.0)
    above, variance = (float(one[0, 0, 0]) for one in state.log_noise())
    assert above == pytest.approx(lines.mean(), rel=0.02) and variance == pytest.approx(lines.var(), rel=0.01)


def test_loss_depends_on_photons_and_a_scan_shows_a_share():
    small, large = (
        Chain(DiscScene(160.0, "water"), GEOMETRY, photons).parameters("detector_saturation")[0]
        for photons in (1e4, 1e6)
    )
    assert small.high == pytest.approx(100 * large.high) and small.high == pytest.approx(0.5 / 1e4)
    with pytest.raises(InputError, match=r"loss_per_photon: 1e-05 times the 1e\+06 photons that dose has in air is 10"):
        check_readings(checked(saturation(1e-5)), 1e6, "physics", "dose")


@pytest.mark.parametrize(
    "geometry",
    [
        GEOMETRY,
        helical(
            views=40,
            turns=2.0,
            volume_height_mm=30.0,
            columns=60,
            rows=2,
            column_pitch_mm=6.0,
            row_pitch_mm=6.0,
            **SCANNER,
        ),
    ],
)
def test_rotation_during_a_view_averages_transmissions(geometry):
    """Over 400 time points, spread evenly. The mean of line integrals differs ten times as much."""
    where, duty = Pose(x_mm=40.0, y_mm=-25.0), 0.9
    found = chain(70.0, geometry).state({"view_blur": {"duty": duty}}, where).line_integrals()
    moments = duty * ((np.arange(400) + 0.5) / 400 - 0.5)
    each = np.array(
        [chain(70.0, later_geometry(geometry, moment)).state({}, where).line_integrals() for moment in moments]
    )
    right, wrong = -np.log(np.exp(-each).mean(axis=0)), each.mean(axis=0)
    error = np.abs(found - right)
    assert error.max() < 0.15 * right.max() and error.mean() < 0.1 * np.abs(wrong - right).mean() + 2e-3
    np.testing.assert_allclose((1 - np.exp(-found)).sum(axis=2), (1 - np.exp(-right)).sum(axis=2), rtol=5e-3)


def test_off_axis_wire_is_blurred_by_its_path():
    """The shadow of an object that rotates at a distance r moves by r db D/R to first order.

    Its variance grows by the square of that over 12.

    Nothing moves on the axis.
    """
    geometry, arc = thin(views=60), 2 * math.pi / 60
    u = geometry.column_positions_mm()

    def spread(physics, where):
        shadow = 1 - chain(3.0, geometry).state(physics, where).signal[0, 0]
        return (shadow * u**2).sum() / shadow.sum() - ((shadow * u).sum() / shadow.sum()) ** 2

    blur, along_the_beam = {"view_blur": {"duty": 1.0}}, Pose(y_mm=30.0)
    grown = spread(blur, along_the_beam) - spread({}, along_the_beam)
    assert grown == pytest.approx((30.0 * arc * DISTANCE / (RADIUS - 30.0)) ** 2 / 12, rel=0.02)
    assert abs(spread(blur, Pose()) - spread({}, Pose())) < 1e-9


def test_excluded_views_do_not_change_the_rotation_per_view():
    whole = circular(views=48, columns=60, rows=2, column_pitch_mm=6.0, row_pitch_mm=6.0, **SCANNER)
    physics, where = {"view_blur": {"duty": 0.8}}, Pose(x_mm=30.0)
    few, every = (chain(70.0, one).state(physics, where).line_integrals() for one in (whole.every(3), whole))
    np.testing.assert_allclose(few, every[::3], atol=1e-12)


def test_jumping_spot_moves_every_second_shadow():
    """A source shifted by s has the shadow of a wire at s + (t - s) D / (R - depth)."""
    geometry = thin()
    u = geometry.column_positions_mm()
    jump = {"focal_spot_wobble": {"columns_mm": 3.0, "rows_mm": 0.0}}
    shadow = 1 - chain(3.0, geometry).state(jump, Pose(10, 20)).signal[:, 0]
    found = (shadow * u).sum(axis=1) / shadow.sum(axis=1)
    # source at +y, -x, -y, +x; columns along +x, +y, -x, -y
    places, sides = ((10, 20), (20, -10), (-10, -20), (-20, 10)), (-1.5, 1.5, -1.5, 1.5)
    right = [s + (t - s) * DISTANCE / (RADIUS - depth) for (t, depth), s in zip(places, sides, strict=True)]
    np.testing.assert_allclose(found, right, atol=0.02)
    other = chain(3.0, geometry.every(2)).state(jump, Pose(10, 20)).jump_mm
    np.testing.assert_allclose(other[:, 0], -1.5)  # in every second view the spot is on one side


def test_jump_along_z_follows_the_anode_and_adds_to_a_focal_spot():
    geometry, angle = thin(), 10.0
    state = State(geometry, anode=Anode("W", angle))
    for name, values in (
        ("focal_spot", {"width_mm": 1.0, "length_mm": 0.0}),
        ("focal_spot_wobble", {"columns_mm": 0.0, "rows_mm": 2.0}),
    ):
        load(name).apply(state, values)
    (first, _), *_, (last, _) = sources(state)
    moved = (first.source_mm + last.source_mm) / 2 - geometry.source_mm
    depth = 1.0 / math.tan(math.radians(angle))
    np.testing.assert_allclose(moved[:, 2], [-1, 1, -1, 1], atol=1e-9)
    away = -(moved * geometry.normal).sum(axis=1)
    np.testing.assert_allclose(away, [depth, -depth, depth, -depth], atol=1e-9)


def off_focal(share, width=40.0, collimator=200.0):
    return {"off_focal_radiation": {"share": share, "width_mm": width, "collimator_mm": collimator}}


def test_collimator_hides_half_of_the_anode_from_the_outermost_pixels():
    """It hides nothing from the central pixels. In between, light of a uniform source falls linearly with position."""
    fine = circular(views=2, columns=721, rows=1, column_pitch_mm=0.5, row_pitch_mm=1.0, **SCANNER)
    air = chain(2.0, fine).state(off_focal(0.1)).air[0, 0]
    assert air[360] == pytest.approx(1.0) and air[[0, -1]] == pytest.approx(0.95, abs=0.015)
    np.testing.assert_allclose(air, air[::-1])
    # The penumbra extends inwards by half of the anode projected through the collimator: 20 mm by 800 / 200.
    reach = np.abs(fine.column_positions_mm())[air < 1 - 1e-6].min()
    assert reach == pytest.approx(180.25 - 20 * 4, abs=8.0)  # points of the anode are 5 mm apart
    assert chain(2.0, fine).state(off_focal(0.1, 40.0, 400.0)).air[0, 0].mean() > air.mean()


def test_off_focal_radiation_equals_that_of_a_wide_source():
    """Behind a cylinder, by 2001 points and chords in closed form; the collimator hides nothing."""
    share, width, radius = 0.1, 30.0, 80.0
    wide = circular(views=1, columns=120, rows=1, column_pitch_mm=6.0, row_pitch_mm=6.0, **SCANNER)
    found = chain(2 * radius, wide).state(off_focal(share, width, 400.0)).signal[0, 0]
    u = wide.column_positions_mm()

    def through(x):
        """Chords of rays from (x, R) to (u, R - D): the axis is at the origin."""
        off = np.abs(x * DISTANCE + (u - x) * RADIUS) / np.hypot(u - x, DISTANCE)
        return np.exp(-WATER * 2 * np.sqrt(np.maximum(radius**2 - off**2, 0)))

    anode = np.linspace(-width / 2, width / 2, 2001)
    right = (1 - share) * through(0.0) + share * np.mean([through(x) for x in anode], axis=0)
    inside = np.abs(u) < 240  # where the collimator hides no part of the anode
    np.testing.assert_allclose(found[inside], right[inside], atol=0.05 * share)
    assert np.abs(through(0.0) - right)[inside].max() > 0.2 * share
    # A uniform field stays uniform where all of the anode is visible.
    np.testing.assert_allclose(chain(1e-3, wide).state(off_focal(share, width, 400.0)).air[0, 0, inside], 1.0)


def test_focal_spot_has_the_same_width_with_off_focal_radiation():
    both = {**off_focal(0.1), "focal_spot": {"width_mm": 2.0, "length_mm": 0.0}}
    state = chain().state(both)
    weights = [np.max(weight) for *_, weight in state.sources]
    narrow = [place for (place, *_), weight in zip(state.sources, weights, strict=True) if abs(place) < 1.1]
    assert sum(weights) == pytest.approx(1.0) and max(narrow) == pytest.approx(math.sqrt(0.6), rel=1e-6)


def test_collimator_is_not_fitted():
    known = chain().fixed_parameters("off_focal_radiation")
    assert known == {"collimator_mm": 200.0}
    assert [parameter.name for parameter in chain().parameters("off_focal_radiation")] == ["share", "width_mm"]
