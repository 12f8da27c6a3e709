"""Path lengths through shapes against closed forms, and against sampled points along rays."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import circular
from virtual_phantom.physics.scenes.scene import Pose
from virtual_phantom.physics.scenes.shapes import (
    NOTHING,
    DiscScene,
    ShapesScene,
    box,
    cone,
    cylinder,
    ellipsoid,
    half_space,
)

GEOMETRY = circular(
    views=7,
    source_to_isocentre_mm=500.0,
    source_to_detector_mm=900.0,
    columns=40,
    rows=9,
    column_pitch_mm=6.0,
    row_pitch_mm=6.0,
    row_offset_px=0.3,
)
POINTS = 4001  # sampled along a ray; those inside are counted


def rays(geometry):
    """Source and pixel of every ray, [view, row, column, (x, y, z)]."""
    views, rows, columns = np.indices(geometry.shape)
    u = geometry.column_positions_mm()[columns][..., None] * geometry.column_direction[views]
    v = geometry.row_positions_mm()[rows][..., None] * geometry.row_direction[views]
    return geometry.source_mm[views], geometry.detector_mm[views] + u + v


def lengths(*shapes, geometry=GEOMETRY, **pose):
    return ShapesScene(shapes).path_lengths(geometry, Pose(**pose))


def chords_of_ball(centre, radius, geometry=GEOMETRY):
    source, pixel = rays(geometry)
    along = (pixel - source) / np.linalg.norm(pixel - source, axis=-1, keepdims=True)
    off = np.linalg.norm(np.cross(np.asarray(centre) - source, along), axis=-1)
    return 2 * np.sqrt(np.maximum(radius**2 - off**2, 0))


def test_path_lengths_of_a_ball_are_its_chords():
    centre, radius = (12.0, -7.0, 3.0), 15.0
    found = lengths(ellipsoid("water", centre, 3 * (radius,)))[0]
    np.testing.assert_allclose(found, chords_of_ball(centre, radius), atol=3e-6 * 2 * radius)


def test_long_cylinder_equals_the_disc():
    for pose in ({}, {"x_mm": 4.0, "y_mm": -9.0, "size": 1.02, "turn_deg": 30.0}):
        found = lengths(cylinder("pmma", (0, 0, 0), 35.0), **pose)
        exact = DiscScene(70.0, "pmma").path_lengths(GEOMETRY, Pose(**pose))
        np.testing.assert_allclose(found, exact, atol=1e-5 * exact.max())


def test_pose_and_motion_move_the_object():
    ball, motion = ellipsoid("water", (5, 0, 0), (10, 10, 10)), np.linspace(-3, 3, 21).reshape(7, 3)
    found = ShapesScene([ball]).path_lengths(GEOMETRY, Pose(x_mm=2.0, z_mm=1.0, turn_deg=90.0, size=1.1), motion)
    for view in range(7):  # (5, 0, 0) is scaled, rotated to (0, 5.5, 0), and shifted
        exact = chords_of_ball(np.array([2.0, 5.5, 1.0]) + motion[view], 11.0)[view]
        np.testing.assert_allclose(found[0, view], exact, atol=1e-4)


def inside(shape, points):
    planes = all_ = np.ones(points.shape[:-1], bool)
    for *normal, offset in shape.planes:
        planes = planes & (points @ np.array(normal) <= offset)
    if shape.quadric is not None:
        four = np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1)
        all_ = np.einsum("...i,ij,...j->...", four, shape.quadric, four) <= 0
    return planes & all_


def counted(shapes, source, pixel):
    """Lengths by material of one ray, from sampled points."""
    share = (np.arange(POINTS) + 0.5) / POINTS
    points = source + share[:, None] * (pixel - source)
    top = np.full(POINTS, -1)
    for place, shape in enumerate(shapes):
        top[inside(shape, points)] = place
    step, found = np.linalg.norm(pixel - source) / POINTS, {}
    for place, shape in enumerate(shapes):
        if shape.material != NOTHING:
            found[shape.material] = found.get(shape.material, 0.0) + step * (top == place).sum()
    return found, step


numbers = st.floats(-1, 1, allow_nan=False, width=32)
vectors = st.tuples(numbers, numbers, numbers)
axes = vectors.filter(lambda v: np.linalg.norm(v) > 0.1)
sizes = st.floats(5, 60)
materials = st.sampled_from(["water", "bone", "pmma", NOTHING])


def places(vector):
    return tuple(50 * np.array(vector))


half_axes = st.tuples(sizes, sizes, sizes)
convex = st.one_of(
    st.builds(
        lambda m, c, a, t: ellipsoid(m, places(c), a, t), materials, vectors, st.tuples(sizes, sizes, sizes), sizes
    ),
    st.builds(lambda m, c, a, t: box(m, places(c), a, t), materials, vectors, half_axes, sizes),
    st.builds(lambda m, c, r, n, a: cylinder(m, places(c), r, n, a), materials, vectors, sizes, sizes, axes),
    st.builds(lambda m, c, r, a: cylinder(m, places(c), r, None, a), materials, vectors, sizes, axes),
    st.builds(
        lambda m, b, r, q, h, a: cone(m, places(b), r, q * r, h, a),
        materials,
        vectors,
        sizes,
        st.floats(0, 0.9),
        sizes,
        axes,
    ),
    st.builds(lambda m, p, n: half_space(m, places(p), n), materials, vectors, axes),
)


@settings(max_examples=60, deadline=None)
@given(st.lists(convex, min_size=1, max_size=5), st.integers(0, 6), st.integers(0, 8), st.integers(0, 39))
def test_path_lengths_agree_with_sampled_points(shapes, view, row, column):
    """Any shapes in any order; later shapes replace earlier ones."""
    if all(shape.material == NOTHING for shape in shapes):
        return
    source, pixel = (ray[view, row, column] for ray in rays(GEOMETRY))
    scene = ShapesScene(shapes)
    found = dict(zip(scene.materials, scene.path_lengths(GEOMETRY)[:, view, row, column], strict=True))
    expected, step = counted(shapes, source, pixel)
    for material, length in expected.items():
        assert found[material] == pytest.approx(length, abs=2 * step * len(shapes) + 1e-3)


def test_tube_is_a_cylinder_with_a_hole():
    wall = lengths(cylinder("pmma", (0, 0, 0), 30.0), cylinder(NOTHING, (0, 0, 0), 28.0))
    whole, hole = (DiscScene(2 * r, "pmma").path_lengths(GEOMETRY) for r in (30.0, 28.0))
    np.testing.assert_allclose(wall, whole - hole, atol=1e-5 * whole.max())
    filled = lengths(cylinder("pmma", (0, 0, 0), 30.0), cylinder("water", (0, 0, 0), 28.0))
    np.testing.assert_allclose(filled, np.concatenate([whole - hole, hole]), atol=1e-5 * whole.max())


def test_only_the_part_between_source_and_detector_counts():
    """A half-space that contains the detector ends at it."""
    one = replace(GEOMETRY.every(7), columns=1, rows=1, column_offset_px=0.0, row_offset_px=0.0)
    (found,) = lengths(half_space("water", (0, 0, 0), one.source_mm[0]), geometry=one).ravel()
    assert found == pytest.approx(400.0)


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: ellipsoid("water", (0, 0, 0), (1, -1, 1)), "ellipsoid: semi_axes_mm must be positive"),
        (lambda: box("water", (0, 0, 0), (0, 1, 1)), "box: sides_mm must be positive"),
        (lambda: cylinder("water", (0, 0, 0), 0.0), "cylinder: radius_mm and length_mm must be positive"),
        (lambda: cone("water", (0, 0, 0), 5.0, 5.0, 1.0), "use a cylinder for equal radii"),
        (lambda: half_space("water", (0, 0, 0), (0, 0, 0)), "has no length"),
        (lambda: ShapesScene([cylinder(NOTHING, (0, 0, 0), 1.0)]), "shapes: no shape has a material"),
    ],
)
def test_invalid_shapes_are_rejected(make, message):
    with pytest.raises(InputError, match=message):
        make()
