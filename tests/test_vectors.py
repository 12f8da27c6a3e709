"""Scan geometries given by vectors against the closed forms of a circle and a helix."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scanner import SCANNER

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import circular, helical, orbit_of

DETECTOR = dict(**SCANNER, columns=21, rows=7, column_pitch_mm=12.0, row_pitch_mm=9.0)


@st.composite
def orbits(draw):
    radius = draw(st.floats(50, 1000))
    detector = dict(
        source_to_isocentre_mm=radius,
        source_to_detector_mm=radius * draw(st.floats(1.01, 4)),
        columns=draw(st.integers(1, 9)),
        rows=draw(st.integers(1, 9)),
        column_pitch_mm=draw(st.floats(0.1, 20)),
        row_pitch_mm=draw(st.floats(0.1, 20)),
        column_offset_px=draw(st.floats(-5, 5)),
        row_offset_px=draw(st.floats(-5, 5)),
        start_angle_rad=draw(st.floats(-7, 7)),
        direction=draw(st.sampled_from((1, -1))),
    )
    if draw(st.booleans()):
        return circular(views=draw(st.integers(1, 9)), **detector)
    return helical(views=draw(st.integers(2, 9)), volume_height_mm=draw(st.floats(1, 300)), **detector)


def by_hand(geometry, view, row, column):
    """Source and pixel by the formulas in geometry.py's docstring."""
    b, z = geometry.angles_rad[view], geometry.source_z_mm[view]
    radius, distance = geometry.source_to_isocentre_mm, geometry.source_to_detector_mm
    u = (column - (geometry.columns - 1) / 2 + geometry.column_offset_px) * geometry.column_pitch_mm
    v = (row - (geometry.rows - 1) / 2 + geometry.row_offset_px) * geometry.row_pitch_mm
    beyond = distance - radius
    source = (-radius * math.sin(b), radius * math.cos(b), z)
    pixel = (beyond * math.sin(b) + u * math.cos(b), -beyond * math.cos(b) + u * math.sin(b), z + v)
    return source, pixel


@settings(deadline=None)
@given(orbits(), st.data())
def test_vectors_of_an_orbit_equal_its_closed_form(geometry, data):
    vectors = geometry.by_vectors()
    place = [data.draw(st.integers(0, count - 1)) for count in geometry.shape]
    for one in (geometry, vectors):
        for found, expected in zip(one.ray(*place), by_hand(geometry, *place), strict=True):
            np.testing.assert_allclose(found, expected, atol=1e-9)
    assert vectors.shape == geometry.shape
    assert vectors.magnification == pytest.approx(geometry.magnification)
    np.testing.assert_allclose(*np.broadcast_arrays(vectors.solid_angles(), geometry.solid_angles()), rtol=1e-9)


@settings(deadline=None)
@given(orbits(), st.floats(-7, 7))
def test_frames_stay_orthonormal_and_rotate_with_the_gantry(geometry, angle):
    for one in (geometry, geometry.by_vectors(), geometry.by_vectors().turned(angle)):
        frame = np.stack([one.column_direction, one.row_direction, one.normal], axis=1)
        np.testing.assert_allclose(frame @ frame.swapaxes(1, 2), np.tile(np.eye(3), (one.views, 1, 1)), atol=1e-12)
        np.testing.assert_allclose(np.linalg.det(frame), 1)
    turned, other = geometry.by_vectors().turned(angle), geometry.turned(angle)
    for name in ("source_mm", "detector_mm", "column_direction", "row_direction"):
        np.testing.assert_allclose(getattr(turned, name), getattr(other, name), atol=1e-9)
        np.testing.assert_allclose(
            getattr(turned.turned(-angle), name), getattr(geometry.by_vectors(), name), atol=1e-9
        )


