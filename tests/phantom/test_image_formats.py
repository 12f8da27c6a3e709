"""Images of a CT in every format and orientation, compared with the source array."""

import gzip

import nibabel
import numpy as np
import phantom_files
import pytest
import SimpleITK as sitk
from phantom_files import CT_GRID, lps

from virtual_phantom.base.console import NOTES
from virtual_phantom.base.errors import InputError
from virtual_phantom.io.volumes import read_image, read_nifti, upright
from virtual_phantom.phantom.ct import read_hu

HU = phantom_files.object_hu()


@pytest.fixture
def notes(caplog):
    return lambda: [record.getMessage() for record in caplog.records if record.name == NOTES.name]


def nifti(path, array=HU, affine=CT_GRID.affine, kind=nibabel.Nifti1Image, **changed):
    image = kind(array.T, affine)
    image.set_sform(affine, code=1)
    image.set_qform(affine, code=1)
    for key, value in changed.items():
        image.header[key] = value
    content = image.to_bytes()
    path.write_bytes(gzip.compress(content) if path.name.lower().endswith("gz") else content)
    return path


def damaged(path, **fields):
    """Copy of a file with header fields replaced: {field: value}, in the dtype of the header."""
    content = bytearray(path.read_bytes())
    header = np.frombuffer(content[:348], nibabel.nifti1.header_dtype).copy()
    for key, value in fields.items():
        header[key] = value
    content[:348] = header.tobytes()
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("name", ["c.nrrd", "c.NRRD", "c.nhdr", "c.mha", "c.mhd"])
@pytest.mark.parametrize("flipped", [(1, 1, 1), (-1, 1, 1), (1, -1, -1)])
def test_itk_formats_agree_with_simpleitk(name, flipped, tmp_path, notes):
    image = sitk.GetImageFromArray(lps(HU).astype(np.int16))
    image.SetSpacing(CT_GRID.spacing[::-1])
    x, y, z = (axis[[0, -1]] + c for axis, c in zip(CT_GRID.axes_mm()[::-1], CT_GRID.centre_mm, strict=True))
    image.SetOrigin((-x[1], -y[1], z[0]))
    image = sitk.Flip(image, [one < 0 for one in flipped])  # also flips the direction: voxels keep their positions
    sitk.WriteImage(image, str(tmp_path / name.lower()))
    (tmp_path / name.lower()).rename(tmp_path / name)
    volume = read_hu(tmp_path / name)
    assert volume.grid.matches(CT_GRID) and np.array_equal(volume.array, HU) and volume.array.dtype == np.float32
    assert not notes()


@pytest.mark.parametrize(
    ("name", "options", "fields"),
    [
        ("c.Nii", {}, {}),
        ("c.NII.GZ", {}, {}),
        ("c.nii", {"kind": nibabel.Nifti2Image}, {}),
        ("c.nii", {"array": HU.astype(np.int16)}, {"scl_slope": 0, "scl_inter": 7}),
        ("c.nii", {"array": HU.astype(np.int16)}, {"scl_slope": np.nan, "scl_inter": 0}),
        ("c.nii", {"array": HU.astype(np.int16)}, {"bitpix": 64}),
        ("c.nii", {"array": HU.astype(">f8")}, {}),
        ("c.nii", {"array": HU[None]}, {}),
        ("c.nii", {"array": HU[None, None]}, {}),
    ],
)
def test_nifti_variants_are_the_same_image(name, options, fields, tmp_path):
    path = nifti(tmp_path / name, **options)
    volume = read_image(damaged(path, **fields) if fields else path)
    assert volume.grid.matches(CT_GRID) and np.array_equal(volume.array, HU)


def test_compression_is_detected_independently_of_the_name(tmp_path):
    path = nifti(tmp_path / "c.nii")
    (tmp_path / "d.nii.gz").write_bytes(path.read_bytes())
    (tmp_path / "e.nii").write_bytes(gzip.compress(path.read_bytes()))
    for name in ("d.nii.gz", "e.nii"):
        assert np.array_equal(read_image(tmp_path / name).array, HU)


@pytest.mark.parametrize(
    ("fields", "line"),
    [
        ({"dim": [3, 48, 40, 13, 1, 1, 1, 1]}, "7680 bytes after the voxels that its header describes"),
        ({"dim": [3, 48, 39, 14, 1, 1, 1, 1]}, "2688 bytes after the voxels that its header describes"),
        ({"datatype": 4}, "53760 bytes after the voxels"),
        ({"vox_offset": 352 + 16}, "is the file complete"),
        ({"dim": [3, 48, 40, 15, 1, 1, 1, 1]}, "48 x 40 x 15 voxels, which the file does not contain"),
        ({"dim": [4, 48, 40, 7, 2, 1, 1, 1]}, "has 4 dimensions; give a 3D image"),
        ({"magic": b"n+9"}, r"lacks the magic string 'n\+1'"),
        ({"magic": b""}, r"lacks the magic string 'n\+1'"),
        ({"sizeof_hdr": 0}, "has no NIfTI header"),
        ({"datatype": 2304}, "not numbers|cannot be read"),
        ({"srow_x": [0, 0, 0, 0]}, "no size or position"),
        ({"srow_x": [np.nan, 0, 0, 0]}, "no size or position"),
    ],
)
def test_damaged_header_is_one_line(fields, line, tmp_path):
    with pytest.raises(InputError, match=line):
        read_image(damaged(nifti(tmp_path / "c.nii"), **fields))


