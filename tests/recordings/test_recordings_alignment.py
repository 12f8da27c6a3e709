"""Alignment of the phantom with images of it that were shifted, rotated, resampled and noisy."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import phantom_files
import pytest
import SimpleITK as sitk
from recording_folders import write_yaml

from virtual_phantom.base import streams
from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, helical
from virtual_phantom.base.units import attenuation_to_hu
from virtual_phantom.io.simpleitk import itk_image, itk_resample, matrix_of
from virtual_phantom.io.volumes import Volume
from virtual_phantom.phantom import Roi, ct
from virtual_phantom.physics.scenes.line_integrals import clean_line_integrals
from virtual_phantom.projectors import projector
from virtual_phantom.reconstruction import fbp
from virtual_phantom.recordings import registration
from virtual_phantom.recordings.alignment import align_recording, check_same_phantom, transfer_rois
from virtual_phantom.recordings.reading import load_recording
from virtual_phantom.recordings.registration import Search, describe_alignment, rigid_transform
from virtual_phantom.simulation.acquire import simulate_counts

REAL = Path(__file__).resolve().parents[2] / "../shared/real"
GRID = Grid((16, 64, 64), (3.0, 3.0, 3.0), (5.0, -40.0, 300.0))
OTHER_GRID = Grid((26, 90, 96), (2.5, 2.5, 2.2), (30.0, 10.0, -20.0))
# The same boxes with an eighth of the voxels, for tests that need no precise position.
COARSE = Grid((8, 32, 32), (6.0, 6.0, 6.0), GRID.centre_mm)
OTHER_COARSE = Grid((13, 45, 48), (5.0, 5.0, 4.4), OTHER_GRID.centre_mm)
MU_WATER = 0.02
BALLS = {"bright": ((40, 20, 6), 16.0, 120.0), "dark": ((-40, -16, -8), 14.0, -90.0), "bone": ((0, -45, 4), 9.0, 600.0)}


def object_hu(points: np.ndarray) -> np.ndarray:
    """HU of an elliptic body, 170 x 130 mm, with three balls, at points (..., 3) from its center, mm (x, y, z)."""
    x, y, z = np.moveaxis(points, -1, 0)
    hu = np.where((x / 85) ** 2 + (y / 65) ** 2 < 1, 30.0, -1000.0)
    for name, (_, _, value) in BALLS.items():
        hu = np.where(in_ball(name, points), value, hu)
    return hu


def in_ball(name: str, points: np.ndarray) -> np.ndarray:
    offset, radius, _ = BALLS[name]
    return ((points - offset) ** 2).sum(axis=-1) < radius**2


def points_of(grid: Grid, transform=None) -> np.ndarray:
    """Voxel centers (z, y, x, 3), transformed back to the phantom's world, relative to the phantom's center, mm."""
    z, y, x = np.meshgrid(*grid.axes_mm(), indexing="ij")
    points = np.stack([x, y, z], axis=-1) + grid.centre_mm
    if transform is not None:
        back = np.linalg.inv(matrix_of(transform))
        points = points @ back[:3, :3].T + back[:3, 3]
    return points - GRID.centre_mm


def sampled(function, grid: Grid, transform=None) -> np.ndarray:
    """Mean of a function of points over each voxel."""
    fine = function(points_of(grid.refined(2), transform)).astype(np.float32)
    return fine.reshape(grid.shape[0], 2, grid.shape[1], 2, grid.shape[2], 2).mean(axis=(1, 3, 5))


@pytest.fixture(scope="module")
def phantom():
    return Volume(sampled(object_hu, GRID), GRID)


@pytest.fixture(scope="module")
def coarse():
    return Volume(sampled(object_hu, COARSE), COARSE)


def placed(rotation_deg, shift_mm):
    """Transform that puts the phantom's center at the recording's and shifts and rotates it."""
    centre = np.array(OTHER_GRID.centre_mm) - GRID.centre_mm
    return rigid_transform(GRID.centre_mm, rotation_deg, centre + shift_mm)


TURNED = placed((0, 2, -9), (-15, 14, -6))


def align(image, phantom, name, checked=True):
    """Alignment, with or without a check of its quality, which takes most of the time for flipped axes."""
    search = Search(image, phantom, name)
    found = search.refine_to_finest(search.coarse_alignment(None))
    return search.checked(found) if checked else search.measure(found)


@pytest.fixture
def upright(monkeypatch):
    """Try a single rotation at the start, for recordings that are rotated by less than half a step (3.5 degrees)."""
    monkeypatch.setattr(registration, "ROTATIONS_DEG", (0.0,))


@pytest.fixture(scope="module")
def aligned(phantom):
    """Image of the phantom at TURNED on a table, and its alignment."""
    image = scanned(TURNED, table=True)
    return image, align(image, phantom, name="a", checked=False)


def scanned(transform, noise_hu=20.0, table=False, function=object_hu, seed=1, grid=OTHER_GRID) -> Volume:
    array = sampled(function, grid, transform)
    array += noise_hu * np.random.default_rng(seed).normal(size=array.shape).astype(np.float32)
    if table:
        array[:, 3:6, 10:-10] = 100
    return Volume(array.astype(np.float32), grid)


def errors(found, truth, grid=GRID) -> tuple[np.ndarray, float]:
    """Displacement of the phantom's center, mm (x, y, z), and angle between the rotations, degrees."""
    found, truth = np.array(found.matrix), matrix_of(truth)
    turn = np.linalg.inv(truth[:3, :3]) @ found[:3, :3]
    angle = math.degrees(math.acos(min(1, (np.trace(turn) - 1) / 2)))
    return ((found - truth) @ [*grid.centre_mm, 1])[:3], angle


