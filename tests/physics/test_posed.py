"""Path lengths that follow the pose to first order, against those traced anew."""

import numpy as np
import pytest

from virtual_phantom.geometry import Grid, circular
from virtual_phantom.physics.posed import PosedScene
from virtual_phantom.physics.scene import Pose, VoxelScene

GEOMETRY = circular(
    views=12,
    source_to_isocentre_mm=500.0,
    source_to_detector_mm=900.0,
    columns=48,
    rows=6,
    column_pitch_mm=8.0,
    row_pitch_mm=8.0,
)
NEAR = Pose(x_mm=0.008, y_mm=-0.004, z_mm=0.003, turn_deg=0.002, size=1.00002)


@pytest.fixture(scope="module")
def traced():
    grid = Grid((16, 40, 40), (4.0, 4.0, 4.0))
    z, y, x = np.meshgrid(*grid.axes_mm(), indexing="ij")
    soft = 1 / (1 + np.exp((np.hypot(x / 60, y / 45) - 1) * 12))  # a smooth edge: shifts change it smoothly
    return VoxelScene(np.stack([soft, soft * (x > 20)]).astype(np.float32), grid, ("water", "bone"), 60.0)


class Counting:
    """A scene that counts how often it is traced."""

    def __init__(self, scene):
        self.scene, self.traces = scene, 0

    def __getattr__(self, name):
        return getattr(self.scene, name)

    def path_lengths(self, *arguments):
        self.traces += 1
        return self.scene.path_lengths(*arguments)


def test_a_pose_that_was_traced_is_exact(traced):
    posed = PosedScene(traced)
    for pose in (Pose(), Pose(x_mm=3.0, turn_deg=1.0)):
        np.testing.assert_array_equal(posed.path_lengths(GEOMETRY, pose), traced.path_lengths(GEOMETRY, pose))


def test_a_pose_nearby_is_followed(traced):
    posed = PosedScene(traced)
    start = posed.path_lengths(GEOMETRY, Pose())
    moved = traced.path_lengths(GEOMETRY, NEAR)
    changed = np.abs(moved - start).max()
    assert changed > 1e-3
    assert np.abs(posed.path_lengths(GEOMETRY, NEAR) - moved).max() < 0.05 * changed


def test_nearby_poses_cost_no_further_traces(traced):
    counting = Counting(traced)
    posed = PosedScene(counting)
    posed.path_lengths(GEOMETRY, Pose())
    posed.path_lengths(GEOMETRY, NEAR)
    before = counting.traces
    posed.path_lengths(GEOMETRY, Pose(x_mm=-0.005, turn_deg=0.001))
    assert counting.traces == before
    posed.path_lengths(GEOMETRY, Pose(x_mm=1.0))
    assert counting.traces == before + 1


def test_motion_is_traced(traced):
    motion = np.zeros((12, 3))
    motion[6:, 0] = 2.0
    posed = PosedScene(traced)
    np.testing.assert_array_equal(
        posed.path_lengths(GEOMETRY, Pose(), motion), traced.path_lengths(GEOMETRY, Pose(), motion)
    )
