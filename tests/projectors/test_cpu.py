"""The CPU engine against analytic line integrals, ASTRA's 2D projector, and its own transpose."""

import math
import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from one_alone import CASES, projected
from scanner import SCANNER

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, circular, helical
from virtual_phantom.projectors.cpu import CpuProjector


def all_rays(geometry):
    """Source and pixel of every ray, mm, each [view, row, column, xyz]."""
    rays = np.array([geometry.ray(*pixel) for pixel in np.ndindex(geometry.views, geometry.rows, geometry.columns)])
    return np.moveaxis(rays.reshape(geometry.views, geometry.rows, geometry.columns, 2, 3), 3, 0)


def ellipsoid_chords(rays, centre, semi_axes):
    """Exact length of every ray inside an ellipsoid, mm, [view, row, column]."""
    (source, pixel), scale = rays, 1 / np.asarray(semi_axes)
    start, direction = (source - centre) * scale, (pixel - source) * scale
    a, b, c = (direction**2).sum(-1), (start * direction).sum(-1), (start**2).sum(-1) - 1
    return 2 * np.sqrt(np.maximum(b * b - a * c, 0)) / a * np.linalg.norm(pixel - source, axis=-1)


@cache
def ellipsoid_coverage(grid, centre, semi_axes, samples=6):
    """Volume fraction of every voxel in an ellipsoid, by sub-sampling."""
    x, y, z = (
        ((axis - middle) / semi_axis) ** 2
        for axis, middle, semi_axis in zip(grid.refined(samples).axes_mm()[::-1], centre, semi_axes, strict=True)
    )
    (nz, ny, nx), across = grid.shape, x + y[:, None]
    counts = (sum(across + height <= 1 for height in heights) for heights in z.reshape(nz, samples))
    return np.float32([count.reshape(ny, samples, nx, samples).mean((1, 3)) for count in counts]) / np.float32(samples)


@pytest.mark.parametrize(
    "make",
    [
        lambda detector: circular(views=5, start_angle_rad=0.3, **detector),
        lambda detector: helical(views=7, volume_height_mm=80, pitch=1.0, **detector),
    ],
    ids=["circular", "helical"],
)
def test_line_integrals_of_an_ellipsoid(make):
    """Relative error at most 0.3 % rms over chords longer than half the longest, on 128 x 128."""
    geometry = make(dict(SCANNER, columns=60, rows=12, column_pitch_mm=9.0, row_pitch_mm=9.0))
    grid = Grid((40, 128, 128), (2.0, 2.0, 2.0))
    centre, semi_axes = (18.0, -12.0, 3.0), (80.0, 55.0, 30.0)
    projector = CpuProjector(geometry, grid)
    measured = projector.unpack_projections(
        projector.forward(projector.pack_volume(ellipsoid_coverage(grid, centre, semi_axes)[None]))
    )[0]
    rays = all_rays(geometry)
    exact = ellipsoid_chords(rays, centre, semi_axes)
    long = exact > exact.max() / 2
    assert long.sum() > 100
    assert np.sqrt(np.mean((measured[long] / exact[long] - 1) ** 2)) < 0.003
    # A ray that misses by more than two voxels has no signal.
    assert measured[ellipsoid_chords(rays, centre, np.add(semi_axes, 6.0)) == 0].max() == 0


@pytest.mark.parametrize("turn", [0, 1, 2, 3])
def test_ball_appears_at_the_position_that_the_frame_defines(turn):
    """A ball at +x appears in the high columns from +y (angle 0); one above the isocenter, in the high rows."""
    angle = turn * math.pi / 2
    geometry = circular(
        views=1, start_angle_rad=angle, columns=101, rows=51, column_pitch_mm=4.0, row_pitch_mm=4.0, **SCANNER
    )
    grid = Grid((40, 100, 100), (2.0, 2.0, 2.0))
    centre = (30.0, 10.0, 20.0)
    projector = CpuProjector(geometry, grid)
    image = projector.unpack_projections(
        projector.forward(projector.pack_volume(ellipsoid_coverage(grid, centre, (4, 4, 4), 4)[None]))
    )[0, 0]
    weight = image / image.sum()
    depth = 500 + centre[0] * math.sin(angle) - centre[1] * math.cos(angle)
    column = (centre[0] * math.cos(angle) + centre[1] * math.sin(angle)) * 1000 / depth
    row = centre[2] * 1000 / depth
    assert weight.sum(0) @ geometry.column_positions_mm() == pytest.approx(column, abs=0.3)
    assert weight.sum(1) @ geometry.row_positions_mm() == pytest.approx(row, abs=0.3)


