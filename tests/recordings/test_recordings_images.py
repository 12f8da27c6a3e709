"""Image recordings: NIfTI and DICOM repeats, their ROIs, and images that are not HU on one grid."""

import json
import re

import nibabel
import numpy as np
import phantom_files
import pytest
from phantom_files import CT_GRID, ball, ct_slices, object_hu, write_nifti_array, write_series
from recording_folders import changed, images_folder, refused, write_yaml
from scipy.spatial.transform import Rotation

from virtual_phantom.base.geometry import Grid
from virtual_phantom.recordings.reading import load_recording
from virtual_phantom.recordings.summary import summarize_recording


@pytest.fixture
def scanner(tmp_path):
    return images_folder(tmp_path / "scanner")


def dicom_folder(folder, **tags):
    """Two DICOM repeats; `tags` change attributes of the second repeat's slices."""
    content = {"name": "clinic", "kind": "images", "repeats": ["one", "two"]}
    write_yaml(folder, content)
    facts = {"KVP": 120, "ConvolutionKernel": ["Br38f", "3"], "ManufacturerModelName": "Edge", "SliceThickness": 3}
    for name in ("one", "two"):
        slices = ct_slices()
        for number, ds in enumerate(slices):
            for tag, value in (facts | {"Exposure": 100 + number} | (tags if name == "two" else {})).items():
                setattr(ds, tag, value)
        write_series(slices, folder / name)
    return folder, content


def test_repeats_and_rois_are_read_at_their_positions(scanner):
    recording = load_recording(scanner[0])
    assert recording.grid.matches(CT_GRID) and len(recording.repeats) == 2 and len(recording.held_out) == 0
    for image in recording.repeats:
        np.testing.assert_array_equal(image.array, object_hu())
    for roi in recording.rois():
        np.testing.assert_array_equal(roi.mask, ball(roi.name))
    assert [roi.tissue_class for roi in recording.rois()] == ["tumour", "fat"]


def test_dicom_facts_are_kept_and_patient_data_are_not(tmp_path):
    """PatientName is A^B, PatientID 1, StudyDate 20200101 in every slice."""
    folder, _ = dicom_folder(tmp_path / "clinic", PatientName="Doe^Jane", PatientBirthDate="19440101")
    recording = load_recording(folder)
    assert recording.provenance.dicom == {
        "tube_kvp": 120,
        "kernel": "Br38f/3",
        "slice_thickness_mm": 3,
        "model": "Edge",
        "spacing_mm": [2, 2],
        "mas": pytest.approx(106.5),
    }
    np.testing.assert_array_equal(recording.repeats[1].array, object_hu())
    text = json.dumps(summarize_recording(recording)) + repr(recording)
    text = re.sub("[0-9a-f]{64}", "", text)  # among 28 checksums, 1944 appears by chance occasionally
    for private in ("Doe", "Jane", "1944", "A^B", "20200101"):
        assert private not in text
    digests = summarize_recording(recording)["sha256"]
    assert len(digests["one"]) == len(digests["two"]) == 14 and all(len(digest) == 64 for digest in digests["one"])


@pytest.mark.parametrize(
    "grid",
    [
        Grid((14, 40, 48), (3.0, 2.0, 2.0), (5.0, -40.0, 301.0)),
        Grid((14, 40, 48), (3.0, 2.0, 2.05), phantom_files.CENTRE),
        Grid((13, 40, 48), (3.0, 2.0, 2.0), phantom_files.CENTRE),
    ],
)
def test_repeat_on_another_grid_is_rejected(scanner, grid):
    write_nifti_array(object_hu()[: grid.shape[0]], scanner[0] / "two.nii.gz", grid=grid)
    refused(scanner[0], "two.nii.gz: is on another grid")


def test_rotated_repeat_is_rejected(scanner):
    """0.9 degrees in either direction: the ends of 48 pixels are 0.74 pixels apart."""
    for name, degrees in (("one", 0.9), ("two", -0.9)):
        turn = np.eye(4)
        turn[:3, :3] = Rotation.from_rotvec([0, 0, np.radians(degrees)]).as_matrix()
        turn[:3, 3] = CT_GRID.centre_mm - turn[:3, :3] @ CT_GRID.centre_mm
        nibabel.save(nibabel.Nifti1Image(object_hu().T, turn @ CT_GRID.affine), scanner[0] / f"{name}.nii.gz")
    refused(scanner[0], "two.nii.gz: is rotated relative to one.nii.gz; resample it to the same grid")


@pytest.mark.parametrize("offset", [1000, 1024])
@pytest.mark.parametrize("padding", [None, -2000])
def test_stored_values_are_rejected(scanner, offset, padding):
    """Padding gives stored values a minimum below 0: only the tissue reveals them."""
    array = object_hu() + offset
    if padding:
        array[:, :3] = padding
    write_nifti_array(array, scanner[0] / "two.nii.gz")
    refused(scanner[0], f"two.nii.gz: {'5' if padding else 'has no value below 0'}")


@pytest.mark.parametrize(
    ("spoil", "check", "message"),
    [
        (lambda hu: np.clip(hu, -160, 240), "window", "two.nii.gz: 48 % of the voxels are exactly -160"),
        (lambda hu: 1000 - hu, "hu", "two.nii.gz: has no value below 0"),
        (lambda hu: -hu, "hu", "the values are inverted; multiply by -1"),
        (lambda hu: hu / 1000, "hu", "perhaps HU / 1000: multiply by 1000"),
        (lambda hu: hu - 1024, "hu", "perhaps HU - 1000 or HU - 1024: add 1000 or 1024"),
    ],
)
def test_images_are_checked_like_a_ct_unless_the_check_is_named(scanner, spoil, check, message):
    folder, content = scanner
    array = object_hu()
    write_nifti_array(spoil(array), folder / "two.nii.gz")
    refused(folder, message)
    assert len(load_recording(write_yaml(folder, content | {"not_checked": [check]})).repeats) == 2
    refused(write_yaml(folder, content | {"not_checked": ["units"]}), "not_checked")


