"""Local object mismatch: detected, reported before physics, and corrected on request."""

from dataclasses import replace
from functools import cache

import jsonschema
import numpy as np
import pytest
from simulated_scans import scans_of

from virtual_phantom.base.geometry import Grid, circular, helical
from virtual_phantom.diagnosis.fitting.linearization import LinearizationPoint
from virtual_phantom.diagnosis.fitting.nuisance import Nuisance
from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.projections import local_mismatch as piece_module
from virtual_phantom.diagnosis.projections import prepared
from virtual_phantom.diagnosis.projections.discretization import model_and_floor
from virtual_phantom.diagnosis.projections.local_mismatch import FitResidual, Piece, best_piece, object_radius_mm
from virtual_phantom.diagnosis.run import find_missing_physics
from virtual_phantom.diagnosis.verdict.object_mismatch import excess, explains_all
from virtual_phantom.diagnosis.verdict.unmodeled import changes
from virtual_phantom.figures.diagnosis import draw_pieces
from virtual_phantom.io import documents
from virtual_phantom.io.schema import defaults_of
from virtual_phantom.io.volumes import Volume
from virtual_phantom.physics.beam.materials import attenuation_per_mm
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.effect import checked
from virtual_phantom.physics.scenes.inclusion import Inclusion
from virtual_phantom.physics.scenes.scene import Pose
from virtual_phantom.physics.scenes.shapes import ShapesScene, ellipsoid

PHOTONS = 1e5
SCHEMA = documents.schema_of_kind("diagnosis")
SCAN = dict(
    source_to_isocentre_mm=570.0,
    source_to_detector_mm=1040.0,
    columns=48,
    rows=8,
    column_pitch_mm=9.0,
    row_pitch_mm=9.0,
    view_interval_ms=10.0,
)
GEOMETRY = circular(views=24, **SCAN | {"columns": 40, "rows": 6, "row_pitch_mm": 12.0})
BODY = ellipsoid("soft_tissue", (0, 0, 0), (90, 70, 1000))
FAT = ellipsoid("adipose", (-35, -20, -3), (15, 15, 15))
TRIED = ("scatter", "dark_signal", "detector_offset", "spectrum", "focal_spot")


def shapes_scene(*more):
    return ShapesScene([BODY, *more])


def ready(scanned, physics=None, stated=(FAT,), photons=PHOTONS):
    """Scan of these shapes, prepared with the stated object."""
    state = Chain(shapes_scene(*scanned), GEOMETRY, photons, samples=3).state(checked(physics or {}))
    taken = scans_of(state, 4, np.random.default_rng(1))
    model, floor = model_and_floor(shapes_scene(*stated), GEOMETRY, 2, photons=photons)
    return prepared.prepare(taken, None, model, floor_chain=floor, nominal_photons=photons)


def report(scanned, physics=None, differ=False, tried=TRIED):
    """Text of the report on the object."""
    prepared_data, accuracy = ready(scanned, physics), defaults_of("diagnosis", "model_accuracy")
    content = find_missing_physics("bench", prepared_data, tried, accuracy, object_may_differ=differ).content
    jsonschema.validate(content, SCHEMA)
    return content


def differing_by(one, fit, accuracy=0.0):
    """The local mismatch among the kinds of change of a fit."""
    return next(change for change in changes(one, fit, accuracy) if change.mismatch is not None)


def data_count(fitter):
    """Number of fitted data, all parts."""
    return sum((weight > 0).sum() for weight in fitter.weights)


missing = cache(lambda differ=False: report((), differ=differ))


@pytest.mark.parametrize(
    ("geometry", "piece"),
    [
        (GEOMETRY, Piece((30.0, 10.0, 6.0), 9.0, False, 0.004)),
        (GEOMETRY, Piece((-20.0, 40.0, 0.0), 6.0, True, -0.003)),
        (
            circular(views=36, surface="cylindrical", arc_radius_mm=1040.0, **SCAN),
            Piece((30.0, 10.0, 6.0), 9.0, False, 0.004),
        ),
        (
            helical(views=72, volume_height_mm=40.0, turns=2.0, pitch=0.8, **SCAN),
            Piece((10.0, -40.0, 12.0), 10.0, False, -0.01),
        ),
        (circular(views=60, **SCAN | {"rows": 1}), Piece((-20.0, 40.0, 0.0), 6.0, True, -0.003)),
    ],
)
def test_mismatch_is_found_in_its_own_projections(geometry, piece):
    residual = piece.more_per_mm * piece.lengths_mm(geometry)
    one = best_piece(FitResidual(residual, np.full(residual.shape, 1e5), geometry, 90.0))
    assert one.more_per_mm == pytest.approx(piece.more_per_mm, rel=0.15)
    assert one.radius_mm == pytest.approx(piece.radius_mm, rel=0.1)
    axes = 2 if one.rod or piece.rod else 3
    np.testing.assert_allclose(one.place_mm[:axes], piece.place_mm[:axes], atol=1.0)


