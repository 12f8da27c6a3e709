"""First-order changes of path lengths with pose, motion and geometry, against new traces."""

from dataclasses import replace

import numpy as np
import pytest

from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.base.mounting import Mounting
from virtual_phantom.physics.scenes.posed import PosedScene
from virtual_phantom.physics.scenes.rays import corner_rays
from virtual_phantom.physics.scenes.sampling import displace_source
from virtual_phantom.physics.scenes.scene import Pose, VoxelScene

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
    soft = 1 / (
        1 + np.exp((np.hypot(x / 60, y / 45) - 1) * 12)
    )  # a smooth edge, so that shifts change path lengths smoothly
    return VoxelScene(
        np.stack([soft, soft * (x > 20) * (0.5 + z / 80)]).astype(np.float32), grid, ("water", "bone"), 60.0
    )


class Counting:
    """Scene that counts how often it is traced."""

    def __init__(self, scene):
        self.scene, self.traces = scene, 0

    def __getattr__(self, name):
        return getattr(self.scene, name)

    def path_lengths(self, *arguments):
        self.traces += 1
        return self.scene.path_lengths(*arguments)


def test_traced_pose_is_exact(traced):
    posed = PosedScene(traced)
    for pose in (Pose(), Pose(x_mm=3.0, turn_deg=1.0)):
        np.testing.assert_array_equal(posed.path_lengths(GEOMETRY, pose), traced.path_lengths(GEOMETRY, pose))


IN_PLACE = (GEOMETRY, Pose(), None)
PLACES = {
    "pose": (GEOMETRY, NEAR, None),
    "detector offset": (replace(GEOMETRY, column_offset_px=0.0015, row_offset_px=0.001), Pose(), None),
    "distances": (replace(GEOMETRY, source_to_isocentre_mm=500.05, source_to_detector_mm=900.03), Pose(), None),
    "source": (displace_source(GEOMETRY, 0.02, 0.01), Pose(), None),
    "roll": (Mounting(roll_deg=0.01).of(GEOMETRY), Pose(), None),
    "tilt": (Mounting(tilt_deg=0.02).of(GEOMETRY), NEAR, None),
    "motion": (GEOMETRY, Pose(turn_deg=0.002), np.linspace(-0.01, 0.01, 36).reshape(12, 3)),
}


@pytest.mark.parametrize("place", PLACES)
def test_displaced_rays_are_extrapolated(traced, place):
    posed = PosedScene(traced).linearized_at([IN_PLACE])
    start = posed.path_lengths(GEOMETRY, Pose())
    again = traced.path_lengths(*PLACES[place])
    changed = np.abs(again - start).max()
    followed = posed.path_lengths(*PLACES[place])
    assert changed > 1e-3
    assert not np.array_equal(followed, again)  # not traced
    assert np.abs(followed - again).max() < 0.05 * changed


def test_slopes_equal_finite_differences(traced):
    """Against differences of new traces, for rays that cross planes of x and of y."""
    rays = traced.rays(GEOMETRY)
    assert 0.2 < rays.bundles.along_x.mean() < 0.8
    slopes = traced.slopes(rays)
    step = 0.05  # mm: almost all crossings stay between the same voxels
    moved = Pose(z_mm=step)
    sums = [traced.path_lengths(GEOMETRY, pose) / rays.lengths_mm for pose in (Pose(), moved)]
    expected = -slopes[:, :, :, 1].transpose(2, 0, 3, 1) * step / traced.grid.spacing[0]
    assert np.abs(expected).max() > 1e-3
    np.testing.assert_allclose(sums[1] - sums[0], expected, atol=0.02 * np.abs(expected).max())


def test_displaced_rays_need_no_further_traces(traced):
    counting = Counting(traced)
    posed = PosedScene(counting).linearized_at([IN_PLACE])
    posed.path_lengths(GEOMETRY, Pose())
    posed.path_lengths(GEOMETRY, NEAR)
    for place in PLACES.values():
        posed.path_lengths(*place)
    assert counting.traces == 1
    posed.path_lengths(GEOMETRY, Pose(x_mm=1.0))
    assert counting.traces == 2
    posed.path_lengths(GEOMETRY, Pose(x_mm=1.0))
    assert counting.traces == 2  # cached


@pytest.mark.parametrize("place", PLACES)
def test_result_does_not_depend_on_earlier_calls(traced, place):
    """Path lengths are a function of the scan and of the reference scans, byte for byte."""
    fresh, used = (PosedScene(traced).linearized_at([IN_PLACE]) for _ in range(2))
    nearly = (GEOMETRY, Pose(x_mm=NEAR.x_mm / 2), None)
    for one in (nearly, (GEOMETRY, Pose(x_mm=1.0), None), *PLACES.values()):
        used.path_lengths(*one)
    np.testing.assert_array_equal(used.path_lengths(*PLACES[place]), fresh.path_lengths(*PLACES[place]))


def test_far_rays_are_traced(traced):
    motion = np.zeros((12, 3))
    motion[6:, 0] = 2.0
    posed = PosedScene(traced).linearized_at([IN_PLACE])
    posed.path_lengths(GEOMETRY, Pose())
    np.testing.assert_array_equal(
        posed.path_lengths(GEOMETRY, Pose(), motion), traced.path_lengths(GEOMETRY, Pose(), motion)
    )


@pytest.mark.parametrize("place", PLACES)
def test_outline_gives_the_largest_displacement(traced, place):
    """The rays at the detector's corners and edges include the largest displacement of all rays."""

    def displacement(some):
        here, there = (
            traced.rays(some(geometry), pose, motion).extremes_mm()
            for geometry, pose, motion in (PLACES[place], (GEOMETRY, Pose(), None))
        )
        return float(np.abs(here - there).sum(axis=0).max())

    assert displacement(lambda geometry: geometry) == pytest.approx(displacement(corner_rays), rel=0.1)
