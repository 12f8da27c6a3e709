"""Agreement tables: images with known differences, and a scan with a hidden blur."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy import special
from simulated_scans import body, chosen, noisy_lines

from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.diagnosis.comparison.agreement import Features, Regions, agreement, share_within
from virtual_phantom.diagnosis.comparison.regions import ScannedVolume, complete, image_grid, phantom_regions
from virtual_phantom.diagnosis.comparison.relevance import middle_profile
from virtual_phantom.diagnosis.comparison.scans import agreement_of_repeats, filled, held_out_repeats, reconstructed
from virtual_phantom.diagnosis.projections import observed, prepared
from virtual_phantom.physics.beam.materials import Segmentation
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.scene import Pose, VoxelScene
from virtual_phantom.physics.scenes.shapes import DiscScene
from virtual_phantom.report.agreement_table import agreement_table

PHOTONS, MU_WATER = 1e5, 0.0193
SPACING = (2.0, 1.0, 1.0)
METRICS = ("contrast", "noise_magnitude", "noise_texture", "noise_spectrum", "resolution")


def disc_regions():
    y, x = np.mgrid[:80, :80] - 39.5
    distance = np.broadcast_to(np.hypot(y, x) - 28.3, (2, 80, 80))
    rois = {"object": distance < -4, "air": distance > 4}
    return Regions(SPACING, rois, distance, np.ones(distance.shape, bool))


def disc(regions, repeats, seed, *, hu=0.0, sigma=10.0, blur=1.0):
    random = np.random.default_rng(np.random.SeedSequence(seed))
    clean = -1000 + (hu + 1000) * (1 - special.erf(regions.distance_mm / (np.sqrt(2) * blur))) / 2
    return clean + random.normal(0, sigma, (repeats, *clean.shape))


def test_table_reports_known_differences():
    regions = disc_regions()
    simulated = {
        "before": disc(regions, 4, 2, hu=-50.0, sigma=8.0, blur=0.8),
        "after": disc(regions, 4, 3),
    }
    found = agreement(disc(regions, 4, 1), simulated, regions, regions.inner.sum())
    assert tuple(found["metrics"]) == METRICS and found["left_out"] == {}
    for name, difference in (("contrast", -0.05), ("noise_magnitude", -0.2), ("resolution", 0.25)):
        entry = found["metrics"][name]
        assert entry["before"]["relative_difference"] == pytest.approx(difference, abs=0.02 + 4 * entry["floor"])
    for name, entry in found["metrics"].items():
        assert abs(entry["after"]["relative_difference"]) < 3 * entry["floor"], name
        if entry["recorded"] is not None:
            value = entry["recorded"] * (1 + entry["after"]["relative_difference"])
            assert entry["after"]["value"] == pytest.approx(value)
    json.dumps(found, allow_nan=False)


def test_noise_floor_falls_with_square_root_of_repeats():
    regions = disc_regions()
    floors = []
    for repeats in (9, 33):  # 8 and 32 independent differences
        images = [disc(regions, repeats, seed) for seed in (5, 6)]
        metrics = agreement(images[0], {"after": images[1]}, regions, regions.inner.sum())["metrics"]
        floors.append([metrics[name]["floor"] for name in METRICS])
    np.testing.assert_allclose(np.divide(*floors), 2, rtol=0.2)


def test_single_repeat_has_no_noise_and_no_floor():
    regions = disc_regions()
    found = agreement(disc(regions, 1, 1), {"after": disc(regions, 1, 2)}, regions, features=Features(regions))
    assert set(found["metrics"]) == {"contrast", "resolution"}
    assert all(entry["floor"] is None for entry in found["metrics"].values())
    assert "there is only one; record at least two" in found["left_out"]["noise_magnitude"]


def test_features_within_a_repeat_sd_are_counted():
    random = np.random.default_rng(np.random.SeedSequence(8))
    recorded = random.normal(0, 1, (200, 400))
    assert share_within(recorded, recorded + 0.75) > 0.99
    assert share_within(recorded, recorded + 1.3) < 0.01
    regions = disc_regions()
    images = [disc(regions, 3, seed, sigma=30.0) for seed in (1, 2)]
    entry = agreement(images[0], {"same": images[0], "other": images[1]}, regions, features=Features(regions))[
        "metrics"
    ]["features"]
    assert entry["same"]["value"] == 1.0 and 0.3 < entry["other"]["value"] < 1.0
    # Means of three repeats each differ by less than an SD with two degrees of freedom: Student's t at sqrt(3/2).
    t = np.sqrt(1.5)
    assert entry["floor"] == pytest.approx(t / np.sqrt(2 + t**2))


def test_profile_through_the_middle_shows_cupping():
    """Images of 0.01 x^2 HU with noise of 1 HU, whose first slices are incomplete."""
    regions = disc_regions()
    valid = regions.valid.copy()
    valid[0] = False
    regions = replace(regions, valid=valid)
    x = (np.arange(valid.shape[2]) - (valid.shape[2] - 1) / 2) * regions.spacing[2]
    images = np.random.default_rng(3).normal(0, 1, (20, *valid.shape)) + 0.01 * x**2
    images[:, 0] = 1e6
    x_mm, hu = middle_profile(images, regions)
    rows = np.flatnonzero(regions.inner.any(axis=(0, 2)))
    assert set(x_mm) <= set(x) and abs(x_mm).max() < rows.size * regions.spacing[1] / 2 + 1
    np.testing.assert_allclose(hu, 0.01 * x_mm**2, atol=0.7)
    assert not middle_profile(images, replace(regions, valid=np.zeros_like(valid)))[0].size


GEOMETRY = circular(
    views=90,
    source_to_isocentre_mm=570.0,
    source_to_detector_mm=1040.0,
    columns=64,
    rows=5,
    column_pitch_mm=8.0,
    row_pitch_mm=8.0,
)


@pytest.fixture(scope="module")
def scanned():
    grid = Grid((12, 96, 96), (4.0, 2.7, 2.7))
    _, y, x = np.meshgrid(*grid.axes_mm(), indexing="ij")
    volume = body(grid, (105, 80), 20.0, [((50, 10, None), 22, 800.0), ((-40, -20, None), 22, -80.0)])
    return ScannedVolume(volume, {"bone": np.hypot(x - 50, y - 10) < 13, "fat": np.hypot(x + 40, y + 20) < 13}, grid)


def diagnosed(scene, geometry, physics, library, repeats=8):
    chain = Chain(scene, geometry, PHOTONS)
    state = chain.state(physics)
    lines = noisy_lines(state, repeats, np.random.default_rng(np.random.SeedSequence(4))).astype(np.float32)
    white = (state.measured_air * state.photons).mean(axis=0)
    taken = observed.Scans(lines, white, np.ones(lines.shape[1:], bool))
    prepared_data = prepared.prepare(taken, None, chain, nominal_photons=PHOTONS)
    return taken, prepared_data, chosen(prepared_data.fitter, library)


def test_hidden_blur_disagrees_before_the_fit_and_agrees_within_noise_after(scanned):
    scene = VoxelScene.of(scanned.fine, Segmentation(), MU_WATER)
    physics = {"optical_crosstalk": {"column": 0.08, "row": 0.08}}
    taken, prepared_data, choice = diagnosed(scene, GEOMETRY, physics, ("optical_crosstalk", "scatter"))
    repeats = held_out_repeats(taken, None)
    assert len(repeats) == 4 and np.array_equal(repeats.repeats, taken.repeats[1::2])
    found = agreement_of_repeats(repeats, prepared_data, choice, MU_WATER, np.random.SeedSequence(1), scanned)
    assert found["left_out"] == {} and found["rois"] == ["bone", "fat"] and found["repeats"] == 4
    metrics = found["metrics"]
    # Sharing between neighbors lowers noise and resolution.
    for name in ("resolution", "noise_magnitude"):
        assert metrics[name]["before"]["relative_difference"] > max(0.1, 5 * metrics[name]["floor"]), name
    for name in METRICS:
        assert abs(metrics[name]["after"]["relative_difference"]) < 4 * metrics[name]["floor"], name
    assert metrics["features"]["after"]["value"] > metrics["features"]["before"]["value"]
    profile = found["profile"]
    assert len({len(values) for values in profile.values()}) == 1 and max(profile["recorded"]) > 400  # through bone
    assert metrics["contrast"]["recorded"] == pytest.approx(880, rel=0.02)  # well within bone and fat
    html = agreement_table(found)
    assert "resolution (frequency at MTF 0.5)" in html and "64 × 64" in html and "Not measured" not in html


def test_regions_follow_the_pose_of_the_object(scanned):
    """Reconstruct the chain's projections of a shifted and rotated object."""
    pose = Pose(x_mm=9.0, y_mm=-7.0, turn_deg=25.0)
    lines = Chain(VoxelScene.of(scanned.fine, Segmentation(), MU_WATER), GEOMETRY).state({}, pose).line_integrals()
    grid = image_grid(GEOMETRY, scanned.radius_mm + 12)
    valid = complete(GEOMETRY, grid)
    usable = np.ones(lines.shape, bool)
    (image,) = reconstructed(lines[None].astype(np.float32), usable, GEOMETRY, grid, MU_WATER, 1)
    means = {}
    for name, where in (("moved", pose), ("unmoved", Pose())):
        regions = phantom_regions(grid, valid, scanned, where)
        means[name] = image[regions.rois["bone"]].mean()
        half = image[np.abs(regions.distance_mm) < 1].mean()
        assert (abs(half + 490) < 40) == (name == "moved")  # halfway from air to the body, at its edge
    assert means["moved"] == pytest.approx(800, rel=0.02) and means["unmoved"] < 700