def test_location_and_radius_come_from_some_views_of_a_large_scan(monkeypatch):
    """Views must be used by the fit: every second one is not if the others are held out."""
    monkeypatch.setattr(piece_module, "MOST_RAYS", 10_000)
    geometry = circular(views=144, **SCAN)
    truth = Piece((30.0, 10.0, 6.0), 9.0, False, 0.004)
    moved = np.linspace(0, 5, 144)[:, None] * [1.0, 0.0, 0.0]
    seen_from = replace(geometry, column_offset_px=geometry.column_offset_px + 0.5)
    lengths = truth.lengths_mm(seen_from, samples=2, motion_mm=moved)
    weight = np.full(lengths.shape, 1e5) * (np.arange(144) % 2)[:, None, None]
    left = FitResidual(
        truth.more_per_mm * lengths, weight, geometry, 90.0, samples=2, seen_from=seen_from, motion_mm=moved
    )
    one = best_piece(left)
    np.testing.assert_allclose(one.place_mm, truth.place_mm, atol=0.1)
    assert one.more_per_mm == pytest.approx(truth.more_per_mm, rel=0.05)


def test_extent_of_the_object_follows_from_attenuation():
    lines = ShapesScene([BODY]).path_lengths(GEOMETRY)[0] * 0.02
    pixel_mm = 9.0 * 570 / 1040
    assert abs(object_radius_mm(lines, GEOMETRY) - 90.0) < 1.5 * pixel_mm
    assert object_radius_mm(np.ones(GEOMETRY.shape), GEOMETRY) == pytest.approx(19.5 * pixel_mm)  # cut off


def test_path_lengths_of_a_ball_are_its_chords():
    """The central ray through the middle equals the diameter; the sum of all rays is the volume."""
    lengths = Piece((0.0, 0.0, 0.0), 20.0, False).lengths_mm(circular(views=4, **SCAN | {"columns": 49, "rows": 9}))
    np.testing.assert_allclose(lengths[:, 4, 24], 40.0, rtol=1e-5)
    pixel_mm2 = (9.0 * 570 / 1040) ** 2
    assert lengths.sum() / 4 * pixel_mm2 == pytest.approx(4 / 3 * np.pi * 20**3, rel=0.05)


def test_path_lengths_of_a_mismatch_are_pixel_means():
    """Single rays at the edge of a ball are poor samples; means of 8 x 8 rays agree with those of many."""
    piece = Piece((40.0, 0.0, 0.0), 6.0, False)
    one, eight, many = (piece.lengths_mm(GEOMETRY, samples=count) for count in (1, 8, 24))
    seen = many > 0
    assert np.abs(eight - many)[seen].max() < 0.1 < 1 < np.abs(one - many)[seen].max()


def test_rays_of_a_turned_detector_are_not_searched():
    turned = Chain(shapes_scene(), GEOMETRY).state({"detector_roll": {"angle_deg": 1.0}}).mounting.of(GEOMETRY)
    assert best_piece(FitResidual(np.ones(GEOMETRY.shape), np.ones(GEOMETRY.shape), turned, 90.0)) is None


def test_hu_refer_to_water():
    kev = 60.0
    water = float(attenuation_per_mm("water", [kev])[0])
    piece = Piece((1.0, 2.0, 3.0), 4.0, False, -0.1 * water)
    assert piece.more_hu(kev) == pytest.approx(-100)
    assert piece.words(kev) == (
        "is like a ball in the object, 8 mm wide at x 1, y 2, z 3 mm, that has 100 HU less than stated"
    )
    assert "a rod along z in the object" in Piece((1.0, 2.0, 3.0), 4.0, True).words(kev)
    assert Piece((1.0, 2.0, 3.0), 4.0, True).content(kev)["z_mm"] is None


