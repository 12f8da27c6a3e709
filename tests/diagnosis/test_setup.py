"""Checks of the scan set-up, before physics: mistakes are named, and correct set-ups pass."""

import numpy as np
import pytest

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.base.streams import Stream, generator
from virtual_phantom.diagnosis.setup.data_checks import copied_repeats, outlying_repeat, wrong_illumination
from virtual_phantom.diagnosis.setup.finding import MOST, find
from virtual_phantom.diagnosis.setup.mismatch import Comparison
from virtual_phantom.io.volumes import Volume
from virtual_phantom.physics.beam.materials import Segmentation
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.scene import Pose, VoxelScene
from virtual_phantom.physics.scenes.shapes import DiscScene, ShapesScene, cylinder
from virtual_phantom.recordings.scan import scan_geometry

SCAN = {
    "trajectory": "circular",
    "source_to_isocentre_mm": 500.0,
    "source_to_detector_mm": 1100.0,
    "columns": 36,
    "rows": 4,
    "column_pitch_mm": 14.0,
    "row_pitch_mm": 21.0,
    "column_offset_px": 1.5,
    "views": 24,
    "views_per_rotation": 24,
    "start_angle_deg": 20.0,
    "direction": 1,
    "view_interval_ms": 8.0,
}
PHYSICS = {"scatter": {"amount": 0.1, "width_mm": 40.0}, "focal_spot": {"width_mm": 1.2, "length_mm": 1.2}}
REACH = {"x_mm": 5.0, "y_mm": 5.0, "z_mm": 5.0, "turn_deg": 2.5}
REPEATS, PHOTONS = 2, 5e5
POSE = Pose(0.6, -0.4, 0.5, 0.2)


def body(inserts, half_axes_mm=(85, 60)):
    """An elliptic body of water with balls at (x, y, z, radius, HU), mm."""
    grid = Grid((20, 48, 48), (4.0, 4.0, 4.0))
    z, y, x = np.meshgrid(*grid.axes_mm(), indexing="ij")
    hu = np.where((x / half_axes_mm[0]) ** 2 + (y / half_axes_mm[1]) ** 2 < 1, 0.0, -1000.0)
    for at_x, at_y, at_z, radius, value in inserts:
        hu = np.where((x - at_x) ** 2 + (y - at_y) ** 2 + (z - at_z) ** 2 < radius**2, value, hu)
    return VoxelScene.of(Volume(hu.astype(np.float32), grid), Segmentation(), 0.0193, 1)


OBJECT = body([(45, 10, 10, 18, 700.0), (-30, 25, -12, 16, -900.0), (5, -30, 5, 14, 300.0)])
OTHER = body([(-45, -10, -10, 18, 700.0), (30, -25, 12, 16, 300.0), (-10, 35, 0, 12, -700.0)], (75, 68))


def scanned(scene=OBJECT, physics=PHYSICS, scan=SCAN, pose=POSE, photons=PHOTONS, count=REPEATS):
    """Line integrals of repeats, with twice as many rays as in the comparison."""
    state = Chain(scene, scan_geometry(scan, "scan"), samples=3).state(physics, photons=photons, pose=pose)
    random, air = generator(Stream(7)), state.measured_air
    repeats = [-np.log(np.maximum(state.counts(random), 0.5) / (air * state.photons)) for _ in range(count)]
    return np.stack(repeats).astype(np.float32)


@pytest.fixture(scope="module")
def lines():
    return scanned()


def finding(lines, scan=SCAN, scene=OBJECT):
    comparison = Comparison(scene, lines, np.isfinite(lines).all(axis=0), MOST, REACH)
    return find(comparison, scan, log=True, largest=float(lines.max()))


def test_correct_set_up_passes_although_physics_is_missing(lines):
    found = finding(lines)
    assert found.kind == "as stated" and not found.alike, found
    assert finding(scanned(physics={"detector_offset": {"columns_px": 0.5}})).kind == "as stated"


