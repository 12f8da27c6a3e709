"""Means over pixels that see the edge of a shape, against many rays per pixel."""

from dataclasses import replace

import numpy as np
import pytest

from virtual_phantom.base.geometry import circular, parallel_beam
from virtual_phantom.base.mounting import Mounting
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.effect import checked
from virtual_phantom.physics.scenes import edges
from virtual_phantom.physics.scenes.scene import Pose
from virtual_phantom.physics.scenes.shapes import NOTHING, ShapesScene, box, cone, cylinder, ellipsoid

GEOMETRY = circular(
    views=2,
    start_angle_rad=0.4,
    source_to_isocentre_mm=600.0,
    source_to_detector_mm=1100.0,
    columns=60,
    rows=5,
    column_pitch_mm=6.0,
    row_pitch_mm=4.0,
    view_interval_ms=20.0,
)
POSE = Pose(0.3, -0.2, 0.4, 3.0, 1.001)
CURVED = (
    cylinder("water", (0, 0, 0), 93.0),
    cylinder(NOTHING, (-29.0, -53.0, 0), 14.0),
    cylinder("aluminium", (-41.0, -19.0, 0), 6.3),
    ellipsoid("bone", (8.0, 54.0, 1.6), (5.1, 6.0, 4.0), 20.0),
)
CUT = (
    cylinder("water", (0, 0, 1.0), 80.0, 10.0),
    box("pmma", (20.0, -14.0, 1.0), (30.0, 20.0, 5.0), 20.0),
    cone("aluminium", (-20.0, -40.0, -3.0), 10.0, 2.0, 6.0),
    cylinder("bone", (30.0, 38.0, 1.0), 7.0, 6.0, (1.0, 0.3, 0.2)),
)
GEOMETRIES = {
    "flat": GEOMETRY,
    "arc": replace(GEOMETRY, surface="cylindrical", arc_radius_mm=1100.0),
    "fan": replace(GEOMETRY, rows=1),
    "parallel": replace(GEOMETRY, **parallel_beam(), column_pitch_mm=3.3, row_pitch_mm=2.2),
    "flying spots": replace(GEOMETRY, source_z_mm=[-2.0, 2.0], spots_mm=[(-0.6, 0.2, 0.5), (0.6, 0.0, -0.5)]),
    "rolled": Mounting(roll_deg=4.0, tilt_deg=3.0).of(GEOMETRY),
}


def lines(shapes, geometry, samples, physics=None):
    return Chain(ShapesScene(shapes), geometry, samples=samples).state(checked(physics or {}), POSE).line_integrals()


def plain_lines(monkeypatch, shapes, geometry, samples, physics=None):
    """Line integrals by the rays of undivided pixels."""
    with monkeypatch.context() as patch:
        patch.setattr(ShapesScene, "edge_scans", lambda *_: ())
        return lines(shapes, geometry, samples, physics)


@pytest.mark.parametrize("shapes, geometry", [*((CURVED, name) for name in GEOMETRIES), (CUT, "flat")])
def test_divided_pixels_have_the_mean_of_many_rays(shapes, geometry, monkeypatch):
    """The error of n rays per direction is proportional to n^-1.5, so 64 rays have 1/181 of the error of two."""
    scan = GEOMETRIES[geometry]
    plain, expected = (np.exp(-plain_lines(monkeypatch, shapes, scan, samples)) for samples in (2, 64))
    assert np.std(np.exp(-lines(shapes, scan, 2)) - expected) < np.std(plain - expected) / 50


@pytest.mark.parametrize(
    "physics",
    [
        {"spectrum": {"kvp": 100.0, "filtration_mm": 4.0}, "bowtie": {"at_20deg_mm": 30.0}, "heel": {"depth_um": 8.0}},
        {"motion": {"x_mm_per_s": 40.0, "y_mm_per_s": 30.0}, "focal_spot": {"width_mm": 1.0, "length_mm": 1.5}},
    ],
    ids=["beam", "moving"],
)
def test_effects_act_on_divided_pixels(physics, monkeypatch):
    plain, expected = (plain_lines(monkeypatch, CURVED, GEOMETRY, samples, physics) for samples in (2, 24))
    assert np.std(lines(CURVED, GEOMETRY, 2, physics) - expected) < np.std(plain - expected) / 20


def test_views_in_parts_have_the_same_means(monkeypatch):
    physics = {"motion": {"x_mm_per_s": 40.0}}
    whole = lines(CURVED, GEOMETRY, 2, physics)
    monkeypatch.setattr(edges, "MAX_RAYS", 1)
    np.testing.assert_allclose(lines(CURVED, GEOMETRY, 2, physics), whole, rtol=1e-12, atol=1e-12)


def test_a_single_ray_per_pixel_goes_to_its_center(monkeypatch):
    expected = plain_lines(monkeypatch, CURVED, GEOMETRY, 1)
    np.testing.assert_array_equal(lines(CURVED, GEOMETRY, 1), expected)


def test_objects_out_of_the_beam_do_not_attenuate():
    scene = ShapesScene([cylinder("water", (0, 0, 300.0), 20.0, 10.0)])
    np.testing.assert_allclose(Chain(scene, GEOMETRY, samples=2).state({}).line_integrals(), 0, atol=1e-12)