def test_missing_insert_is_reported_as_object_and_not_as_physics():
    content = missing()
    assert content["verdict"] == "unexplained" and not content["effects"]
    (piece,) = content["object"]["pieces"]
    assert not content["object"]["corrected"] and content["object"]["removes"] > 0.95
    place = piece["x_mm"], piece["y_mm"], piece["z_mm"]
    np.testing.assert_allclose(place, (-35, -20, -3), atol=1.5)
    assert piece["width_mm"] == pytest.approx(30, abs=3)
    fat, muscle, water = (float(attenuation_per_mm(one, [60.0])[0]) for one in ("adipose", "soft_tissue", "water"))
    assert piece["hu"] == pytest.approx(1000 * (muscle - fat) / water, rel=0.15)
    assert content["verdict_lines"][0].startswith("Local object mismatch: ") and " mm ball at x " in content["sentence"]
    assert "rotated by 90 degrees" in content["next_measurement"][0]


def test_missing_large_insert_explains_all(monkeypatch):
    """A bone insert shifts the pose, size and density of the object, and is found with fits of the corrected object."""
    bone = ellipsoid("bone", (40, 10, 5), (15, 15, 15))
    prepared_data = ready((FAT,), stated=(FAT, bone))
    baseline = trial(prepared_data.fitter, ())
    piece = differing_by(prepared_data, baseline.fit)
    assert baseline.fit.chi_square > 1e6
    mended = prepared_data.with_mismatch(piece.mismatch, baseline.fit)
    monkeypatch.setattr(type(prepared_data), "with_mismatch", lambda *_: mended)  # it takes seconds
    assert explains_all(piece, prepared_data, baseline.fit)
    fit = mended.fitter.fit(())
    assert fit.chi_square < data_count(mended.fitter) * 1.01
    (found_at,) = (piece.content for piece in mended.mismatches(fit))
    np.testing.assert_allclose([found_at[name] for name in ("x_mm", "y_mm", "z_mm")], (40, 10, 5), atol=0.2)
    assert found_at["width_mm"] == pytest.approx(30, abs=0.3)


def test_object_is_corrected_on_request():
    content = missing(True)
    assert content["verdict"] == "match" and content["object"]["corrected"]
    assert "Object corrected before the fit: " in content["sentence"] and " mm ball at x " in content["sentence"]
    low, high = content["alignment"]["piece_1"]["ci95"]
    assert 0 < low < high


def test_physics_is_named_with_a_corrected_object():
    physics = {"dark_signal": {"level_units": 1500.0}}
    content = report((), physics, True, [name for name in TRIED if name != "focal_spot"])  # its fits take seconds
    assert [effect["name"] for effect in content["effects"]] == ["dark_signal"], content["sentence"]
    low, high = content["effects"][0]["parameters"]["level_units"]["ci95"]
    assert low - (high - low) < 1500 < high + (high - low)
    assert len(content["object"]["pieces"]) == 1


def test_mismatch_wider_than_allowed_is_not_corrected():
    assert not report((), differ=10.0)["object"]["corrected"]


@pytest.mark.parametrize("physics", [{"scatter": {}}, {"spectrum": {}}, {"dark_signal": {"level_units": 1500.0}}])
def test_physics_is_not_reported_as_object(physics):
    content = report((FAT,), physics)
    assert "object" not in content and content["effects"][0]["name"] in physics, content["sentence"]


def test_added_shape_attenuates():
    """The same as in the scene: a ball of the body's material in air next to it."""
    ball = ellipsoid("soft_tissue", (0, 110, 0), (8, 8, 8))
    with_ball = Chain(ShapesScene([BODY, ball]), GEOMETRY, PHOTONS).state({})
    mu = float(attenuation_per_mm("soft_tissue", [ShapesScene([BODY]).energy_kev])[0])
    added = Chain(ShapesScene([BODY]), GEOMETRY, PHOTONS).state({}, added=((Inclusion(ball, "ball"), mu),))
    np.testing.assert_allclose(added.line_integrals(), with_ball.line_integrals(), atol=1e-5)


def test_added_shape_moves_with_the_object_and_is_seen_by_all_rays():
    """The scene without an insert equals the scene with it and a negative shape: rotated, shifted and in motion."""
    chain, bare = (Chain(shapes_scene(*more), GEOMETRY, PHOTONS, samples=3) for more in ((FAT,), ()))
    fat, tissue = (float(attenuation_per_mm(one, [chain.scene.energy_kev])[0]) for one in ("adipose", "soft_tissue"))
    pose = Pose(x_mm=3.0, y_mm=-2.0, z_mm=4.0, turn_deg=30.0, size=1.02)
    physics = checked({"motion": {"x_mm_per_s": 20.0}, "detector_offset": {"columns_px": 1.5}})
    mended = chain.state(physics, pose, added=((Inclusion(FAT, "fat"), tissue - fat),))
    here, there = mended.line_integrals(), bare.state(physics, pose).line_integrals()
    np.testing.assert_allclose(here, there, atol=1e-5)
    assert np.abs(chain.state(physics, pose).line_integrals() - there).max() > 0.01


