"""Objects that are constant along z: path lengths against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.physics.scenes.posed import PosedScene
from virtual_phantom.physics.scenes.prism import PrismScene
from virtual_phantom.physics.scenes.scene import Pose
from virtual_phantom.physics.scenes.shapes import DiscScene

GEOMETRY = circular(
    views=7,
    source_to_isocentre_mm=410.0,
    source_to_detector_mm=553.0,
    columns=90,
    rows=3,
    column_pitch_mm=1.2,
    row_pitch_mm=20.0,
)


def slice_of(inside, size=400, spacing=0.2, finer=4):
    """Volume fractions of pixels from an indicator of x and y in mm."""
    fine = (np.arange(size * finer) - (size * finer - 1) / 2) * spacing / finer
    share = inside(fine[None], fine[:, None]).astype(float).reshape(size, finer, size, finer).mean(axis=(1, 3))
    return PrismScene(share[None], Grid((1, size, size), (1.0, spacing, spacing)), ("pmma",))


@pytest.mark.parametrize("pose", [Pose(), Pose(x_mm=1.5, y_mm=-2.0, z_mm=30.0, turn_deg=40.0, size=1.02)])
def test_mask_of_a_disc_equals_the_disc(pose):
    scene = slice_of(lambda x, y: np.hypot(x, y) < 35)
    motion = np.linspace(0, 1, 7)[:, None] * [2.0, 1.0, 0.0]
    for moved in (None, motion):
        exact = DiscScene(70.0, "pmma").path_lengths(GEOMETRY, pose, moved)
        found = scene.path_lengths(GEOMETRY, pose, moved)
        assert found.shape == exact.shape == (1, 7, 3, 90)
        inner = exact > 25  # for grazing rays, a chord changes by more than a pixel within a pixel
        assert np.abs(found - exact)[inner].max() < 0.1 and np.abs(found - exact)[inner].mean() < 0.03


def test_off_axis_square_follows_the_pose():
    """The central ray from +y is x = 0 along the y axis."""
    scene = slice_of(lambda x, y: (np.abs(x - 10) < 5) & (np.abs(y) < 8))
    geometry = circular(
        views=1,
        source_to_isocentre_mm=410.0,
        source_to_detector_mm=553.0,
        columns=1,
        rows=1,
        column_pitch_mm=1.0,
        row_pitch_mm=1.0,
    )

    def length(**pose):
        return float(scene.path_lengths(geometry, Pose(**pose))[0, 0, 0, 0])

    assert length() == 0
    assert length(x_mm=-10.0) == pytest.approx(16, abs=0.02)
    assert length(turn_deg=90.0) == pytest.approx(10, abs=0.02)
    assert length(x_mm=-20.0, size=2.0) == pytest.approx(32, abs=0.04)
    assert length(x_mm=-10.0, turn_deg=180.0) == 0  # rotated about the origin of its own position, it is at -20


def test_finer_and_offset_masks_are_cropped_to_their_content():
    whole = slice_of(lambda x, y: np.hypot(x + 12, y - 9) < 6)
    assert whole.grid.shape[1] < 70
    exact = DiscScene(12.0, "pmma").path_lengths(GEOMETRY, Pose(x_mm=-12.0, y_mm=9.0))
    found = whole.path_lengths(GEOMETRY)
    assert np.abs(found - exact).mean() < 0.02 and found.max() == pytest.approx(exact.max(), abs=0.1)


def test_displaced_rays_are_extrapolated_without_tracing():
    scene = slice_of(lambda x, y: 1 / (1 + np.exp(2 * (np.hypot(x / 30, (y - 4) / 20) - 1) * 12)))
    posed = PosedScene(scene).linearized_at([(GEOMETRY, Pose(), None)])
    start = posed.path_lengths(GEOMETRY, Pose())
    motion = np.linspace(-0.001, 0.001, 7)[:, None] * [1.0, -1.0, 0.0]
    higher = replace(GEOMETRY, row_offset_px=0.5)
    np.testing.assert_allclose(posed.path_lengths(higher, Pose()), scene.path_lengths(higher, Pose()), rtol=1e-5)
    distance = replace(GEOMETRY, source_to_isocentre_mm=410.005)
    near = Pose(x_mm=0.001, y_mm=-0.001, z_mm=5.0, turn_deg=0.0005, size=1.00001)
    for place in ((GEOMETRY, near, None), (GEOMETRY, Pose(), motion), (distance, Pose(), None)):
        again, followed = scene.path_lengths(*place), posed.path_lengths(*place)
        changed = np.abs(again - start).max()
        assert changed > 1e-5
        assert 0 < np.abs(followed - again).max() < 0.05 * changed
