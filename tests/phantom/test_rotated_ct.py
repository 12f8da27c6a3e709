"""Regions drawn on a CT that is rotated by up to one degree and read as upright: they keep their voxels."""

import nibabel
import numpy as np
import phantom_files
import pydicom
import pytest
from phantom_files import BALLS, CT_GRID, ball, lps, write_seg, write_series
from scipy.spatial.transform import Rotation
from structure_files import contour, structure_set

from virtual_phantom.base.errors import InputError
from virtual_phantom.io.volumes import read_image
from virtual_phantom.phantom.dicom_series import read_series
from virtual_phantom.phantom.masks import open_regions

# Pixels of 0.2 mm and slices of 1 mm, so that 0.9 degrees move voxels by more than one: 48 x 40 x 14 voxels.
SPACING, MIDDLE = np.array([0.2, 0.2, 1.0]), np.array([12.0, -30.0, 300.0])  # x, y, z; LPS
LAST = np.array(CT_GRID.shape[::-1]) - 1
TURNS = {
    "about z": Rotation.from_euler("z", 0.9, degrees=True),
    "about x": Rotation.from_euler("x", -0.8, degrees=True),
    "about all": Rotation.from_euler("xyz", [0.4, -0.5, 0.6], degrees=True),
}
SMALL = Rotation.from_euler("x", 0.2, degrees=True)


def position(turn, column, row, k):
    """LPS mm of a pixel of the rotated series."""
    return turn.apply((np.array([column, row, k]) - LAST / 2) * SPACING) + MIDDLE


def rotated_slices(turn):
    slices = phantom_files.ct_slices()
    for k, one in enumerate(slices):
        one.PixelSpacing, one.SliceThickness = [0.2, 0.2], 1
        one.ImagePositionPatient = [f"{v:.6f}" for v in position(turn, 0, 0, k)]
        one.ImageOrientationPatient = [f"{v:.9f}" for v in turn.as_matrix()[:, :2].T.ravel()]
    return slices


def affine_of(turn):
    """Affine from voxel (x, y, z), in the order of the arrays of phantom_files, to RAS mm."""
    lps_affine = np.eye(4)
    # x and y of the arrays run opposite to columns and rows
    lps_affine[:3, :3] = turn.as_matrix() * SPACING * [-1, -1, 1]
    lps_affine[:3, 3] = position(turn, LAST[0], LAST[1], 0)
    return np.diag([-1, -1, 1, 1]) @ lps_affine


def nifti(mask, turn, path, start=(0, 0, 0)):
    affine = affine_of(turn)
    affine[:3, 3] += affine[:3, :3] @ np.array(start[::-1])
    nibabel.save(nibabel.Nifti1Image(mask.T.astype(np.int16), affine), path)
    return str(path)


def outlines(mask, turn, flat=False):
    """Contours in mm around the balls' voxels; `flat`: at the z of the first pixel, as if slices were upright."""
    items = []
    for k, plane in enumerate(lps(mask)):
        for rows, columns in [np.nonzero(plane)] if plane.any() else []:
            # around the columns of each row, half a voxel outside
            left = [(columns[rows == r].min() - 0.5, r + e) for r in np.unique(rows) for e in (-0.4, 0.4)]
            right = [(columns[rows == r].max() + 0.5, r + e) for r in np.unique(rows) for e in (-0.4, 0.4)]
            points = np.array([position(turn, x, y, k) for x, y in [*left, *right[::-1]]])
            if flat:
                points[:, 2] = position(turn, *(LAST[:2] / 2), k)[2]
            items.append(contour(points))
    return items


@pytest.mark.parametrize("name", TURNS)
def test_regions_keep_their_voxels_on_a_rotated_dicom_ct(name, tmp_path):
    turn = TURNS[name]
    slices = rotated_slices(turn)
    grid = read_series(write_series(slices, tmp_path / "ct")).grid
    struct = structure_set(
        *((n, one, outlines(ball(one), turn)) for n, one in enumerate(BALLS, 1)), path=tmp_path / "rt.dcm"
    )
    for file in (write_seg(slices, tmp_path / "seg.dcm"), struct):
        regions = open_regions(file, grid)
        for number, one in enumerate(BALLS, 1):
            assert np.array_equal(regions.mask(number), ball(one)), (file, one)
    assert np.array_equal(open_regions(nifti(ball("dark"), turn, tmp_path / "m.nii"), grid).mask(1), ball("dark"))


@pytest.mark.parametrize("name", TURNS)
def test_masks_of_a_part_of_a_rotated_nifti_keep_their_voxels(name, tmp_path):
    turn = TURNS[name]
    grid = read_image(nifti(ball("bright"), turn, tmp_path / "ct.nii")).grid
    mask = ball("dark")
    part = nifti(mask[1:10, 3:30, 2:40], turn, tmp_path / "part.nii", (1, 3, 2))
    assert np.array_equal(open_regions(part, grid).mask(1), mask)


def test_mask_without_the_rotation_is_rejected(tmp_path):
    """0.9 degrees move the border of 200 voxels by 1.6 voxels."""
    affine, upright_affine = np.eye(4), np.eye(4)
    affine[:3, :3] = TURNS["about z"].as_matrix()
    upright_affine[:3, 3] = (affine[:3, :3] - np.eye(3)) @ [99.5, 99.5, 1]  # around the same center
    mask = np.zeros((200, 200, 3), np.int16)
    mask[150:180, 20:40, 1] = 1
    for name, one in (("ct", affine), ("upright", upright_affine)):
        nibabel.save(nibabel.Nifti1Image(mask, one), tmp_path / f"{name}.nii")
    grid = read_image(tmp_path / "ct.nii").grid
    assert np.array_equal(open_regions(tmp_path / "ct.nii", grid).mask(1), mask.T == 1)
    with pytest.raises(InputError, match="lies on another grid than the CT, with rotated axes"):
        open_regions(tmp_path / "upright.nii", grid)


def test_files_without_a_rotation_of_less_than_half_a_voxel_are_read(tmp_path):
    """0.2 degrees move the border of slices of 8 mm by 0.014 mm, and the end of the stack of 14 mm by 0.12 pixels."""
    grid = read_series(write_series(rotated_slices(SMALL), tmp_path / "ct")).grid
    mask = nifti(ball("dark"), Rotation.identity(), tmp_path / "m.nii")
    assert np.array_equal(open_regions(mask, grid).mask(1), ball("dark"))
    seg = pydicom.dcmread(write_seg(rotated_slices(Rotation.identity()), tmp_path / "seg.dcm"))
    seg.save_as(tmp_path / "seg.dcm")
    assert np.array_equal(open_regions(tmp_path / "seg.dcm", grid).mask(1), ball("bright"))
    struct = structure_set((1, "a", outlines(ball("bright"), SMALL, flat=True)), path=tmp_path / "rt.dcm")
    assert np.array_equal(open_regions(struct, grid).mask("a"), ball("bright"))
