"""Misaligned detectors, drifting sources and angle errors.

The references are the calculated shadow of a small ball, solid angles from pixel corners, and ASTRA's fans.
"""

import math

import astra
import numpy as np
import pytest
from scanner import SCANNER
from scipy.integrate import cumulative_trapezoid

from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.base.mounting import AS_STATED, Mounting
from virtual_phantom.physics.chain import SOLID_ANGLE, Chain
from virtual_phantom.physics.scenes.posed import PosedScene
from virtual_phantom.physics.scenes.scene import Pose, VoxelScene
from virtual_phantom.physics.scenes.shapes import DiscScene, ShapesScene, ellipsoid

VIEWS, SOURCE, DISTANCE = 8, 500.0, 1000.0
BALL = np.array([30.0, -20.0, 12.0])
GEOMETRY = circular(
    views=VIEWS,
    source_to_isocentre_mm=SOURCE,
    source_to_detector_mm=DISTANCE,
    columns=90,
    rows=50,
    column_pitch_mm=2.0,
    row_pitch_mm=2.0,
    view_interval_ms=100.0,
)
ANGLES = np.arange(VIEWS) * 2 * np.pi / VIEWS
TIMES = (np.arange(VIEWS) + 0.5 - VIEWS / 2) * 0.1


def found(physics, geometry=GEOMETRY):
    """Center of the ball's shadow on the detector, (u, v) in mm per view."""
    chain = Chain(ShapesScene([ellipsoid("water", BALL, 3 * (4.0,))]), geometry, samples=6)
    shadow = chain.state(physics).line_integrals()
    whole = shadow.sum(axis=(1, 2))
    along = (shadow.sum(axis=1) * geometry.column_positions_mm()).sum(axis=1)
    return np.stack([along, (shadow.sum(axis=2) * geometry.row_positions_mm()).sum(axis=1)]) / whole


def upright(angles=ANGLES, source=(0.0, 0.0, 0.0)):
    """Position on an upright detector for a source shifted along columns, rows and away from the detector."""
    along, up, away = source
    across = BALL[0] * np.cos(angles) + BALL[1] * np.sin(angles)
    depth = SOURCE + BALL[0] * np.sin(angles) - BALL[1] * np.cos(angles)  # from the source's orbit
    share = (DISTANCE + away) / (depth + away)
    return np.stack([along + share * (across - along), up + share * (BALL[2] - up)])


def rotated_detector(angle, name):
    """Position on a detector rotated by angles in radians."""
    u, v = upright()
    sine, cosine = math.sin(angle), math.cos(angle)
    if name == "detector_roll":
        return np.stack([u * cosine + v * sine, v * cosine - u * sine])
    if name == "detector_tilt":
        rows = v / (cosine + v * sine / DISTANCE)
        return np.stack([u * (1 - rows * sine / DISTANCE), rows])
    columns = u / (cosine + u * sine / DISTANCE)
    return np.stack([columns, v * (1 - columns * sine / DISTANCE)])


@pytest.mark.parametrize(
    ("name", "angle"),
    [("detector_roll", 2.0), ("detector_roll", -0.7), ("detector_tilt", 5.0), ("detector_skew", -5.0)],
)
def test_ball_on_a_misaligned_detector(name, angle):
    expected = rotated_detector(math.radians(angle), name)
    assert np.abs(expected - upright()).max() > 0.1
    np.testing.assert_allclose(found({name: {"angle_deg": angle}}), expected, atol=0.015)


def test_rotations_are_applied_in_turn():
    """Roll, tilt and skew in any key order, each about the axes after the previous one."""
    turns = {"detector_roll": 2.0, "detector_tilt": -4.0, "detector_skew": 3.0}
    roll, tilt, skew = (math.radians(turns[f"detector_{name}"]) for name in ("roll", "tilt", "skew"))
    u, v = upright()
    # A rotated detector is equivalent to a ray with the inverse rotations, applied in turn.
    ray = np.stack([u, v, np.full(VIEWS, DISTANCE)])
    c, s = math.cos(roll), math.sin(roll)
    ray = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ ray
    c, s = math.cos(tilt), math.sin(tilt)
    ray = np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ ray
    c, s = math.cos(skew), math.sin(skew)
    turn = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    ray = turn @ ray
    c, s = math.cos(tilt), math.sin(tilt)
    middle = turn @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ [0, 0, DISTANCE]
    expected = ray[:2] * middle[2] / ray[2] - middle[:2, None]
    physics = {name: {"angle_deg": angle} for name, angle in turns.items()}
    np.testing.assert_allclose(found(physics), expected, atol=0.015)


