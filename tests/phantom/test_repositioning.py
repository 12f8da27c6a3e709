"""Re-positioned phantom: its image and regions follow the pose."""

import nibabel
import numpy as np
import pytest
from scanner import SCANNER
from scipy import ndimage

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, circular, helical
from virtual_phantom.base.pose import Pose
from virtual_phantom.base.streams import root
from virtual_phantom.io.volumes import Volume
from virtual_phantom.phantom import ct, synthetic
from virtual_phantom.phantom.layout import read_layout
from virtual_phantom.phantom.repositioning import moved_to_border, random_pose
from virtual_phantom.physics.beam.materials import Segmentation
from virtual_phantom.physics.beam.sensors import Sensor
from virtual_phantom.physics.scenes.line_integrals import clean_line_integrals
from virtual_phantom.projectors.cpu import CpuProjector
from virtual_phantom.reconstruction.fbp import fbp
from virtual_phantom.simulation.project import project_phantom

MU = 0.02
POSE = Pose(x_mm=3.7, y_mm=-2.2, z_mm=1.9, turn_deg=25.0)
PLACE = np.array([21.0, 8.0, -3.0])  # of the ball, (x, y, z)
GRID = Grid((16, 48, 48), (2.0, 2.0, 2.0))
DETECTOR = dict(columns=90, rows=40, column_pitch_mm=2.5, row_pitch_mm=2.5, **SCANNER)
SCANS = {
    "circle": circular(views=120, **DETECTOR),
    "helix": helical(views=300, volume_height_mm=32, pitch=0.5, **DETECTOR),
}
MATERIALS, SENSOR = Segmentation(dense=None), Sensor()


def placed(pose):
    """Center of the ball: rotated from +x to +y, then shifted."""
    turn = np.deg2rad(pose.turn_deg)
    x, y, z = PLACE
    turned = [x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn), z]
    return np.array(turned) + [pose.x_mm, pose.y_mm, pose.z_mm]


def ball(grid, radius_mm=7.0):
    z, y, x = np.meshgrid(*grid.axes_mm(), indexing="ij")
    return (x - PLACE[0]) ** 2 + (y - PLACE[1]) ** 2 + (z - PLACE[2]) ** 2 < radius_mm**2


def centre_of_mass(weights, grid):
    z, y, x = (
        np.interp(at, np.arange(len(axis)), axis)
        for at, axis in zip(ndimage.center_of_mass(weights), grid.axes_mm(), strict=True)
    )
    return np.array([x, y, z])


@pytest.fixture(scope="module")
def phantom():
    fine = GRID.refined(2)
    return Volume(np.where(ball(fine), 0, -1000).astype(np.float32), fine)


@pytest.mark.parametrize("geometry", SCANS.values(), ids=SCANS.keys())
def test_image_of_a_moved_ball_follows_the_pose(phantom, geometry):
    lines = clean_line_integrals(phantom, geometry, MU, pose=POSE)
    image = fbp(CpuProjector(geometry, GRID), lines[None])[0]
    z, y, x = np.meshgrid(*GRID.axes_mm(), indexing="ij")
    near = sum((axis - at) ** 2 for axis, at in zip((x, y, z), placed(POSE), strict=True)) < 12**2
    assert centre_of_mass(np.where(near, image, 0), GRID) == pytest.approx(placed(POSE), abs=0.1)


def test_line_integrals_follow_the_pose(phantom):
    """Monochromatic line integrals by the chain equal those of the baseline, except for the scale of the material."""
    geometry = SCANS["circle"]
    settings = {"mu_water_per_mm": MU, "materials": MATERIALS, "sensor": SENSOR}
    baseline, _ = project_phantom(phantom, geometry, {}, pose=POSE, **settings)
    chain, _ = project_phantom(phantom, geometry, {"photon_flux": {"factor": 1.0}}, pose=POSE, **settings)
    inside = baseline > 0.05
    assert chain[inside] / baseline[inside] == pytest.approx(np.median(chain[inside] / baseline[inside]), rel=1e-3)


