"""Cylindrical detectors and flying focal spots:

shapes and voxels against exact chords, on independently calculated rays.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from test_cpu import ellipsoid_coverage

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, circular, helical, parallel_beam
from virtual_phantom.physics.scenes.shapes import ShapesScene, cylinder, ellipsoid
from virtual_phantom.projectors.cpu import CpuProjector

RADIUS, DISTANCE = 570.0, 1040.0
SCANNER = dict(source_to_isocentre_mm=RADIUS, source_to_detector_mm=DISTANCE)
ARC = dict(SCANNER, surface="cylindrical", columns=64, rows=6, column_pitch_mm=8.0, row_pitch_mm=6.0)
SPOTS = {
    "resting": ((0.0, 0.0, 0.0),),
    "in the plane": ((-1.3, 0.0, 0.0), (1.3, 0.0, 0.0)),
    "along z": ((0.0, 4.0, -0.7), (0.0, -4.0, 0.7)),
    "both": ((-1.3, 4.0, -0.7), (1.3, 4.0, -0.7), (-1.3, -4.0, 0.7), (1.3, -4.0, 0.7)),
}
CENTRE, HALF_AXES = (18.0, -12.0, 3.0), (80.0, 55.0, 25.0)


def helix(spots="resting", **changes):
    detector = ARC | dict(spots_mm=SPOTS[spots], column_offset_px=0.25, row_offset_px=-0.4) | changes
    return helical(views=9, volume_height_mm=40.0, start_angle_rad=0.3, **detector)


def by_hand(geometry, spots=((0.0, 0.0, 0.0),), focus_mm=None):
    """Sources (views, 1, 1, 3) and pixels (views, rows, columns, 3), in polar coordinates about the axis and the focus.

    focus_mm    distance from the focus to the arc; None: the focus is the focal center
    """
    focus_mm = geometry.source_to_detector_mm if focus_mm is None else focus_mm
    sources, pixels = [], []
    for view in range(geometry.views):
        b, z = geometry.angles_rad[view], geometry.source_z_mm[view]
        along, away, up = spots[view % len(spots)]
        out = geometry.source_to_isocentre_mm + away
        sources.append([-out * math.sin(b) + along * math.cos(b), out * math.cos(b) + along * math.sin(b), z + up])
        columns = np.arange(geometry.columns) - (geometry.columns - 1) / 2 + geometry.column_offset_px
        fan = columns * geometry.column_pitch_mm / focus_mm
        v = (np.arange(geometry.rows) - (geometry.rows - 1) / 2 + geometry.row_offset_px) * geometry.row_pitch_mm
        off = geometry.source_to_isocentre_mm - (geometry.source_to_detector_mm - focus_mm)
        # From the focus at polar angle b, the ray at fan angle g runs along (sin(b + g), -cos(b + g)).
        x = -off * math.sin(b) + focus_mm * np.sin(b + fan)
        y = off * math.cos(b) - focus_mm * np.cos(b + fan)
        pixels.append(np.stack(np.broadcast_arrays(x, y, z + v[:, None]), axis=-1))
    return np.array(sources)[:, None, None], np.array(pixels)


def chords(sources, pixels, matrix, centre):
    """Exact lengths in mm within `(x - centre) . matrix (x - centre) = 1`."""
    way = pixels - sources
    start = sources - np.asarray(centre)
    a, half = (np.einsum("...i,ij,...j->...", way, matrix, other) for other in (way, np.broadcast_to(start, way.shape)))
    c = np.einsum("...i,ij,...j->...", start, matrix, start) - 1
    root = np.maximum(half**2 - a * c, 0)
    return 2 * np.sqrt(root) / a * np.linalg.norm(way, axis=-1)


ELLIPSOID = np.diag(1 / np.square(HALF_AXES))
AXIS = np.array([0.3, -0.2, 1.0]) / np.linalg.norm([0.3, -0.2, 1.0])
ROD = (np.eye(3) - np.outer(AXIS, AXIS)) / 30.0**2


@pytest.mark.parametrize("spots", SPOTS)
@pytest.mark.parametrize("focus_mm", [None, 900.0])
def test_path_lengths_of_shapes_are_their_chords(spots, focus_mm):
    geometry = helix(spots, arc_radius_mm=focus_mm)
    rays = by_hand(geometry, SPOTS[spots], focus_mm)
    ball = ShapesScene([ellipsoid("water", CENTRE, HALF_AXES)]).path_lengths(geometry)[0]
    exact = chords(*rays, ELLIPSOID, CENTRE)
    assert exact.max() > 100
    np.testing.assert_allclose(ball, exact, atol=1e-5 * exact.max())
    rod = ShapesScene([cylinder("water", (-9.0, 4.0, 0.0), 30.0, axis=AXIS)]).path_lengths(geometry)[0]
    exact = chords(*rays, ROD, (-9.0, 4.0, 0.0))
    np.testing.assert_allclose(rod, exact, atol=1e-5 * exact.max())


@pytest.mark.parametrize("spots", SPOTS)
def test_rays_equal_the_calculated_ones(spots):
    geometry = helix(spots)
    sources, pixels = by_hand(geometry, SPOTS[spots])
    for one in (geometry, geometry.by_vectors(), geometry.turned(0.7).by_vectors().turned(-0.7)):
        for place in ((0, 0, 0), (1, 3, 63), (4, 5, 20), (7, 2, 31)):
            source, pixel = one.ray(*place)
            np.testing.assert_allclose(source, sources[place[0], 0, 0], atol=1e-9)
            np.testing.assert_allclose(pixel, pixels[place], atol=1e-9)


def voxel_errors(geometry, exact, voxel):
    """Error of a voxel projector relative to the longest chord."""
    size = [int(2 * (half + 20) / voxel) for half in HALF_AXES[::-1]]
    grid = Grid(tuple(size), (voxel, voxel, voxel))
    projector = CpuProjector(geometry, grid)
    volume = ellipsoid_coverage(grid, CENTRE, HALF_AXES, samples=4)[None]
    found = projector.unpack_projections(projector.forward(projector.pack_volume(volume)))[0]
    return (found - exact) / exact.max()


def test_voxels_converge_to_the_chords():
    """Half the voxel size gives less than half the error, and no error of a flat detector or a resting spot."""
    geometry = helix("both")
    exact = chords(*by_hand(geometry, SPOTS["both"]), ELLIPSOID, CENTRE)
    coarse, fine = (voxel_errors(geometry, exact, voxel) for voxel in (4.0, 2.0))
    sizes = [np.sqrt(np.mean(one**2)) for one in (coarse, fine)]
    assert sizes[0] < 0.02 and sizes[1] < 0.5 * sizes[0]  # as large as with a flat detector, in rays at the edge
    flat = chords(*by_hand(geometry, SPOTS["both"], focus_mm=1e7), ELLIPSOID, CENTRE)
    resting = chords(*by_hand(geometry), ELLIPSOID, CENTRE)
    for other in (flat, resting):
        wrong = (other - exact) / exact.max()
        assert abs(np.vdot(fine, wrong) / np.vdot(wrong, wrong)) < 0.2


@pytest.mark.parametrize("lanes", [1, 16])
def test_adjoint_is_the_transpose(lanes):
    geometry, grid = helix("both"), Grid((12, 30, 28), (4.0, 5.0, 5.0))
    projector = CpuProjector(geometry, grid, lanes)
    random = np.random.default_rng(1)
    volume = random.random((lanes, *grid.shape), dtype=np.float32)
    rays = random.random((lanes, *geometry.shape), dtype=np.float32)
    forward = projector.unpack_projections(projector.forward(projector.pack_volume(volume)))
    adjoint = projector.unpack_volume(projector.adjoint(projector.pack_projections(rays)))
    for lane in range(lanes):
        one, other = np.vdot(forward[lane], rays[lane]), np.vdot(volume[lane], adjoint[lane])
        assert one == pytest.approx(other, rel=1e-5)


@pytest.mark.parametrize("focus_mm", [None, 900.0])
def test_voxels_are_interpolated_where_their_rays_meet_the_arc(focus_mm):
    """Back-projection of projections that are linear in column and row, against the definition."""
    geometry, grid = (
        helix("both", arc_radius_mm=focus_mm, rows=40, turns=1.0, pitch=0.1),
        Grid((4, 9, 8), (4.0, 20.0, 20.0)),
    )
    arc = focus_mm or DISTANCE
    projector = CpuProjector(geometry, grid)
    columns, rows = np.meshgrid(np.arange(64.0), np.arange(40.0))
    for axis, values in (("column", columns), ("row", rows)):
        stack = np.broadcast_to(values + 1, geometry.shape)[None].astype(np.float32)
        back = projector.unpack_volume(projector.back(projector.pack_projections(stack)))[0]
        sources, _ = by_hand(geometry, SPOTS["both"])
        expected = np.zeros(grid.shape)
        z, y, x = np.meshgrid(*grid.axes_mm(), indexing="ij")
        for view, source in enumerate(sources[:, 0, 0]):
            b = geometry.angles_rad[view]
            way = np.stack([x, y, z], axis=-1) - source
            focus = (RADIUS - DISTANCE + arc) * np.array([-math.sin(b), math.cos(b)])
            low, high = np.ones(grid.shape), np.full(grid.shape, 5.0)
            for _ in range(60):  # exit of the ray from the circle
                middle = (low + high) / 2
                beyond = np.hypot(*np.moveaxis(source[:2] + middle[..., None] * way[..., :2] - focus, -1, 0)) > arc
                low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
            place = source + low[..., None] * way
            fan = np.arctan2(place[..., 0] - focus[0], -(place[..., 1] - focus[1])) - b
            fan = (fan + np.pi) % (2 * np.pi) - np.pi
            up = place[..., 2] - geometry.source_z_mm[view]
            there = {
                "column": fan * arc / geometry.column_pitch_mm + 31.5 - geometry.column_offset_px,
                "row": up / geometry.row_pitch_mm + 19.5 - geometry.row_offset_px,
            }
            assert (
                min(one.min() for one in there.values()) > 0 and there["row"].max() < 39 and there["column"].max() < 63
            )
            depth = RADIUS + SPOTS["both"][view % 4][1]
            expected += (there[axis] + 1) * (depth / np.hypot(way[..., 0], way[..., 1])) ** 2
        np.testing.assert_allclose(back, expected, rtol=2e-4)


def test_very_long_arc_equals_a_flat_detector():
    flat = circular(views=5, **(ARC | dict(surface="flat")))
    arc = replace(flat, surface="cylindrical", arc_radius_mm=1e7)
    scene = ShapesScene([ellipsoid("water", CENTRE, HALF_AXES)])
    np.testing.assert_allclose(scene.path_lengths(arc), scene.path_lengths(flat), atol=1e-2)
    np.testing.assert_allclose(arc.solid_angles(), flat.solid_angles(), rtol=1e-3)
    np.testing.assert_allclose(arc.field_of_view_radius_mm, flat.field_of_view_radius_mm, rtol=1e-3)


def test_arc_about_the_source_is_uniformly_lit_along_its_columns():
    geometry = circular(views=5, **ARC)
    angles = geometry.solid_angles()
    assert angles.shape == (1, 6, 64)
    v = geometry.row_positions_mm()
    np.testing.assert_allclose(angles[0], np.broadcast_to((1 + (v / DISTANCE) ** 2)[:, None] ** -1.5, (6, 64)))


def test_parallel_beam_has_parallel_chords():
    geometry = circular(
        views=7, **parallel_beam(), columns=64, rows=6, column_pitch_mm=4.0, row_pitch_mm=4.0, column_offset_px=0.25
    )
    found = ShapesScene([ellipsoid("water", CENTRE, HALF_AXES)]).path_lengths(geometry)[0]
    angle = geometry.angles_rad[:, None, None]
    along = np.stack([np.sin(angle), -np.cos(angle), 0 * angle], axis=-1)
    others = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    pixels = geometry.column_positions_mm()[:, None] * others + geometry.row_positions_mm()[:, None, None] * [0, 0, 1.0]
    exact = chords(pixels - along * 500, pixels + along * 500, ELLIPSOID, CENTRE)
    inside = exact > 0.1 * exact.max()
    np.testing.assert_allclose(found[inside], exact[inside], atol=1e-5 * exact.max())
    assert geometry.magnification == pytest.approx(1, abs=2e-6)
    assert np.sqrt(np.mean(voxel_errors(geometry, exact, 4.0) ** 2)) < 0.02


def test_every_nth_view_keeps_its_focal_spot():
    geometry = helix("both")
    for step in (2, 3, 4, 5):
        some = geometry.every(step)
        np.testing.assert_allclose(some.source_mm, geometry.source_mm[::step])
        np.testing.assert_allclose(some.toward_mm, geometry.toward_mm[::step])


@pytest.mark.parametrize(
    "changes, message",
    [
        (dict(surface="spherical"), "surface is flat or cylindrical, not 'spherical'"),
        (dict(surface="flat", arc_radius_mm=1000.0), "arc_radius_mm is the radius of a cylindrical detector"),
        (dict(arc_radius_mm=100.0), "more than half a circle of arc_radius_mm 100"),
        (dict(spots_mm=((0.0, 0.0),)), "three lengths for each focal spot"),
        (dict(spots_mm=((0.0, 400.0, 0.0),)), "focal spot 400 mm from the focal center"),
        (dict(spots_mm=((0.0, 0.0, math.nan),)), "focal spot nan mm"),
    ],
)
def test_impossible_arcs_and_spots(changes, message):
    with pytest.raises(InputError, match=message):
        circular(views=9, **(ARC | changes))


@pytest.mark.parametrize("beam", [{}, parallel_beam() | {"surface": "flat"}], ids=["arc", "parallel"])
def test_astra_supports_no_arcs_and_no_parallel_beams(beam):
    from virtual_phantom.projectors.astra_cuda import AstraCudaProjector

    message = "SIRT on astra_cuda needs flat detectors and divergent beams; set engine: cpu"
    with pytest.raises(InputError, match=message):
        AstraCudaProjector(circular(views=9, **(ARC | beam)), Grid((2, 2, 2), (1.0, 1.0, 1.0)), arrays=np)
    vectors = circular(views=9, **(ARC | {"surface": "flat"})).by_vectors()
    AstraCudaProjector(vectors, Grid((2, 2, 2), (1.0, 1.0, 1.0)), arrays=np)
