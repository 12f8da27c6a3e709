"""Reconstruction of the blind validation against objects with line integrals in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtri

from virtual_phantom.base.geometry import Grid
from virtual_phantom.proof.hiding.reconstruction import images_hu, ramp
from virtual_phantom.proof.hiding.xcist import Scan

MU = 0.0193
SCAN = Scan(
    views=360,
    columns=160,
    rows=6,
    column_pitch_mm=2.4,
    row_pitch_mm=2.4,
    source_to_isocentre_mm=541.0,
    source_to_detector_mm=949.0,
    kev=70.0,
    photons=1e5,
)
PIXEL = 2.4 * 541 / 949
GRID = Grid((4, 120, 120), (PIXEL,) * 3)


def rays():
    """Angles of the views, and x, y and z from the source to the detector: [view, row, column] or broadcast to it."""
    angles = 2 * np.pi * np.arange(SCAN.views)[:, None, None] / SCAN.views
    u = (np.arange(SCAN.columns) - (SCAN.columns - 1) / 2) * SCAN.column_pitch_mm
    v = ((np.arange(SCAN.rows) - (SCAN.rows - 1) / 2) * SCAN.row_pitch_mm)[:, None]
    distance, sine, cosine = SCAN.source_to_detector_mm, np.sin(angles), np.cos(angles)
    return angles, np.array([distance * sine + u * cosine, -distance * cosine + u * sine]), v


def from_source(centre_mm, angles):
    """Vector from the source to a point off the axis, x and y."""
    radius = SCAN.source_to_isocentre_mm
    return np.array([centre_mm[0] + radius * np.sin(angles), centre_mm[1] - radius * np.cos(angles)])


def cylinder(centre_mm, radius_mm, mu):
    """Line integrals [view, row, column] of a long cylinder along z: chords of a circle, divided by the rays' slope."""
    angles, ray, v = rays()
    away, length = from_source(centre_mm, angles), np.hypot(*ray)
    off = (away[0] * ray[1] - away[1] * ray[0]) / length
    return mu * 2 * np.sqrt(np.maximum(radius_mm**2 - off**2, 0)) * np.hypot(length, v) / length


def ball(centre_mm, radius_mm, mu):
    """Line integrals [view, row, column] of a ball: chords of a sphere."""
    angles, ray, v = rays()
    away, z = from_source(centre_mm, angles), centre_mm[2]
    along = ((away * ray).sum(axis=0) + z * v) / np.hypot(np.hypot(*ray), v)
    off = (away**2).sum(axis=0) + z**2 - along**2
    return mu * 2 * np.sqrt(np.maximum(radius_mm**2 - off, 0))


@pytest.fixture(scope="module")
def lines():
    return cylinder((0, 0), 80.0, MU) + cylinder((40, -25), 15.0, 0.3 * MU)


def test_hu_and_positions(lines):
    hu = images_hu(lines, SCAN, GRID, MU)
    _, y, x = np.meshgrid(*GRID.axes_mm(), indexing="ij")
    insert = np.hypot(x - 40, y + 25)
    water = (np.hypot(x, y) < 70) & (insert > 25)
    assert abs(hu[water].mean()) < 2 and hu[water].std() < 10
    assert hu[insert < 10].mean() == pytest.approx(300, abs=4)
    air = (np.hypot(x, y) > 92) & (np.hypot(x, y) < 100)
    assert hu[air].mean() == pytest.approx(-1000, abs=5)


def test_slices_are_at_their_positions():
    """Center of mass of small balls off the central plane, in all three directions."""
    places, grid = ((30.0, 40.0, -1.2), (30.0, -40.0, 0.7)), Grid((6, 80, 80), (PIXEL,) * 3)
    hu = images_hu(sum(ball(place, 2.0, MU) for place in places), SCAN, grid, MU) + 1000
    z, y, x = np.meshgrid(*grid.axes_mm(), indexing="ij")
    for place in places:
        near = np.where(np.hypot(x - place[0], y - place[1]) < 6, hu, 0)
        found = [float((near * axis).sum() / near.sum()) for axis in (x, y, z)]
        assert found == pytest.approx(place, abs=0.25)


def test_kernel_blurs_by_its_width(lines):
    """An edge blurred by a Gaussian is its integral: the quartiles are 0.67 standard deviations from the middle."""
    grid = replace(GRID, shape=(1, *GRID.shape[1:]))
    _, y, x = grid.axes_mm()
    distance = np.hypot(x, y[:, None]).ravel()
    order = np.argsort(distance)
    widths = {}
    for blur in (3.0, 6.0):
        hu = images_hu(lines - cylinder((40, -25), 15.0, 0.3 * MU), SCAN, grid, MU, blur).ravel()[order]
        level = np.convolve(hu, np.ones(41) / 41, mode="same")
        near = (distance[order] > 50) & (distance[order] < 105)
        reached = [distance[order][near][np.argmax(level[near] < -1000 * share)] for share in (0.25, 0.75)]
        widths[blur] = (reached[1] - reached[0]) / (2 * ndtri(0.75))
    for blur, width in widths.items():
        assert width == pytest.approx(blur, rel=0.05)


def test_ramp_filter_removes_the_mean():
    """A ramp is 0 at frequency 0: the filtered value of a wide uniform field decreases with its width."""
    wide = ramp(np.ones((1, 4096)), 1.0, 0.0)
    assert abs(wide[0, 1024:3072]).max() < 3e-4