# Other tests use the same numbers of lanes: each has its own kernels, which take 7 s to compile.
@pytest.mark.parametrize("lanes", [1, 3, 16])
def test_adjoint(lanes):
    """<A x, y> = <x, A' y>, for an off-center helical scan and three voxel sizes."""
    geometry = helical(
        views=9,
        volume_height_mm=60,
        columns=37,
        rows=15,
        column_pitch_mm=9.0,
        row_pitch_mm=7.0,
        column_offset_px=0.3,
        row_offset_px=-0.2,
        **SCANNER,
    )
    grid = Grid((17, 33, 40), (3.5, 6.0, 5.0))
    random = np.random.default_rng(5)
    projector = CpuProjector(geometry, grid, lanes)
    x = projector.pack_volume(random.random((lanes, *grid.shape), dtype=np.float32))
    y = projector.pack_projections(random.random((lanes, 9, 15, 37), dtype=np.float32))
    forward, back = projector.forward(x), projector.adjoint(y)
    for lane in range(lanes):
        left = np.vdot(forward[..., lane].astype(float), y[..., lane].astype(float))
        right = np.vdot(x[..., lane].astype(float), back[..., lane].astype(float))
        assert left == pytest.approx(right, rel=1e-5)


def test_lanes_are_independent():
    geometry = circular(views=4, columns=40, rows=8, column_pitch_mm=10.0, row_pitch_mm=10.0, **SCANNER)
    grid = Grid((8, 32, 32), (6.0, 8.0, 8.0))
    stack = np.random.default_rng(1).random((3, *grid.shape), dtype=np.float32)
    many = CpuProjector(geometry, grid, 3)
    together = many.forward(many.pack_volume(stack))
    back = many.unpack_volume(many.back(together))
    one = CpuProjector(geometry, grid, 1)
    for lane in range(3):
        alone = one.forward(one.pack_volume(stack[lane : lane + 1]))
        np.testing.assert_allclose(many.unpack_projections(together)[lane], one.unpack_projections(alone)[0], rtol=2e-6)
        np.testing.assert_allclose(back[lane], one.unpack_volume(one.back(alone))[0], rtol=2e-6)


@pytest.mark.parametrize("case", CASES)
def test_single_lane_equals_several_lanes(case):
    """A single lane has its own kernels, which depend on the density of rows and slices on some processors."""
    for alone, together in zip(projected(case, 1), projected(case, 3), strict=True):
        assert together.any()
        np.testing.assert_allclose(alone, together, atol=3e-6 * together.max())


@pytest.mark.parametrize("centre_mm", [(0.0, 0.0, 0.0), (3.1, -4.7, 1.2)])
def test_tiles_of_any_width_take_every_sample(centre_mm):
    """One and three lanes have wider tiles than 16: no sample is lost at a border, along the axes or between them."""
    grid = Grid((3, 130, 67), (4.0, 2.0, 3.0))
    geometry = circular(views=8, columns=70, rows=5, column_pitch_mm=9.0, row_pitch_mm=8.0, **SCANNER)
    volume = np.random.default_rng(6).random(grid.shape, np.float32)
    found = []
    for lanes in (1, 3, 16):
        projector = CpuProjector(geometry, grid, lanes, centre_mm=centre_mm)
        lines = projector.forward(projector.pack_volume(np.repeat(volume[None], lanes, 0)))
        images = (projector.back(lines), projector.adjoint(lines))
        found.append(
            [projector.unpack_projections(lines)[-1], *(projector.unpack_volume(image)[-1] for image in images)]
        )
    for one, *others in zip(*found, strict=True):
        assert one.any()
        for other in others:
            np.testing.assert_allclose(other, one, atol=1e-5 * one.max())


def test_nothing_is_read_or_written_beyond_arrays():
    """Sixteen values at once extend beyond a line. Every array lies between protected pages."""
    script = Path(__file__).with_name("between_guards.py")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, script], env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]
    assert int(done.stdout.split()[0]) >= 40


