"""Exported series have the same HU at the same positions in every reader."""

import dataclasses

import nibabel
import numpy as np
import pydicom
import pytest
import SimpleITK as sitk
from highdicom._standard_utils import check_required_attributes
from phantom_files import BALLS, CENTRE, CT_GRID, ball, object_hu

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.io import dicom_export
from virtual_phantom.io.volumes import Volume, write_nifti
from virtual_phantom.phantom.dicom_series import read_series
from virtual_phantom.phantom.masks import open_regions

# Anisotropic voxels, odd sizes and off center: a reversed, swapped or shifted axis changes the result.
GRID = Grid(CT_GRID.shape, (2.5, 2.35, 1.15), CENTRE)
SCAN = dicom_export.Scan("sirt_300", "sirt_300 dose10 seed 03 (simulated)", "SIRT of 300 projections.", 500.0, 1000.0)
PHANTOM = Volume(object_hu(), GRID)
MANDATORY = (
    "patient",
    "general-study",
    "general-series",
    "frame-of-reference",
    "general-equipment",
    "general-acquisition",
    "general-image",
    "image-plane",
    "image-pixel",
    "ct-image",
    "sop-common",
)


def noisy(seed=0):
    """HU with fractions, some below the range of 12 bits with the usual intercept."""
    return Volume(object_hu() + np.random.default_rng(seed).normal(0, 300, GRID.shape).astype(np.float32), GRID)


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dicom")
    slices = dicom_export.series(noisy(), PHANTOM, SCAN)
    dicom_export.write_series(slices, folder / "series")
    masks = {name: ball(name) for name in BALLS}
    dicom_export.write(dicom_export.segmentation(slices, masks), folder / "rois.dcm")
    return folder


def itk_series(folder):
    reader = sitk.ImageSeriesReader()
    reader.SetFileNames(sitk.ImageSeriesReader.GetGDCMSeriesFileNames(str(folder / "series")))
    return reader.Execute()


def test_simpleitk_reads_dicom_and_nifti_voxels_at_the_same_positions(exported, tmp_path):
    image = itk_series(exported)
    assert image.GetSize() == GRID.shape[::-1]
    assert image.GetSpacing() == pytest.approx(GRID.spacing[::-1], abs=1e-5)
    assert image.GetDirection() == pytest.approx(np.eye(3).ravel())
    last = GRID.affine @ (47, 39, 13, 1)
    assert image.GetOrigin() == pytest.approx((-last[0], -last[1], GRID.affine[2, 3]), abs=1e-4)

    write_nifti(noisy(), tmp_path / "image.nii.gz")
    nifti = sitk.ReadImage(str(tmp_path / "image.nii.gz"))
    onto = sitk.Resample(image, nifti, sitk.Transform(), sitk.sitkNearestNeighbor, -32768)
    np.testing.assert_allclose(sitk.GetArrayFromImage(onto), sitk.GetArrayFromImage(nifti), atol=0.5)
    # nibabel reads the affine that SimpleITK has converted to LPS.
    affine = nibabel.load(tmp_path / "image.nii.gz").affine
    index = (5, 3, 2)
    world = np.diag([-1, -1, 1]) @ (affine @ (*index, 1))[:3]
    np.testing.assert_allclose(nifti.TransformIndexToPhysicalPoint(index), world, atol=1e-4)


def test_pydicom_reads_hu_and_positions_slice_by_slice(exported):
    files = sorted((exported / "series").iterdir())
    assert len(files) == GRID.shape[0]
    hu = noisy().array
    for index, path in enumerate(files):
        one = pydicom.dcmread(path)
        values = one.pixel_array * float(one.RescaleSlope) + float(one.RescaleIntercept)
        np.testing.assert_allclose(values, hu[index, ::-1, ::-1], atol=0.5)
        # The first row is the most anterior, the first column the rightmost.
        x, y, z = (GRID.affine @ (47, 39, index, 1))[:3]
        assert list(one.ImagePositionPatient) == pytest.approx([-x, -y, z], abs=1e-4)


def test_library_reads_the_export_onto_the_same_grid(exported):
    back = read_series(exported / "series")
    assert back.grid.matches(GRID)
    np.testing.assert_allclose(back.array, noisy().array, atol=0.5)
    regions = open_regions(exported / "rois.dcm", back.grid)
    for name in BALLS:
        np.testing.assert_array_equal(regions.mask(name), ball(name))


def test_all_mandatory_attributes_and_no_patient_data(exported):
    one = pydicom.dcmread(exported / "series" / "001.dcm")
    for module in MANDATORY:
        check_required_attributes(one, module=module)
    assert one.SOPClassUID.name == "CT Image Storage"
    assert one.PatientName == "Virtual^Phantom" and one.QualityControlSubject == "YES"
    assert "Simulated" in one.ImageComments and "simulated" in one.SeriesDescription
    for keyword in ("PatientBirthDate", "PatientSex", "StudyDate", "AccessionNumber", "ReferringPhysicianName"):
        assert not one.get(keyword)
    # Text and numbers within DICOM's limits, none truncated on the way.
    with pydicom.config.disable_value_validation():
        raw = pydicom.dcmread(exported / "series" / "014.dcm")
    for element in raw:
        pydicom.dataelem.DataElement(element.tag, element.VR, element.value, validation_mode=pydicom.config.RAISE)


def test_equal_images_make_equal_files_and_other_images_other_uids(exported, tmp_path):
    again = dicom_export.series(noisy(), PHANTOM, SCAN)
    dicom_export.write_series(again, tmp_path)
    for path in sorted(tmp_path.iterdir()):
        assert path.read_bytes() == (exported / "series" / path.name).read_bytes()
    other = dicom_export.series(noisy(seed=1), PHANTOM, SCAN)
    elsewhere = dicom_export.series(noisy(), Volume(PHANTOM.array + 1, GRID), SCAN)
    uids = {one.SOPInstanceUID for slices in (again, other) for one in slices}
    assert len(uids) == 2 * GRID.shape[0] and all(uid.is_valid for uid in uids)
    assert other[0].SeriesInstanceUID != again[0].SeriesInstanceUID
    assert other[0].StudyInstanceUID == again[0].StudyInstanceUID != elsewhere[0].StudyInstanceUID
    assert other[0].FrameOfReferenceUID == again[0].FrameOfReferenceUID != elsewhere[0].FrameOfReferenceUID


@pytest.mark.parametrize(
    "image, message",
    [
        (Volume(PHANTOM.array, dataclasses.replace(GRID, centre_mm=(0, 0, 0))), "is on another grid"),
        (Volume(np.where(PHANTOM.array > 50, np.nan, 0), GRID), "not finite; reconstruct it again"),
        (Volume(PHANTOM.array + 40000, GRID), "CT numbers beyond 16 bits"),
    ],
)
def test_unsuitable_images_are_rejected_in_one_line(image, message):
    with pytest.raises(InputError) as caught:
        dicom_export.series(image, PHANTOM, SCAN)
    assert message in str(caught.value) and "\n" not in str(caught.value)