def test_known_position_is_found(aligned):
    _, found = aligned
    shift, angle = errors(found, TURNED)
    assert np.abs(shift).max() < 0.2 * min(OTHER_GRID.spacing) and angle < 0.1
    assert found.correlation_inside > 0.97 and found.covered > 0.9
    assert found.edge_mm < 0.3 and abs(found.growth_mm) < 0.2 and found.undetermined == ()


def test_alignment_is_reproducible(coarse):
    image = scanned(TURNED, grid=OTHER_COARSE)
    first = align(image, coarse, name="a", checked=False)
    assert np.abs(errors(first, TURNED, COARSE)[0]).max() < 0.2 * min(OTHER_COARSE.spacing)
    threads = sitk.ProcessObject.GetGlobalDefaultNumberOfThreads()
    try:
        sitk.ProcessObject.SetGlobalDefaultNumberOfThreads(1 if threads > 1 else 2)
        assert align(image, coarse, name="a", checked=False) == first
    finally:
        sitk.ProcessObject.SetGlobalDefaultNumberOfThreads(threads)


def other_object(points):
    x, y, _ = np.moveaxis(points, -1, 0)
    return np.where((x / 70) ** 2 + (y / 75) ** 2 < 1, np.where(np.abs(x) < 12, -100.0, 60.0), -1000.0)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (other_object, "the phantom does not fit: correlation"),
        (lambda points: object_hu(points * [-1, 1, 1]), "with left and right swapped"),
        (lambda points: 0 * points[..., 0] - 1000, "no voxel is above -500 HU"),
    ],
)
def test_another_object_is_rejected(coarse, upright, function, message):
    image = scanned(placed((0, 0, 2), (5, 5, 0)), noise_hu=10, function=function, grid=OTHER_COARSE)
    with pytest.raises(InputError) as error:
        align(image, coarse, name="scanner_a")
    assert "recording scanner_a: " in str(error.value) and message in str(error.value), str(error.value)
    assert "\n" not in str(error.value)


def test_unconstrained_directions_of_a_uniform_cylinder_are_reported(upright):
    """Rods through all slices: the position along z is unknown."""

    def rods(points):
        return object_hu(points * [1, 1, 0])

    image = scanned(placed((0, 0, 3), (5, 5, 0)), 5, function=rods, grid=OTHER_COARSE)
    found = align(image, Volume(sampled(rods, COARSE), COARSE), name="a")
    assert found.undetermined == ("z",)
    assert "its position along z is undetermined" in describe_alignment(found)


def rois_on(grid, transform=None):
    return tuple(Roi(name, "tissue", sampled(lambda p: in_ball(name, p), grid, transform) >= 0.5) for name in BALLS)  # noqa: B023


def test_rois_follow_the_alignment(aligned):
    image, found = aligned
    carried = transfer_rois(found, rois_on(GRID), GRID, image, "a")
    for roi, right in zip(carried, rois_on(OTHER_GRID, TURNED), strict=True):
        assert roi.name == right.name and roi.mask.shape == OTHER_GRID.shape
        overlap = 2 * (roi.mask & right.mask).sum() / (roi.mask.sum() + right.mask.sum())
        assert overlap > 0.9, roi.name  # half of the voxels of a ball of 9 mm are at its surface


def test_rois_outside_of_the_image_are_rejected(aligned):
    image, found = aligned
    lower = OTHER_GRID.shape[0] // 2 - 2
    middle = OTHER_GRID.centre_mm[2] - (OTHER_GRID.shape[0] - lower) / 2 * OTHER_GRID.spacing[0]
    half = Volume(image.array[:lower], replace(OTHER_GRID, shape=(lower, 90, 96), centre_mm=(30.0, 10.0, middle)))
    with pytest.raises(InputError, match="recording a: covers only [0-9]+ % of ROI bright"):
        transfer_rois(found, rois_on(GRID), GRID, half, "a")
    padded = image.array.copy()
    padded[:, :, :45] = -3024
    with pytest.raises(InputError, match="% of ROI dark"):
        transfer_rois(found, rois_on(GRID)[1:], GRID, Volume(padded, OTHER_GRID), "a")
    speck = np.zeros(GRID.shape, bool)
    speck[10, 30, 30] = True
    wide = Volume(np.zeros((8, 22, 22), np.float32), Grid((8, 22, 22), (10.0, 10.0, 10.0), OTHER_GRID.centre_mm))
    with pytest.raises(InputError, match="ROI speck does not fill half of any voxel"):
        transfer_rois(found, [Roi("speck", "a", speck)], GRID, wide, "a")