def test_scan_of_less_than_half_a_turn_is_rejected_in_one_line():
    geometry = circular(
        views=40,
        turns=0.3,
        source_to_isocentre_mm=410.0,
        source_to_detector_mm=553.0,
        columns=64,
        rows=1,
        column_pitch_mm=1.6,
        row_pitch_mm=1.6,
    )
    taken, prepared_data, choice = diagnosed(DiscScene(70.0, "pmma"), geometry, {}, ("scatter",), repeats=4)
    found = agreement_of_repeats(
        held_out_repeats(taken, None), prepared_data, choice, MU_WATER, np.random.SeedSequence(1)
    )
    assert found["metrics"] == {} and "do not contain all directions of rays" in found["left_out"]["images"]
    html = agreement_table(found)
    assert "Images were not compared (scan: 40 views over 0.3 turns" in html and "<table>" not in html
    assert agreement_table(None) == ""


def test_grid_shows_the_object_with_air_around_it_and_complete_slices_only(scanned):
    grid = image_grid(GEOMETRY, scanned.radius_mm)
    assert scanned.radius_mm == pytest.approx(105, abs=2.7)
    assert grid.spacing[2] == pytest.approx(8 * 570 / 1040) and max(grid.shape) <= 128
    assert grid.extent_mm[2] / 2 > scanned.radius_mm + 6 * grid.spacing[2]
    valid = complete(GEOMETRY, grid)
    _, y, x = grid.axes_mm()
    assert valid[:, np.hypot(y[:, None], x) < scanned.radius_mm].all()


def test_rays_without_counts_are_interpolated_from_their_neighbors():
    lines = np.tile(np.arange(6.0, dtype=np.float32), (2, 1, 2, 1))
    usable = np.ones((1, 2, 6), bool)
    usable[0, 0, 2:4] = False
    broken = np.where(usable, lines, 99)
    np.testing.assert_allclose(filled(broken, usable), lines)


def test_number_of_compared_repeats():
    lines = np.arange(6.0).reshape(6, 1, 1, 1)
    taken = observed.Scans(lines, None, np.ones((1, 1, 1), bool))
    further = observed.Scans(lines[:2] + 10, None, taken.usable)
    assert held_out_repeats(taken, further) is further
    assert held_out_repeats(taken, None).repeats.ravel().tolist() == [1, 3, 5]
    few = observed.Scans(lines[:3], None, taken.usable)
    assert held_out_repeats(few, None) is few