def test_discretization_errors_belong_to_the_corrected_object(monkeypatch):
    monkeypatch.setattr(ShapesScene, "edge_scans", lambda *_: ())  # otherwise these errors are too small to compare
    model = ready((), {}).fitter.model
    fat, tissue = (float(attenuation_per_mm(one, [60.0])[0]) for one in ("adipose", "soft_tissue"))
    piece = Piece((-35.0, -20.0, -3.0), 15.0, False)
    mended = model.with_piece(Nuisance("piece_1", "1/mm", 0.0, np.inf), piece).numerical
    at = LinearizationPoint(nuisance={"piece_1": tissue - fat})
    bare = ready((), {}, stated=()).fitter.model.numerical
    np.testing.assert_allclose(mended.at(at)["rays"], bare.at()["rays"], atol=2e-6)
    assert np.abs(mended.at()["rays"] - bare.at()["rays"]).max() > 1e-4


def test_mismatch_is_found_with_the_fitted_detector_position(monkeypatch):
    monkeypatch.setattr(prepared, "MOST_MOVES", 2)
    prepared_data = ready((), {"detector_offset": {"columns_px": 4.0}})
    fit = prepared_data.fitter.fit(("detector_offset",))
    mended = prepared_data.with_mismatch(differing_by(prepared_data, fit).mismatch, fit)
    after = mended.fitter.fit(("detector_offset",))
    true = Nuisance("piece_1", "1/mm", 0.0, np.inf), Piece((-35.0, -20.0, -3.0), 15.0, False)
    at_truth = prepared_data.fitter.of(prepared_data.fitter.model.with_piece(*true)).fit(("detector_offset",))
    assert after.chi_square < at_truth.chi_square + 5
    (piece,) = mended.mismatches(after)
    place = [piece.content[name] for name in ("x_mm", "y_mm", "z_mm")]
    np.testing.assert_allclose(place, (-35, -20, -3), atol=1.0)


def test_two_mismatches_are_corrected_in_turn(monkeypatch):
    monkeypatch.setattr(prepared, "MOST_MOVES", 2)
    bone = ellipsoid("bone", (40, 10, 5), (10, 10, 10))
    prepared_data = ready((), stated=(FAT, bone))
    for count in (1, 2):
        fit = prepared_data.fitter.fit(())
        prepared_data = prepared_data.with_mismatch(differing_by(prepared_data, fit).mismatch, fit)
        assert list(prepared_data.fitter.model.pieces) == ["piece_1", "piece_2"][:count]
    fit = prepared_data.fitter.fit(())
    assert fit.chi_square < data_count(prepared_data.fitter) * 1.05
    first, second = prepared_data.mismatches(fit)
    assert first.content["hu"] < -1000 and 0 < second.content["hu"] < 200
    assert first.content["width_mm"] == pytest.approx(20, abs=0.5)


def test_mismatch_does_not_explain_all_that_physics_changes():
    prepared_data = ready((FAT,), {"spectrum": {}}, photons=4 * PHOTONS)  # an excess that a piece may explain
    baseline = trial(prepared_data.fitter, ())
    piece = differing_by(prepared_data, baseline.fit)
    assert excess(prepared_data, baseline.fit) > 10_000
    # Even if it seemed to gain half of it.
    half = replace(piece, gain=max(piece.gain, excess(prepared_data, baseline.fit) / 2))
    assert not explains_all(half, prepared_data, baseline.fit)


@pytest.mark.parametrize("count", [1, 3])
def test_mismatches_are_drawn_at_their_locations(count):
    whole = Volume(np.full((4, 48, 48), 20.0, np.float32), Grid((4, 48, 48), (8.0, 4.0, 4.0)))
    one = {"x_mm": -35.0, "y_mm": -20.0, "z_mm": -3.0, "width_mm": 30.0, "hu": 91.0}
    figure = draw_pieces(whole, [one, one | {"z_mm": None}, one][:count])
    circles = [patch for axes in figure.axes for patch in axes.patches]
    assert len(circles) == count and circles[0].center == (-35.0, -20.0) and circles[0].radius == 15.0