def recording_of(folder, images, **content):
    names = [f"{number}.nii.gz" for number in range(len(images))]
    write_yaml(folder, {"name": "scanner_a", "kind": "images", "repeats": names, **content})
    for name, image in zip(names, images, strict=True):
        phantom_files.write_nifti_array(image.array, folder / name, grid=image.grid)
    return load_recording(folder)


def test_repeats_are_averaged_and_a_moved_one_is_rejected(coarse, upright, tmp_path):
    truth = placed((0, 0, 3), (5, -6, 2))
    still = [scanned(truth, 14, table=True, seed=seed, grid=OTHER_COARSE) for seed in range(3)]
    found, mean, shifts = align_recording(recording_of(tmp_path / "still", still), coarse)
    assert np.abs(errors(found, truth, COARSE)[0]).max() < 0.4
    np.testing.assert_allclose(mean.array, np.mean([image.array for image in still], axis=0), atol=1e-3)
    assert [shift.repeat for shift in shifts] == ["0.nii.gz", "1.nii.gz", "2.nii.gz"]
    assert shifts[0].farthest_mm == 0 and max(shift.farthest_mm for shift in shifts) < 0.5
    moved = [still[0], scanned(placed((0, 0, 3), (5, 1, 2)), 14, table=True, grid=OTHER_COARSE)]
    with pytest.raises(InputError, match=r"1.nii.gz: is displaced by up to [67]\.\d mm from the first repeat"):
        align_recording(recording_of(tmp_path / "moved", moved), coarse)


def test_only_the_phantom_of_the_study_is_aligned(phantom, tmp_path):
    image = scanned(placed((0, 0, 0), (0, 0, 0)))
    assert check_same_phantom(recording_of(tmp_path / "any", [image]), "ct", "a.nii.gz") is None
    named = recording_of(tmp_path / "named", [image], phantom="synthetic")
    assert check_same_phantom(named, "synthetic", None) is None
    with pytest.raises(InputError, match="phantom is 'synthetic', but the study's phantom is ct or a.nii.gz"):
        check_same_phantom(named, "ct", "a.nii.gz")
    by_path = recording_of(tmp_path / "path", [image], phantom="0.nii.gz")
    assert check_same_phantom(by_path, "ct", tmp_path / "path" / "0.nii.gz") is None
    with pytest.raises(InputError, match="phantom is '0.nii.gz'"):
        check_same_phantom(by_path, "synthetic", None)


def simulated_scan(source: Volume, transform, grid: Grid, noise_level=1e-5) -> Volume:
    """Noisy helical scan, FBP, of a volume moved by a transform of its world, HU on `grid`."""
    image = itk_image(source.array, source.grid)
    array = itk_resample(image, grid, transform.GetInverse(), -1000.0)
    geometry = helical(
        views=600,
        volume_height_mm=grid.extent_mm[0],
        source_to_isocentre_mm=600.0,
        source_to_detector_mm=1000.0,
        columns=280,
        rows=24,
        column_pitch_mm=3.0,
        row_pitch_mm=3.2,
    )
    clean = clean_line_integrals(Volume(array, grid), geometry, MU_WATER, threads=2)
    counts = simulate_counts(clean, noise_level, "physical", streams.acquisition(1, "a", "b", 0))
    image = fbp.fbp(projector("cpu", geometry, grid, 1, 2), counts.line_integrals(0.5)[None])[0]
    return Volume(attenuation_to_hu(image, MU_WATER).astype(np.float32), grid)


@pytest.mark.real
@pytest.mark.skipif(not REAL.exists(), reason="the real measurements are not beside this checkout")
def test_simulated_scan_of_the_clinical_ct_is_registered():
    """Within 0.2 voxels and 0.1 degrees."""
    centre = (3.5, 156.5, -785.5)
    image = ct.read_hu(REAL / "abdomen_ct" / "dicom")
    trunk = ct.trimmed(image, [[-178, 185], [22, 291]])
    study = Grid((20, 144, 144), (2.0, 2.6, 2.6), centre)
    phantom = Volume(ct.resample(trunk, study, outside=-1000.0), study)
    scan_grid = Grid((32, 220, 220), (2.0, 2.0, 2.0), (centre[0] + 3, centre[1] - 14, centre[2] + 4))
    truth = rigid_transform(centre, (0.8, -0.6, 5), (9, -17, 5))
    found = align(simulated_scan(trunk, truth, scan_grid), phantom, name="abdomen")
    shift, angle = errors(found, truth, study)
    assert np.abs(shift).max() < 0.2 * 2.0 and angle < 0.1, (shift, angle)