@settings(deadline=None)
@given(orbits())
def test_orbit_converted_to_vectors_and_back_is_unchanged(geometry):
    for one in (geometry, geometry.by_vectors()):
        above = one.upright("test")
        np.testing.assert_allclose(above.depth, geometry.source_to_isocentre_mm)
        np.testing.assert_allclose(above.distance, geometry.source_to_detector_mm)
        np.testing.assert_allclose(above.beside, 0, atol=1e-9)
        np.testing.assert_allclose(above.first_column, geometry.column_positions_mm()[0], atol=1e-9)
        np.testing.assert_allclose(above.first_row, geometry.row_positions_mm()[0], atol=1e-9)
        np.testing.assert_array_equal(above.source_z, geometry.source_z_mm)


@pytest.mark.parametrize("roll", [0.0, 0.3])
def test_bundles_contain_every_ray_at_its_position(roll):
    geometry = rolled(circular(views=3, start_angle_rad=0.4, row_offset_px=0.3, **DETECTOR), roll)
    to, rows = geometry.bundles()
    assert to.shape == (3, 3, 21 if roll == 0 else 7 * 21)
    ways = to[:, :, None] + np.array([0, 0, 1])[:, None, None, None] * rows[:, None]
    ways = np.moveaxis(ways.reshape(3, *geometry.shape), 0, -1)
    for place in ((0, 0, 0), (1, 6, 20), (2, 5, 3)):
        source, pixel = geometry.ray(*place)
        np.testing.assert_allclose(ways[place], pixel - source, atol=1e-9)


def rolled(geometry, angle):
    """Rotate the detector about its normal through the reference point."""
    columns, rows = geometry.column_direction, geometry.row_direction
    return replace(
        geometry.by_vectors(),
        column_direction=math.cos(angle) * columns + math.sin(angle) * rows,
        row_direction=math.cos(angle) * rows - math.sin(angle) * columns,
    )


def test_every_nth_view_keeps_its_vectors_and_time():
    geometry = helical(views=9, volume_height_mm=50, **DETECTOR)
    fewer, expected = geometry.by_vectors().every(3), geometry.every(3)
    np.testing.assert_allclose(fewer.source_mm, expected.source_mm)
    np.testing.assert_array_equal(fewer.view_times, expected.view_times)


def test_keys_distinguish_geometries():
    geometry = circular(views=4, **DETECTOR).by_vectors()
    assert geometry.key == circular(views=4, **DETECTOR).by_vectors().key
    assert geometry.key != replace(geometry, source_mm=geometry.source_mm + 1e-9).key
    assert hash(geometry.key)


def changed(**changes):
    geometry = circular(views=4, **DETECTOR).by_vectors()
    return replace(geometry, **{name: change(getattr(geometry, name)) for name, change in changes.items()})


@pytest.mark.parametrize(
    "changes, message",
    [
        (dict(source_mm=lambda one: one[:3]), "four vectors"),
        (dict(source_mm=lambda one: one[0]), "four vectors"),
        (dict(source_mm=lambda one: np.full_like(one, np.inf)), "vectors must be finite"),
        (dict(column_direction=lambda one: 1.01 * one), "view 0: .* length 1"),
        (dict(row_direction=lambda one: np.roll(one, 1, axis=1)), "perpendicular"),
        (dict(column_direction=lambda one: -one), "faces away"),
        (dict(view_times=lambda one: one[:2]), "one time"),
        (dict(surface=lambda one: "cylindrical"), "arc_radius_mm is the radius of a cylindrical detector"),
    ],
)
def test_impossible_vectors(changes, message):
    with pytest.raises(InputError, match=message):
        changed(**changes)


def test_operations_for_orbits_or_upright_detectors_report_others():
    geometry = rolled(circular(views=4, **DETECTOR), 0.1)
    with pytest.raises(InputError, match="fbp needs a circular or helical scan"):
        orbit_of(geometry, "fbp")
    with pytest.raises(InputError, match="engine cpu needs detector rows along z"):
        geometry.upright("engine cpu")
    assert orbit_of(circular(views=4, **DETECTOR), "fbp").views == 4