def test_detector_row_offset():
    np.testing.assert_allclose(found({"detector_row_offset": {"rows_mm": 3.0}}), upright() - [[0], [3]], atol=0.015)


@pytest.mark.parametrize("slowed", [0.0, 0.6])
def test_drifting_source(slowed):
    """The velocity falls uniformly, by a share of 2 * slowed of its mean from the first view to the last."""
    velocity = np.array([3.0, -2.0, 8.0])
    acceleration = -2 * slowed * velocity / (TIMES[-1] - TIMES[0])
    names = [f"{name}_mm_per_{unit}" for unit in ("s", "s2") for name in ("columns", "rows", "away")]
    drift = dict(zip(names, [*velocity, *acceleration], strict=True))
    path = cumulative_trapezoid(np.linspace(1 + slowed, 1 - slowed, VIEWS), TIMES, initial=0)
    path -= path.mean()
    there = upright(source=velocity[:, None] * path)
    assert np.abs(there - upright()).max(axis=1).min() > 0.3
    np.testing.assert_allclose(found({"source_drift": drift}), there, atol=0.015)
    # Drift and jumps of a focal spot are combined.
    jumps = np.where(np.arange(VIEWS) % 2, 0.5, -0.5) * 2.0
    both = {"source_drift": drift, "focal_spot_wobble": {"columns_mm": 2.0, "rows_mm": 0.0}}
    source = velocity[:, None] * path + np.stack([jumps, 0 * jumps, 0 * jumps])
    np.testing.assert_allclose(found(both), upright(source=source), atol=0.015)


def test_angle_errors_of_views():
    wave = {"cosine_deg": 0.6, "sine_deg": -0.8}
    there = upright(ANGLES + np.radians(0.6 * np.cos(ANGLES) - 0.8 * np.sin(ANGLES)))
    assert np.abs(there - upright()).max() > 0.5
    np.testing.assert_allclose(found({"view_angle_error": wave}), there, atol=0.015)


@pytest.mark.parametrize("surface", ["flat", "cylindrical"])
def test_pixels_of_a_rotated_detector_match_a_rigid_rotation(surface):
    """Also on an arc: every pixel rotates with a rigid body about the reference point."""
    pixels = dict(columns=9, rows=5, column_pitch_mm=40.0, row_pitch_mm=30.0, column_offset_px=0.3, row_offset_px=-0.4)
    geometry = circular(views=3, start_angle_rad=0.4, surface=surface, **SCANNER, **pixels)
    turned = Mounting(10.0, -7.0, 4.0).of(geometry)
    assert not turned.is_upright and Mounting(skew_deg=4.0).of(geometry).is_upright
    assert AS_STATED.of(geometry) is geometry
    for view in range(3):
        rest = [geometry.ray(view, row, column)[1] for row in range(5) for column in range(9)] - geometry.detector_mm[
            view
        ]
        now = [turned.ray(view, row, column)[1] for row in range(5) for column in range(9)] - turned.detector_mm[view]
        frame = np.stack([geometry.column_direction[view], geometry.row_direction[view], geometry.normal[view]], axis=1)
        rest, now = rest @ frame, now @ frame
        order = _about(1, 4.0), _about(0, 7.0), _about(2, 10.0)
        # Intrinsic rotations equal rotations about fixed axes in reverse order.
        np.testing.assert_allclose(now, rest @ (order[2] @ order[1] @ order[0]).T, atol=1e-9)


def _about(axis, angle):
    """Right-handed rotation about an axis, degrees."""
    c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    one, other = (axis + 1) % 3, (axis + 2) % 3
    turn = np.eye(3)
    turn[one, one] = turn[other, other] = c
    turn[one, other], turn[other, one] = -s, s
    return turn


def corners(geometry):
    """Corners of all pixels relative to the source, (rows + 1, columns + 1, 3), for view 0."""
    u = (np.arange(geometry.columns + 1) - geometry.columns / 2) * geometry.column_pitch_mm
    v = (np.arange(geometry.rows + 1) - geometry.rows / 2) * geometry.row_pitch_mm
    along, up = geometry.column_direction[0], geometry.row_direction[0]
    return geometry.toward_mm[0] + u[:, None] * along + v[:, None, None] * up


