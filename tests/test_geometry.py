"""Grids and scan geometries against closed forms."""

import math

import nibabel
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scanner import SCANNER

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, OrbitGeometry, circular, helical

DETECTOR = dict(
    **SCANNER,
    columns=101,
    rows=11,
    column_pitch_mm=2.0,
    row_pitch_mm=4.0,
)


@given(st.tuples(*[st.integers(1, 9)] * 3), st.tuples(*[st.floats(0.1, 9)] * 3), st.tuples(*[st.floats(-99, 99)] * 3))
def test_affine_maps_the_middle_of_the_array_to_the_center(shape, spacing, centre):
    grid = Grid(shape, spacing, centre)
    middle = (np.array(shape[::-1]) - 1) / 2
    np.testing.assert_allclose(nibabel.affines.apply_affine(grid.affine, middle), centre, atol=1e-9)
    assert grid.refined(3).extent_mm == pytest.approx(grid.extent_mm)
    assert np.mean(grid.axes_mm()[2]) == pytest.approx(0, abs=1e-9)


def test_matches_compares_every_corner():
    grid = Grid((10, 20, 30), (1, 1, 1))
    assert grid.matches(Grid((10, 20, 30), (1, 1, 1), (1e-4, 0, 0)))
    assert not grid.matches(Grid((10, 20, 30), (1, 1, 1), (0.01, 0, 0)))
    assert not grid.matches(Grid((10, 20, 30), (1, 1, 1.001)))
    assert not grid.matches(Grid((10, 20, 31), (1, 1, 1)))


@pytest.mark.parametrize(
    "shape, spacing",
    [((0, 1, 1), (1, 1, 1)), ((1, 1), (1, 1, 1)), ((1, 1, 1), (1, 0, 1)), ((1, 1, 1), (1, math.nan, 1))],
)
def test_impossible_grids(shape, spacing):
    with pytest.raises(InputError, match="grid"):
        Grid(shape, spacing)


def test_rays_at_angle_zero_and_a_quarter_turn():
    """At 0 the source is at +y and columns run along +x; after a quarter turn, it is at -x and columns run along +y."""
    geometry = circular(views=4, **DETECTOR)
    source, pixel = geometry.ray(0, 5, 60)
    np.testing.assert_allclose(source, (0, 500, 0), atol=1e-9)
    np.testing.assert_allclose(pixel, (20, -500, 0), atol=1e-9)
    source, pixel = geometry.ray(1, 10, 50)
    np.testing.assert_allclose(source, (-500, 0, 0), atol=1e-9)
    np.testing.assert_allclose(pixel, (500, 0, 20), atol=1e-9)


def test_helix_covers_the_volume_with_the_whole_beam():
    """Beam at the isocenter 22 mm, pitch 1, volume 44 mm: 3 turns of 22 mm, symmetric about the isocenter."""
    geometry = helical(views=301, volume_height_mm=44, pitch=1.0, **DETECTOR)
    assert geometry.feed_per_rotation_mm == pytest.approx(22)
    assert geometry.views / geometry.views_per_rotation == pytest.approx(3)
    assert geometry.source_z_mm.mean() == pytest.approx(0, abs=1e-9)
    assert geometry.source_z_mm[-1] - geometry.source_z_mm[0] == pytest.approx(66 * 300 / 301)
    assert helical(views=301, volume_height_mm=44, pitch=0.5, **DETECTOR).feed_per_rotation_mm == pytest.approx(11)
    assert circular(views=10, **DETECTOR).feed_per_rotation_mm == 0


def test_field_of_view_is_the_cylinder_touched_by_the_outermost_ray():
    geometry = circular(views=1, **DETECTOR)
    half = 101  # mm at the detector, 1000 mm away
    assert geometry.field_of_view_radius_mm == pytest.approx(500 * half / math.hypot(half, 1000))


@pytest.mark.parametrize(
    "changes, message",
    [
        (dict(columns=0), "must be positive"),
        (dict(row_pitch_mm=-1.0), "must be positive"),
        (dict(source_to_detector_mm=400.0), "less than"),
        (dict(source_to_isocentre_mm=0.0), "must be positive"),
    ],
)
def test_impossible_scanners(changes, message):
    with pytest.raises(InputError, match=message):
        circular(views=4, **(DETECTOR | changes))


def test_geometry_is_immutable():
    geometry = circular(views=4, **DETECTOR)
    with pytest.raises(ValueError):
        geometry.angles_rad[0] = 1
    with pytest.raises(InputError, match="one source height for every view"):
        OrbitGeometry(**DETECTOR, angles_rad=np.zeros(3), source_z_mm=np.zeros(2), views_per_rotation=3)
