"""Scenes in scans given by vectors: equal to their circle, and rolled and tilted detectors against closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scanner import SCANNER

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.physics.scenes.posed import PosedScene
from virtual_phantom.physics.scenes.prism import PrismScene
from virtual_phantom.physics.scenes.sampling import displace_source
from virtual_phantom.physics.scenes.scene import Pose, VoxelScene
from virtual_phantom.physics.scenes.shapes import DiscScene
from virtual_phantom.projectors.cpu import CpuProjector

DETECTOR = dict(**SCANNER, columns=41, rows=9, column_pitch_mm=4.0, row_pitch_mm=10.0, column_offset_px=0.3)
GEOMETRY = circular(views=5, start_angle_rad=0.3, **DETECTOR)
PLACED = Pose(x_mm=3.0, y_mm=-2.0, z_mm=1.0, turn_deg=20.0)
MOTION = np.linspace(-1, 1, 15).reshape(5, 3)


def rolled(geometry, roll, tilt=0.0):
    """Rotate the detector about its normal and then about its columns, through the reference point."""
    columns, rows, normal = geometry.column_direction, geometry.row_direction, geometry.normal
    along = math.cos(roll) * columns + math.sin(roll) * rows
    up = math.cos(roll) * rows - math.sin(roll) * columns
    up = math.cos(tilt) * up + math.sin(tilt) * normal
    return replace(geometry.by_vectors(), column_direction=along, row_direction=up)


def ball(radius, grid):
    """Volume fraction of every voxel in a ball at the isocenter."""
    z, y, x = grid.refined(4).axes_mm()
    inside = np.sqrt(x**2 + y[:, None] ** 2 + z[:, None, None] ** 2) <= radius
    nz, ny, nx = grid.shape
    return inside.reshape(nz, 4, ny, 4, nx, 4).mean((1, 3, 5)).astype(np.float32)


def chords(geometry, centre, radius):
    """Length of every ray inside a ball, [view, row, column]."""
    result = np.zeros(geometry.shape)
    for place in np.ndindex(geometry.shape):
        source, pixel = geometry.ray(*place)
        way = (pixel - source) / np.linalg.norm(pixel - source)
        off = np.linalg.norm(np.cross(source - centre, way))
        result[place] = 2 * math.sqrt(max(radius**2 - off**2, 0))
    return result


@pytest.fixture(scope="module")
def scene():
    grid = Grid((32, 32, 32), (2.0, 2.0, 2.0))
    return VoxelScene(ball(25.0, grid)[None], grid, ("water",), 60.0)


@pytest.mark.parametrize("motion", [None, MOTION], ids=["still", "moving"])
def test_circle_given_by_vectors_equals_the_circle(scene, motion):
    share = np.pad(np.ones((30, 20)), 5)
    others = (PrismScene(share[None], Grid((1, 40, 30), (1.0, 1.0, 1.0)), ("pmma",)), DiscScene(40.0, "pmma"))
    for one in (scene, *others):
        expected = one.path_lengths(GEOMETRY, PLACED, motion)
        found = one.path_lengths(GEOMETRY.by_vectors(), PLACED, motion)
        assert expected.max() > 15
        np.testing.assert_allclose(found, expected, atol=2e-6 * expected.max())


def test_both_kernels_give_equal_path_lengths(scene):
    """The kernel for any rays and the kernels for upright detectors agree to rounding."""
    rays = scene.rays(GEOMETRY, PLACED, MOTION)
    to, rows = rays.bundles, GEOMETRY.rows
    for row in range(rows):
        one = replace(rays, bundles=to._replace(rows_mm=to.rows_mm[row : row + 1]))
        found = scene._voxels.path_lengths(one)[:, :, 0]
        expected = scene.path_lengths(GEOMETRY, PLACED, MOTION)[:, :, row]
        np.testing.assert_allclose(found, expected, atol=5e-6 * 50)


@pytest.mark.parametrize("roll, tilt", [(0.0, 0.0), (0.2, 0.0), (-1.0, 0.0), (0.3, 0.4)])
def test_ball_on_a_rolled_and_tilted_detector(scene, roll, tilt):
    """Within a few hundredths of the diameter for long chords, and zero for rays that miss the ball."""
    geometry = rolled(GEOMETRY, roll, tilt)
    assert geometry.is_upright == (roll == tilt == 0)
    exact = chords(geometry, [3.0, -2.0, 1.0], 25.0)
    found = scene.path_lengths(geometry, PLACED)[0]
    inner = exact > 25
    assert inner.sum() > 100
    assert np.sqrt(np.mean((found - exact)[inner] ** 2)) < 0.3
    assert found[chords(geometry, [3.0, -2.0, 1.0], 31.0) == 0].max() == 0  # voxels, and two more for interpolation


def test_displaced_rays_on_a_rolled_detector(scene):
    geometry = rolled(GEOMETRY, 0.3, 0.1)
    posed = PosedScene(scene).linearized_at([(geometry, Pose(), None)])
    start = posed.path_lengths(geometry)
    near = Pose(x_mm=0.004, y_mm=-0.003, z_mm=0.002, turn_deg=0.001)
    followed, retraced = posed.path_lengths(geometry, near), scene.path_lengths(geometry, near)
    changed = np.abs(retraced - start).max()
    assert changed > 1e-3 and not np.array_equal(followed, retraced)
    assert np.sqrt(np.mean((followed - retraced) ** 2)) < 0.05 * np.sqrt(np.mean((retraced - start) ** 2))


def test_jittering_source(scene):
    """Sources off the circle keep the detector upright: the CPU engine against chords."""
    vectors = GEOMETRY.by_vectors()
    random = np.random.default_rng(3)
    jittered = replace(vectors, source_mm=vectors.source_mm + random.uniform(-20, 20, (5, 3)))
    exact, still = chords(jittered, [0.0, 0.0, 0.0], 25.0), chords(vectors, [0.0, 0.0, 0.0], 25.0)
    found = scene.path_lengths(jittered)[0]
    inner = exact > 25
    assert np.abs(exact - still)[inner].max() > 3
    assert np.sqrt(np.mean((found - exact)[inner] ** 2)) < 0.3


def test_transpose_with_vectors():
    """<A x, y> = <x, A' y> with sources that jitter."""
    vectors = GEOMETRY.by_vectors()
    random = np.random.default_rng(4)
    geometry = replace(vectors, source_mm=vectors.source_mm + random.uniform(-20, 20, (5, 3)))
    projector = CpuProjector(geometry, Grid((9, 20, 22), (4.0, 4.0, 4.0)))
    x = projector.pack_volume(random.random((1, 9, 20, 22), np.float32))
    y = projector.pack_projections(random.random((1, *geometry.shape), np.float32))
    left = np.vdot(projector.forward(x).astype(float), y.astype(float))
    assert left == pytest.approx(np.vdot(x.astype(float), projector.adjoint(y).astype(float)), rel=1e-5)


def test_focal_spot_follows_the_axes_of_a_rolled_detector():
    geometry = rolled(GEOMETRY, 0.3, 0.1)
    moved = displace_source(geometry, 2.0, -1.0, 0.5)
    by = moved.source_mm - geometry.source_mm
    for axis, far in ((geometry.column_direction, 2.0), (geometry.row_direction, -1.0), (geometry.normal, -0.5)):
        np.testing.assert_allclose((by * axis).sum(axis=1), far, atol=1e-9)
    np.testing.assert_array_equal(moved.detector_mm, geometry.detector_mm)


def test_unsupported_geometries_are_rejected():
    geometry = rolled(GEOMETRY, 0.1)
    with pytest.raises(InputError, match="engine cpu needs detector rows along z"):
        CpuProjector(geometry, Grid((4, 4, 4), (1.0, 1.0, 1.0)))