def solid_angle(a, b, c):
    """Solid angles of triangles: A. Van Oosterom and J. Strackee, IEEE Trans. Biomed. Eng. 30, 125 (1983)."""
    la, lb, lc = (np.linalg.norm(one, axis=-1) for one in (a, b, c))
    dot = [(x * y).sum(axis=-1) for x, y in ((a, b), (a, c), (b, c))]
    triple = (a * np.cross(b, c)).sum(axis=-1)
    return 2 * np.arctan2(np.abs(triple), la * lb * lc + dot[0] * lc + dot[1] * lb + dot[2] * la)


def test_white_field_of_a_misaligned_detector():
    mounting = Mounting(1.0, 5.0, -4.0)

    def seen(geometry):
        at = corners(geometry)
        low, right, up, far = at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]
        return solid_angle(low, right, far) + solid_angle(low, up, far)

    expected = seen(mounting.of(GEOMETRY)) / seen(GEOMETRY)
    assert np.ptp(expected) > 0.02
    np.testing.assert_allclose(mounting.solid_angles(GEOMETRY)[0], expected, rtol=1e-5)
    chain = Chain(DiscScene(40.0, "water"), GEOMETRY, illumination=SOLID_ANGLE)
    physics = {"detector_roll": 1.0, "detector_tilt": 5.0, "detector_skew": -4.0}
    air = chain.state({name: {"angle_deg": angle} for name, angle in physics.items()}).air
    np.testing.assert_allclose(air[0] / chain.state({}).air[0], expected, rtol=1e-5)


def test_skewed_fan_agrees_with_astra():
    """ASTRA's line model on a CPU with a detector given by vectors; one row, in the plane."""
    size, columns = 64, 48
    fan = circular(views=5, start_angle_rad=0.45, source_to_isocentre_mm=SOURCE, source_to_detector_mm=DISTANCE,
                   columns=columns, rows=1, column_pitch_mm=4.0, row_pitch_mm=4.0)  # fmt: skip
    y, x = np.meshgrid(*2 * (np.arange(size) - (size - 1) / 2,), indexing="ij")
    object_ = np.exp(-(((x - 6) / 12) ** 2) - ((y + 4) / 8) ** 2)
    angle = math.radians(5.0)
    vectors = []
    for b in fan.angles_rad:
        # Column direction rotated towards the source.
        column = np.array([math.cos(b), math.sin(b)]) * math.cos(angle)
        column -= np.array([math.sin(b), -math.cos(b)]) * math.sin(angle)
        source = SOURCE * np.array([-math.sin(b), math.cos(b)])
        middle = source + DISTANCE * np.array([math.sin(b), -math.cos(b)])
        vectors.append([*source, *middle, *(4.0 * column)])
    detector = astra.create_proj_geom("fanflat_vec", columns, np.array(vectors))
    projector = astra.create_projector("line_fanflat", detector, astra.create_vol_geom(size, size))
    identifier, theirs = astra.create_sino(object_[::-1], projector)  # rows from +y
    astra.data2d.delete(identifier)
    astra.projector.delete(projector)
    scene = VoxelScene(
        object_[None, None].astype(np.float32), Grid((1, size, size), (50.0, 1.0, 1.0)), ("water",), 60.0
    )
    actual = scene.path_lengths(Mounting(skew_deg=5.0).of(fan))[0, :, 0]
    plain = scene.path_lengths(fan)[0, :, 0]
    assert np.abs(plain - theirs).max() > 0.1
    np.testing.assert_allclose(actual, theirs, atol=0.01 * theirs.max())


def test_small_rotations_of_a_rotated_detector():
    z, y, x = Grid((20, 40, 40), (4.0, 3.0, 3.0)).axes_mm()
    body = np.exp(-((x / 30) ** 2) - ((y / 40) ** 2)[:, None] - ((z / 20) ** 2)[:, None, None])
    scene = VoxelScene(body[None].astype(np.float32), Grid((20, 40, 40), (4.0, 3.0, 3.0)), ("water",), 60.0)
    small = circular(views=5, **SCANNER, columns=20, rows=6, column_pitch_mm=10.0, row_pitch_mm=8.0)
    start, near = (Mounting(one, 1.0).of(small) for one in (0.5, 0.505))
    posed = PosedScene(scene).linearized_at([(start, Pose(), None)])
    assert posed.in_linear_range((near, Pose(), None)) and not posed.in_linear_range((small, Pose(), None))
    first, retraced = scene.path_lengths(start), scene.path_lengths(near)
    change = np.abs(retraced - first).max()
    assert change > 1e-3 and np.abs(posed.path_lengths(near) - retraced).max() < 0.1 * change
    np.testing.assert_array_equal(posed.path_lengths(small), scene.path_lengths(small))