def test_voxel_driven_back_projection_weights_rays_by_their_density():
    """Along the central ray it equals the transpose to 2 %, at any distance from the source, except for a constant:

    the voxel divided by the pixel at the isocenter.
    """
    grid = Grid((5, 60, 60), (4.0, 5.0, 5.0))
    geometry = circular(views=1, columns=360, rows=60, column_pitch_mm=2.0, row_pitch_mm=2.0, **SCANNER)
    projector = CpuProjector(geometry, grid)
    ones = projector.pack_projections(np.ones((1, 1, 60, 360), np.float32))
    middle = np.s_[0, 2, :, 26:34]
    exact, back = (projector.unpack_volume(each(ones))[middle] for each in (projector.adjoint, projector.back))
    exact, back = (one.reshape(6, -1).mean(1) for one in (exact, back))
    np.testing.assert_allclose(4.0 * 5.0 * 5.0 / (2.0 * 2.0 / 4) * back, exact, rtol=0.02)
    assert exact.max() > 2 * exact.min()


def test_view_blocks_and_threads_do_not_change_the_result():
    geometry = helical(
        views=11, volume_height_mm=48, columns=40, rows=8, column_pitch_mm=10.0, row_pitch_mm=10.0, **SCANNER
    )
    grid = Grid((8, 32, 32), (6.0, 8.0, 8.0))
    stack = np.random.default_rng(2).random((3, *grid.shape), dtype=np.float32)
    whole = CpuProjector(geometry, grid, 3)
    volume = whole.pack_volume(stack)
    expected = whole.forward(volume)
    threaded = CpuProjector(geometry, grid, 3, threads=3)
    np.testing.assert_array_equal(threaded.forward(volume), expected)
    np.testing.assert_array_equal(threaded.back(expected), whole.back(expected))
    blocks = [slice(0, 4), slice(4, 8), slice(8, 11)]
    np.testing.assert_array_equal(np.concatenate([whole.forward(volume, block) for block in blocks]), expected)
    summed = whole.empty_volume()
    for block in blocks:
        whole.back(expected[block], block, out=summed)
    np.testing.assert_allclose(summed, whole.back(expected), rtol=1e-5, atol=1e-3)


def test_central_slice_agrees_with_astra_fan_beam():
    """ASTRA's 2D CPU fan-beam projector ('line_fanflat', exact intersection lengths) to 0.5 % of the mean."""
    astra = pytest.importorskip("astra")
    n, spacing, columns, pitch = 128, 2.0, 120, 4.0
    grid = Grid((3, n, n), (spacing,) * 3)
    angles = np.linspace(0, 2 * np.pi, 12, endpoint=False) + 0.1
    geometry = circular(
        views=12, start_angle_rad=0.1, columns=columns, rows=1, column_pitch_mm=pitch, row_pitch_mm=1.0, **SCANNER
    )
    image = ellipsoid_coverage(grid, (10.0, -20.0, 0.0), (90.0, 70.0, 1e6))[1]
    image = image + 0.5 * ellipsoid_coverage(grid, (-30.0, 10.0, 0.0), (25.0, 20.0, 1e6))[1]
    projector = CpuProjector(geometry, grid)
    actual = projector.unpack_projections(projector.forward(projector.pack_volume(np.stack([image] * 3)[None])))[
        0, :, 0
    ]

    # ASTRA's rows run downwards: row 0 is at +y.
    volume = astra.create_vol_geom(n, n, -n * spacing / 2, n * spacing / 2, -n * spacing / 2, n * spacing / 2)
    source = np.stack([-np.sin(angles), np.cos(angles)], 1) * 500
    centre = np.stack([np.sin(angles), -np.cos(angles)], 1) * 500
    step = np.stack([np.cos(angles), np.sin(angles)], 1) * pitch
    projections = astra.create_proj_geom("fanflat_vec", columns, np.concatenate([source, centre, step], 1))
    projector_id = astra.create_projector("line_fanflat", projections, volume)
    data_id, theirs = astra.create_sino(image[::-1].copy(), projector_id)
    astra.data2d.delete(data_id)
    astra.projector.delete(projector_id)
    inside = theirs > theirs.max() / 4
    error = np.sqrt(np.mean((actual - theirs)[inside] ** 2)) / theirs[inside].mean()
    assert error < 0.005


def test_grid_that_contains_the_source_is_rejected():
    geometry = circular(views=4, columns=8, rows=8, column_pitch_mm=1.0, row_pitch_mm=1.0, **SCANNER)
    with pytest.raises(InputError, match="outside the source's orbit"):
        CpuProjector(geometry, Grid((8, 100, 100), (8.0, 8.0, 8.0)))