def test_color_and_complex_images_are_rejected(tmp_path):
    color = np.zeros(HU.T.shape, [("R", "u1"), ("G", "u1"), ("B", "u1")])
    nibabel.save(nibabel.Nifti1Image(color, CT_GRID.affine), tmp_path / "rgb.nii")
    nibabel.save(nibabel.Nifti1Image(HU.T.astype(np.complex64), CT_GRID.affine), tmp_path / "c.nii")
    for name in ("rgb.nii", "c.nii"):
        with pytest.raises(InputError, match="not numbers; give gray values"):
            read_nifti(tmp_path / name)


def test_pair_of_files_is_read_and_analyze_is_not(tmp_path):
    for kind in (nibabel.Nifti2Pair, nibabel.Nifti1Pair):
        nibabel.save(kind(HU.T, CT_GRID.affine), tmp_path / "c.hdr")
        for name in ("c.hdr", "c.img"):
            assert np.array_equal(read_image(tmp_path / name).array, HU)
    nibabel.save(nibabel.AnalyzeImage(HU.T, None), tmp_path / "a.hdr")
    with pytest.raises(InputError, match=r"a.hdr: is Analyze 7.5, not NIfTI, and does not say which side is left"):
        read_image(tmp_path / "a.hdr")
    (tmp_path / "c.img").unlink()
    with pytest.raises(InputError, match="c.img is missing; a header"):
        read_image(tmp_path / "c.hdr")


def rotated(degrees, axes=(0, 1)):
    affine = CT_GRID.affine
    turn = np.eye(4)
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn[axes[0], axes[0]] = turn[axes[1], axes[1]] = cosine
    turn[axes[0], axes[1]], turn[axes[1], axes[0]] = -sine, sine
    about = np.eye(4)
    about[:3, 3] = CT_GRID.centre_mm
    return about @ turn @ np.linalg.inv(about) @ affine


@pytest.mark.parametrize(
    ("degrees", "axes", "moved"),
    [(0.0, (0, 1), 0), (0.05, (0, 1), 0), (0.3, (0, 1), 0.12), (-0.3, (1, 2), 0.068), (1.0, (0, 1), 0.41)],
)
def test_small_tilt_is_treated_as_upright_and_reported(degrees, axes, moved, tmp_path, notes):
    volume = read_image(nifti(tmp_path / "c.nii", affine=rotated(degrees, axes)))
    assert np.array_equal(volume.array, HU) and volume.grid.matches(CT_GRID, 1e-3)
    if not moved:
        assert not notes()
        return
    (line,) = notes()
    assert f"its axes are tilted by {abs(degrees):.2g} degrees and treated as upright" in line
    # half of the voxels on one side of the center, times the sine of the angle
    assert float(line.split()[-4]) == pytest.approx(moved, abs=0.01)


@pytest.mark.parametrize("affine", [rotated(1.4), rotated(5), rotated(3, (1, 2)), rotated(30, (0, 2))])
def test_tilt_that_moves_voxels_by_more_than_half_of_one_is_rejected(affine, tmp_path):
    with pytest.raises(InputError, match=r"tilted against the scanner's by up to .* degrees, which moves voxels by up"):
        read_image(nifti(tmp_path / "c.nii", affine=affine))


def test_rotation_without_shear_may_move_voxels_farther():
    """0.3 degrees move the end of 400 voxels by 1.04 voxels."""
    angle, array = np.radians(0.3), np.arange(400.0 * 4 * 4).reshape(400, 4, 4)
    affine = np.eye(4)
    affine[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    volume = upright(array, affine, "c.nii")
    assert np.array_equal(volume.array, array.T) and volume.grid.spacing == pytest.approx((1, 1, 1))
    assert volume.grid.centre_mm == pytest.approx((affine @ [199.5, 1.5, 1.5, 1])[:3])
    affine[0, 1] = 0
    with pytest.raises(InputError, match="or a rotation of 1 degrees without shear"):
        upright(array, affine, "c.nii")


def test_two_orientations_or_none_are_reported(tmp_path, notes):
    path = nifti(tmp_path / "c.nii")
    shifted = nibabel.load(path)
    for millimeters, reported in ((0.5, False), (1.5, True), (30, True)):
        affine = CT_GRID.affine.copy()
        affine[0, 3] += millimeters
        shifted.set_qform(affine, code=1)
        nibabel.save(shifted, tmp_path / "q.nii")
        assert read_image(tmp_path / "q.nii").grid.matches(CT_GRID)  # sform
        assert any(f"up to {millimeters / 2:.3g} voxels apart; sform is used" in note for note in notes()) == reported
    read_image(damaged(nifti(tmp_path / "n.nii"), sform_code=0, qform_code=0))
    assert "n.nii: its header has no orientation (sform_code and qform_code are 0)" in notes()[-1]