def test_dicom_without_rescale_is_rejected(tmp_path):
    refused(dicom_folder(tmp_path / "r", RescaleIntercept=0)[0], "two: has no value below 0, so these are not HU")


@pytest.mark.parametrize(
    "tags, message",
    [
        ({"ImageOrientationPatient": [1, 0, 0, 0, 0.9848, 0.1736]}, "tilted"),
        ({"GantryDetectorTilt": 12}, "tilted"),
        ({"ConvolutionKernel": ["Br59d", "3"]}, "one has Br38f/3; repeats must come from one scan"),
        ({"KVP": 100}, "two: tube_kvp is 100.0, but"),
        ({"SliceThickness": 2}, "two: slice_thickness_mm is 2.0"),
        ({"Modality": "MR"}, "modality is MR"),
    ],
)
def test_series_other_than_axial_ct_repeats_are_rejected(tmp_path, tags, message):
    refused(dicom_folder(tmp_path / "r", **tags)[0], message)


def test_mixed_orientations_and_sheared_series_are_rejected(tmp_path):
    folder, _ = dicom_folder(tmp_path / "r")
    slices = ct_slices()
    slices[5].ImageOrientationPatient = [-1, 0, 0, 0, 1, 0]
    write_series(slices, folder / "two")
    refused(folder, "orientation differs from the other slices'")
    slices = ct_slices()
    for number, ds in enumerate(slices):
        x, y, z = ds.ImagePositionPatient
        ds.ImagePositionPatient = [x, y + 0.5 * number, z]
    write_series(slices, folder / "two")
    refused(folder, "gantry tilt")


def test_inconsistent_slices_are_rejected(tmp_path):
    folder, _ = dicom_folder(tmp_path / "r")
    slices = ct_slices()
    for number, ds in enumerate(slices):
        ds.KVP = 120 if number else 80
    write_series(slices, folder / "two")
    refused(folder, "two: slices disagree on KVP (120.0, 80.0)")


def test_nominal_must_not_contradict_dicom(tmp_path):
    folder, content = dicom_folder(tmp_path / "r")
    refused(
        write_yaml(folder, content | {"nominal": {"kernel": "Br59d"}}), "nominal.kernel is Br59d, but the DICOM headers"
    )
    assert load_recording(write_yaml(folder, content | {"nominal": {"kernel": "Br38f/3", "tube_kvp": 120}}))


@pytest.mark.parametrize("factor", [0.1, 100.0])
def test_lengths_in_other_units_are_rejected(scanner, factor):
    spacing = tuple(factor * s for s in CT_GRID.spacing)
    write_nifti_array(object_hu(), scanner[0] / "one.nii.gz", grid=Grid(CT_GRID.shape, spacing))
    refused(scanner[0], "one.nii.gz: is")


def test_header_in_meters_is_rejected(scanner):
    image = nibabel.Nifti1Image(object_hu().T, CT_GRID.affine)
    image.header.set_xyzt_units("meter")
    nibabel.save(image, scanner[0] / "one.nii.gz")
    refused(scanner[0], "its header gives lengths in meter")


def test_broken_images_are_rejected(scanner):
    array = object_hu()
    array[3, 4, 5] = np.nan
    write_nifti_array(array, scanner[0] / "two.nii.gz")
    refused(scanner[0], "two.nii.gz: 1 voxels are NaN")
    whole = (scanner[0] / "one.nii.gz").read_bytes()
    (scanner[0] / "two.nii.gz").write_bytes(whole[: len(whole) // 2])
    refused(scanner[0], "two.nii.gz: cannot be read as NIfTI")


@pytest.mark.parametrize(
    "path, value, message",
    [
        ("labels", None, "recording.yaml: rois: "),
        ("labels", None, "has no file"),
        ("labels", "one.nii.gz", "no voxel has the label 1"),
        ("rois", [{"name": "a", "tissue_class": "b", "label": 7}], "no voxel has the label 7"),
        ("rois", [{"name": "a", "tissue_class": "b", "label": 0}], "recording.yaml: rois.0.label: 0 is less than"),
        ("rois", [{"name": "a", "tissue_class": "b", "label": 1, "margin_mm": 50}], "ROI a is lost by margin_mm"),
        ("rois", [{"name": "a", "tissue_class": "b", "label": 1}] * 2, "the name a is given twice"),
        ("scan", {"source_to_isocentre_mm": 1000, "source_to_detector_mm": 595}, "is not larger than"),
    ],
)
def test_impossible_regions_and_scan_facts_are_rejected(scanner, path, value, message):
    folder, content = scanner
    refused(write_yaml(folder, changed(content, path, value)), message)


def test_padding_is_reported(scanner):
    array = object_hu()
    array[:, :3] = -3024
    write_nifti_array(array, scanner[0] / "two.nii.gz")
    recording = load_recording(scanner[0])
    assert len(recording.notes) == 1 and recording.notes[0].startswith(
        "two.nii.gz: 8 % of the voxels are below -1100 HU"
    )