def test_samples_approach_the_mean_transmission_of_a_pixel(phantom):
    settings = {"mu_water_per_mm": MU, "materials": MATERIALS, "sensor": SENSOR}
    finer = DETECTOR | {"columns": 540, "rows": 240, "column_pitch_mm": 2.5 / 6, "row_pitch_mm": 2.5 / 6}
    parts, _ = project_phantom(phantom, circular(views=2, **finer), {"photon_flux": {"factor": 1.0}}, **settings)
    mean = -np.log(np.exp(-parts.astype(float)).reshape(2, 40, 6, 90, 6).mean(axis=(2, 4)))

    def error(samples):
        lines, _ = project_phantom(
            phantom, circular(views=2, **DETECTOR), {"photon_flux": {"factor": 1.0}}, samples=samples, **settings
        )
        return np.sqrt(np.mean((lines - mean) ** 2))

    assert error(2) < 0.2 * error(1)


def test_phantom_outside_of_the_fan_is_rejected(phantom):
    with pytest.raises(InputError, match="the phantom reaches"):
        clean_line_integrals(phantom, SCANS["circle"], MU, pose=Pose(x_mm=60))


def test_regions_of_the_layout_follow_the_pose():
    """Center of each ellipsoid, rotated and shifted; a rotation about the axis keeps its volume."""
    grid, layout = Grid((64, 150, 210), (1.4, 1.4, 1.4)), read_layout()
    for roi, entry in zip(synthetic.rois(layout, grid, root(1), POSE), layout["rois"], strict=True):
        x, y, z = entry["centre_mm"]
        turn = np.deg2rad(POSE.turn_deg)
        expected = [x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn), z]
        expected += np.array([POSE.x_mm, POSE.y_mm, POSE.z_mm])
        assert centre_of_mass(roi.mask, grid) == pytest.approx(expected, abs=0.25), roi.name
        assert roi.mask.sum() * grid.voxel_volume_mm3 == pytest.approx(entry["volume_mm3"], rel=0.05), roi.name


def test_regions_of_a_ct_follow_the_pose(tmp_path):
    """A CT whose isocenter has any world position."""
    centre = (40.0, -70.0, 300.0)
    ct_grid = Grid((30, 80, 80), (1.0, 1.0, 1.0), centre)
    names = []
    for name, array in (
        ("ct", np.where(ball(ct_grid), 0, -1000).astype(np.int16)),
        ("ball", ball(ct_grid).astype(np.uint8)),
    ):
        names.append(str(tmp_path / f"{name}.nii.gz"))
        nibabel.save(nibabel.Nifti1Image(array.T, ct_grid.affine), names[-1])
    settings = {"image": names[0], "labels": names[1], "rois": [{"name": "ball", "tissue_class": "one", "label": 1}]}
    grid = Grid((24, 60, 60), (1.5, 1.4, 1.3), centre)
    still, moved = (ct.rois(ct.read_settings(settings), grid, *pose)[0].mask for pose in ((), (POSE,)))
    assert centre_of_mass(still, grid) == pytest.approx(PLACE, abs=0.1)
    assert centre_of_mass(moved, grid) == pytest.approx(placed(POSE), abs=0.1)


def test_poses_are_independent_and_within_their_bounds():
    poses = [random_pose(2022, seed, 4.0, 2.0) for seed in range(200)]
    places = np.array([[pose.x_mm, pose.y_mm, pose.z_mm, 2 * pose.turn_deg] for pose in poses])
    assert len(np.unique(places, axis=0)) == 200 and np.abs(places).max() <= 4
    # Uniform from -4 to 4: SD 8 / sqrt(12), with an error of about 3 % for 200 values.
    assert places.std(axis=0) == pytest.approx(8 / np.sqrt(12), rel=0.12)
    assert np.abs(np.corrcoef(places.T) - np.eye(4)).max() < 0.25
    assert random_pose(2022, 7, 4.0, 2.0) == poses[7] != random_pose(2023, 7, 4.0, 2.0)


def test_region_moved_to_the_border_is_reported():
    inside, outside = np.zeros((2, 4, 5, 6), bool)
    inside[1:3, 2, 2], outside[1:3, 2, 5] = True, True
    assert moved_to_border([inside, outside, outside], [inside, inside, outside]) == [1]