PITCHES = {"column_pitch_mm": 14.0 / 2.2, "row_pitch_mm": 21.0 / 2.2}
MISTAKES = {
    "direction": ({"direction": -1}, None, "scan.direction: 1"),
    "start angle": ({"start_angle_deg": 110.0}, None, "scan.start_angle_deg: 20"),
    "mirrored columns": ({}, lambda data: data[..., ::-1], "along its columns"),
    "mirrored rows": ({}, lambda data: data[..., ::-1, :], "along its rows"),
    "pitch at the isocenter": (PITCHES, None, "scan.column_pitch_mm: 14, scan.row_pitch_mm: 21 (at the detector)"),
    "swapped distances": ({"source_to_isocentre_mm": 600.0}, None, "scan.source_to_isocentre_mm: 500"),
    "distance from the isocenter": ({"source_to_detector_mm": 600.0}, None, "scan.source_to_detector_mm: 1100"),
    "sign of the detector offset along columns": ({"column_offset_px": -1.5}, None, "scan.column_offset_px: 1.5"),
    "transmissions": ({}, lambda data: np.exp(-data), "store -ln(data)"),
    "decadic logarithm": ({}, lambda data: data / np.log(10), "ln 10"),
    "half a turn instead of one": ({"views_per_rotation": 12}, None, "scan.views_per_rotation: 24"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistake_is_named_with_the_corrected_setting(mistake, lines):
    changed, damaged, line = MISTAKES[mistake]
    found = finding(lines if damaged is None else damaged(lines), {**SCAN, **changed})
    assert (found.kind, found.best.name) == ("description", mistake)
    assert line in found.best.line


def test_discrete_mistake_is_preferred_to_a_fitted_geometry():
    """Distances of ratio almost two: swapping them is similar to a fitted size."""
    near = {**SCAN, "source_to_detector_mm": 970.0, "source_to_isocentre_mm": 500.0}
    found = finding(scanned(scan=near), {**near, "source_to_isocentre_mm": 470.0})
    assert (found.kind, found.best.name) == ("description", "swapped distances")


def test_impossible_geometry_is_rejected_with_the_likely_mistake():
    with pytest.raises(InputError, match="check whether rows and columns are swapped"):
        scan_geometry({**SCAN, "columns": SCAN["rows"], "rows": SCAN["columns"]}, "scan")
    with pytest.raises(InputError, match="if it is the distance from isocenter to detector, use 980"):
        scan_geometry({**SCAN, "source_to_detector_mm": 480.0}, "scan")
    with pytest.raises(InputError, match=r"expected 60 to 2000 mm\); check that all lengths are in mm"):
        scan_geometry({**SCAN, "column_pitch_mm": 0.1}, "scan")


def test_swapped_rows_and_columns_are_named():
    square = {**SCAN, "rows": 44, "columns": 44, "column_pitch_mm": 12.0, "row_pitch_mm": 5.0}
    data = np.swapaxes(scanned(scan=square), -1, -2)
    found = finding(data, square)
    assert (found.kind, found.best.name) == ("description", "swapped rows and columns")


def test_duplicate_end_angle_is_named():
    """The most common mistake: angles from 0 to 360 degrees, both included."""
    found = finding(scanned(scan={**SCAN, "views_per_rotation": 23}))
    assert (found.kind, found.best.name) == ("description", "last view at the angle of the first")


def test_centered_disc_has_no_start_angle():
    found = finding(scanned(DiscScene(150.0, "pmma"), pose=Pose()), scene=DiscScene(150.0, "pmma"))
    assert found.kind == "as stated"
    assert {"start angle", "direction", "mirrored rows"} <= {one.name for one in found.alike}


def test_other_object_is_distinguished_from_a_wrong_description(lines):
    assert finding(lines, scene=OTHER).kind == "object"
    row = {**SCAN, "rows": 1, "row_offset_px": 0.5}
    assert finding(lines[..., 2:3, :], row, DiscScene(70.0, "pmma")).kind == "object"


@pytest.mark.parametrize("scene", [OBJECT, DiscScene(150.0, "pmma")], ids=["body", "disc"])
def test_moving_object_is_no_other_object(scene):
    """Successive views see the object at two locations, so that no constant velocity explains the mismatch."""
    swinging = scanned(scene)
    swinging[:, ::2] = scanned(scene, pose=Pose(20.0, -12.0, 0.5, 0.2))[:, ::2]
    found = finding(swinging, scene=scene)
    assert found.kind == "as stated" and found.share < 0.01 < found.stated.share


def test_noise_of_one_repeat_is_no_other_object():
    """At 100 photons, noise is a third of the variance of line integrals."""
    scan = SCAN | {"rows": 1, "columns": 40, "views": 20, "views_per_rotation": 20}
    disc, rods, air = (
        ShapesScene([cylinder("water", (x, 0.0, 0.0), radius) for x, radius in rods], 60.0)
        for rods in ([(0.0, 20.0)], [(-16.0, 10.0), (16.0, 10.0)], [(0.0, 0.01)])
    )
    noisy, empty = (scanned(scene, {}, scan, Pose(), photons=100.0, count=1) for scene in (disc, air))
    assert finding(noisy, scan, disc).kind == "as stated"
    assert finding(noisy, scan, rods).kind == "object"
    assert finding(empty, scan, disc).kind == "empty"


def test_air_scan_contains_no_object():
    noise = generator(Stream(3)).normal(0, 0.003, (REPEATS, 24, 4, 36)).astype(np.float32)
    found = finding(noise)
    assert found.kind in ("empty", "object")
    assert abs(found.best.scale) < 0.02


def test_copied_repeats_are_named(lines):
    several = lines.mean(axis=0).repeat(4, axis=0)  # enough rays for the means of blocks
    usable = np.ones(several.shape, bool)
    repeats = several + generator(Stream(5)).normal(0, 0.01, (4, *usable.shape)).astype(np.float32)
    assert outlying_repeat(repeats, usable) is None and copied_repeats(repeats) == {}
    drifted = repeats * np.linspace(0.99, 1.01, 4, dtype=np.float32)[:, None, None, None]
    assert outlying_repeat(drifted, usable) is None  # the tube's output drifts
    repeats[2] = np.roll(repeats[2], 2, axis=-1)
    assert outlying_repeat(repeats, usable) == 2
    repeats[3] = repeats[0]
    assert copied_repeats(repeats) == {3: 0}
    repeats[1] = repeats[0]
    assert copied_repeats(repeats) == {1: 0, 3: 0}


@pytest.mark.parametrize(
    ("stated", "exponent", "expected"),
    [("even", 1.0, "solid_angle"), ("even", 0.0, None), ("solid_angle", 1.0, None), ("solid_angle", 0.0, "even")],
)
def test_white_field_shows_the_illumination_of_the_detector(stated, exponent, expected):
    wide = {**SCAN, "rows": 20, "row_pitch_mm": 20.0, "illumination": stated}
    geometry = scan_geometry(wide, "scan")
    angles = geometry.solid_angles()[0]
    gains = 1 + 0.002 * generator(Stream(1)).standard_normal(angles.shape)
    assert wrong_illumination(1e5 * gains * angles**exponent, geometry, wide) == expected
    bowtie = np.exp(-3 * np.linspace(-1, 1, SCAN["columns"]) ** 2)  # changes the field too, but is no mistake
    if stated == "even" and not exponent:
        assert wrong_illumination(1e5 * gains * bowtie, geometry, wide) is None


PARALLEL = {
    "trajectory": "circular",
    "beam": "parallel",
    "columns": 80,
    "rows": 1,
    "column_pitch_mm": 3.0,
    "row_pitch_mm": 3.0,
    "views": 60,
    "views_per_rotation": 120,
    "start_angle_deg": 0.0,
    "direction": 1,
}
FAN = {**SCAN, "rows": 1, "columns": 80, "column_pitch_mm": 7.0, "column_offset_px": 0.0}
DISC = DiscScene(80.0, "pmma")
HARDENED = {"spectrum": {"kvp": 120.0, "filtration_mm": 6.0, "sensor_mm": 0.6}}


@pytest.mark.parametrize(
    "scan, scene, place",
    [
        (PARALLEL, DISC, (9.5, -6.5)),
        (FAN, DISC, (-70.0, 25.0)),  # half of it is outside of the field of view of all views
        (PARALLEL, DiscScene(50.0, "aluminium"), (-30.0, 40.0)),
    ],
)
def test_object_is_found_in_the_whole_field_of_view(scan, scene, place):
    lines = scanned(scene, HARDENED, scan, Pose(*place))
    found = finding(lines, scan, scene)
    assert found.kind == "as stated" and found.share < 0.003
    assert found.location["z_mm"] == 0.0
    assert (found.location["x_mm"], found.location["y_mm"]) == pytest.approx(place, abs=0.3)


def test_object_is_found_with_a_shifted_detector():
    lines = scanned(DISC, HARDENED, {**PARALLEL, "column_offset_px": 2.5}, Pose(15.0, -20.0))
    found = finding(lines, PARALLEL, DISC)  # an offset that an effect may explain
    assert found.kind == "as stated"
    assert (found.location["x_mm"], found.location["y_mm"]) == pytest.approx((15.0, -20.0), abs=0.3)
    lines = scanned(DISC, HARDENED, {**PARALLEL, "column_offset_px": 15.0}, Pose(15.0, -20.0))
    found = finding(lines, PARALLEL, DISC)  # an offset beyond all effects
    assert (found.kind, found.best.name) == ("description", "detector offset")
    assert float(found.best.line.removeprefix("scan.column_offset_px: ")) == pytest.approx(15.0, abs=0.1)


def test_body_is_found_in_three_dimensions_and_with_a_mistake():
    wide = {**SCAN, "columns": 48}
    lines = scanned(scan=wide, pose=Pose(25.0, -18.0, 8.0))
    found = finding(lines, wide)
    assert found.kind == "as stated"
    assert tuple(found.location.values()) == pytest.approx((25.0, -18.0, 8.0), abs=0.6)
    found = finding(lines[..., ::-1], wide)
    assert (found.kind, found.best.name) == ("description", "mirrored columns") and not found.location


def test_other_disc_elsewhere_is_another_object():
    found = finding(scanned(DiscScene(100.0, "pmma"), HARDENED, PARALLEL, Pose(20.0, 10.0)), PARALLEL, DISC)
    assert found.kind == "object" and not found.location
