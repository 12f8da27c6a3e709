"""Volume fractions of shapes against the volumes of solids, and the distance bound behind them."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from virtual_phantom.base.geometry import Grid
from virtual_phantom.phantom.shapes import Ellipsoid, Tube, coverage, fade, window

GRID = Grid((24, 26, 28), (2.0, 1.7, 1.3))


def volume_mm3(shape, grid=GRID) -> float:
    return float(coverage(shape, grid.axes_mm(), grid.spacing, subdivisions=8).sum() * grid.voxel_volume_mm3)


@settings(max_examples=25, deadline=None)
@given(
    centre=st.tuples(*[st.floats(-3, 3)] * 3),
    axes=st.tuples(*[st.floats(4, 12)] * 3),
    turn=st.floats(0, 180),
)
def test_ellipsoid_has_its_volume(centre, axes, turn):
    expected = 4 / 3 * math.pi * math.prod(axes)
    assert volume_mm3(Ellipsoid(centre, axes, turn)) == pytest.approx(expected, rel=0.01)


def test_sphere_between_voxels_keeps_its_volume_and_is_gray_at_the_edge():
    shares = coverage(Ellipsoid((0.4, 0.3, 0.2), (3, 3, 3)), GRID.axes_mm(), GRID.spacing, subdivisions=8)
    assert shares.sum() * GRID.voxel_volume_mm3 == pytest.approx(113.097, rel=0.005)
    assert ((shares > 0.05) & (shares < 0.95)).sum() > 10


def test_tube_is_a_cylinder_with_round_ends():
    tube = Tube(((0, 0, -10), (0, 0, 0), (0, 0, 10)), (3, 3, 3))
    assert volume_mm3(tube) == pytest.approx(math.pi * 9 * 20 + 4 / 3 * math.pi * 27, rel=0.01)


def test_tapered_tube_is_the_hull_of_its_end_spheres_to_first_order():
    # frustum pi h (r^2 + r s + s^2) / 3, and a half sphere at each end, to first order in the slope
    tube = Tube(((0, 0, -10), (0, 0, 10)), (4, 2))
    frustum = math.pi * 20 * (16 + 8 + 4) / 3
    assert volume_mm3(tube) == pytest.approx(frustum + 2 / 3 * math.pi * (64 + 8), rel=0.03)


def test_column_fills_every_slice_equally():
    shares = coverage(Ellipsoid((0, 0, 0), (9, 7, math.inf)), GRID.axes_mm(), GRID.spacing)
    areas = shares.sum(axis=(1, 2)) * 1.7 * 1.3
    assert areas == pytest.approx(np.full(24, math.pi * 63), rel=0.01)


def test_superellipse_has_its_area():
    # |x/a|^4 + |y/b|^4 = 1 encloses 4 a b Gamma(5/4)^2 / Gamma(3/2)
    shares = coverage(Ellipsoid((0, 0, 0), (9, 7, math.inf), exponent=4), GRID.axes_mm(), GRID.spacing)
    expected = 4 * 63 * math.gamma(1.25) ** 2 / math.gamma(1.5)
    assert shares[0].sum() * 1.7 * 1.3 == pytest.approx(expected, rel=0.01)


@settings(max_examples=40, deadline=None)
@given(
    axes=st.tuples(*[st.floats(1, 12)] * 3),
    n=st.floats(2, 6),
    p=st.tuples(*[st.floats(-20, 20)] * 3),
    q=st.tuples(*[st.floats(-20, 20)] * 3),
)
def test_level_never_exceeds_the_distance(axes, n, p, q):
    """The level changes by no more than the distance moved: its magnitude is a lower bound of the distance."""
    for shape in (
        Ellipsoid((1, 2, 3), axes, 30, n),
        Tube(((0, 0, -5), (1, 4, 5)), (axes[0] / 3, axes[1] / 3)),
    ):
        walked = math.dist(p, q)
        changed = abs(float(shape.level(*p[::-1])) - float(shape.level(*q[::-1])))
        assert changed <= walked * (1 + 1e-9) + 1e-9
        assert changed <= shape.change(tuple(abs(a - b) for a, b in zip(p[::-1], q[::-1], strict=True))) + 1e-9


def test_rotation_is_counterclockwise_seen_from_above():
    shape = Ellipsoid((0, 0, 0), (10, 2, 2), rotation_deg=45)
    assert shape.level(0, 5, 5) < 0 < shape.level(0, -5, 5)


def test_window_contains_the_whole_shape():
    shape = Ellipsoid((3, -4, 5), (5, 9, 4), 25)
    whole = coverage(shape, GRID.axes_mm(), GRID.spacing)
    box = window(shape, GRID.axes_mm(), GRID.spacing)
    part = tuple(axis[extent] for axis, extent in zip(GRID.axes_mm(), box, strict=True))
    np.testing.assert_array_equal(coverage(shape, part, GRID.spacing), whole[box])
    assert whole.sum() == whole[box].sum()


def test_fade_rises_from_surface_to_width():
    weight = fade(Ellipsoid((0, 0, 0), (10, 10, 10)), tuple(np.array([v]) for v in (0.0, 0.0, 7.5)), 5)
    assert weight.item() == pytest.approx(0.5)  # halfway: a smooth step is symmetric


@pytest.mark.parametrize(
    "make",
    [
        lambda: Ellipsoid((0, 0), (1, 1, 1)),
        lambda: Ellipsoid((0, 0, 0), (1, 0, 1)),
        lambda: Ellipsoid((0, 0, 0), (1, 1, 1), exponent=1),
        lambda: Tube(((0, 0, 0),), (1,)),
        lambda: Tube(((0, 0, 0), (1, 1, 1)), (1,)),
    ],
)
def test_impossible_shapes_are_rejected(make):
    with pytest.raises(ValueError):
        make()
