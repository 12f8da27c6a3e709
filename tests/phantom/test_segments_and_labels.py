"""DICOM SEG, label maps and masks in every form, compared with the source arrays."""

import gzip

import nibabel
import numpy as np
import phantom_files
import pydicom
import pytest
import SimpleITK as sitk
from phantom_files import BALLS, CT_GRID, ball, lps, segmentation, write_nifti_array

from virtual_phantom.base.errors import InputError
from virtual_phantom.phantom.masks import open_regions

LABELS = (ball("bright") * 1 + ball("dark") * 2).astype(np.uint8)


@pytest.fixture(scope="module")
def slices():
    return phantom_files.ct_slices()


def stacked(masks):
    return np.stack([lps(mask) for mask in masks], axis=-1)


@pytest.mark.parametrize("kind", ["BINARY", "FRACTIONAL", "LABELMAP"])
@pytest.mark.parametrize("order", [slice(None), slice(None, None, -1), slice(3, 12), slice(0, 14, 1)])
def test_segments_of_every_type_and_order_are_placed_by_their_frames(kind, order, slices, tmp_path, caplog):
    masks = stacked([ball(name) for name in BALLS])[order]
    array = lps(LABELS)[order] if kind == "LABELMAP" else masks.astype(np.float32 if kind == "FRACTIONAL" else np.uint8)
    path = segmentation(slices[order], tmp_path / "s.dcm", array, kind)
    regions = open_regions(path, CT_GRID)
    assert regions.list_regions() == {1: "bright", 2: "dark"}
    stored = np.isin(np.arange(14), np.arange(14)[order])[:, None, None]
    for n, name in enumerate(BALLS, 1):
        for label in (n, name, str(n)):
            assert np.array_equal(regions.mask(label), ball(name) & stored)
    assert ("FRACTIONAL; voxels of at least 0.5" in caplog.text) == (kind == "FRACTIONAL")


def test_segments_may_overlap_and_probabilities_are_thresholded_at_half(slices, tmp_path):
    z, y, x = np.ix_(*CT_GRID.axes_mm())
    distance = np.sqrt(z**2 + y**2 + x**2)
    soft = np.clip(1.5 - distance / 20, 0, 1).astype(np.float32)
    path = segmentation(slices, tmp_path / "s.dcm", stacked([soft, soft > 0.2]), "FRACTIONAL")
    regions = open_regions(path, CT_GRID)
    levels = np.rint(soft * 255)  # as stored
    assert np.array_equal(regions.mask(1), levels >= 127.5)
    assert np.array_equal(regions.mask(2), soft > 0.2)


def changed(path, change):
    dataset = pydicom.dcmread(path)
    change(dataset)
    dataset.save_as(path.replace("s.dcm", "changed.dcm"))
    return path.replace("s.dcm", "changed.dcm")


def _move(dataset):
    for group in dataset.PerFrameFunctionalGroupsSequence:
        x, y, z = group.PlanePositionSequence[0].ImagePositionPatient
        group.PlanePositionSequence[0].ImagePositionPatient = [x + 1, y, z]


def _beyond(dataset):
    for group in dataset.PerFrameFunctionalGroupsSequence:
        x, y, z = group.PlanePositionSequence[0].ImagePositionPatient
        group.PlanePositionSequence[0].ImagePositionPatient = [x, y, z + 21]


def _no_position(dataset):
    del dataset.PerFrameFunctionalGroupsSequence[0].PlanePositionSequence


def _no_number(dataset):
    del dataset.PerFrameFunctionalGroupsSequence[0].SegmentIdentificationSequence


LISTED = r"; its segments: 1 \(bright\), 2 \(dark\)$"


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (_move, f"lies on another grid than the CT: frame 1 has .*{LISTED}"),
        (_beyond, f"segment 1 goes beyond the CT.*{LISTED}"),
        (_no_position, f"frame 1 has no valid ImagePositionPatient.*{LISTED}"),
        (_no_number, f"frame 1 has no valid ReferencedSegmentNumber.*{LISTED}"),
        (lambda ds: delattr(ds, "PerFrameFunctionalGroupsSequence"), f"has no PerFrameFunc.*{LISTED}"),
        (lambda ds: setattr(ds, "NumberOfFrames", 3), f"NumberOfFrames is 3, and .*{LISTED}"),
        (lambda ds: delattr(ds, "SegmentSequence"), "has no SegmentSequence"),
        (lambda ds: setattr(ds.SegmentSequence[1], "SegmentNumber", 1), "SegmentNumber 1 is given twice"),
        (lambda ds: setattr(ds, "SegmentationType", "SOFT"), "SegmentationType is 'SOFT'; BINARY, FRACTIONAL"),
        (lambda ds: setattr(ds, "PixelData", ds.PixelData[:40]), f"its pixels cannot be read .*{LISTED}"),
    ],
)
def test_rejected_seg_reports_what_is_missing_and_lists_its_segments(change, line, slices, tmp_path):
    path = segmentation(slices, tmp_path / "s.dcm", stacked([ball(name) for name in BALLS]).astype(np.uint8))
    with pytest.raises(InputError, match=line):
        open_regions(changed(path, change), CT_GRID).mask(1)


def test_frames_without_segment_and_repeated_frames_are_reported(slices, tmp_path, caplog):
    path = segmentation(slices, tmp_path / "s.dcm", stacked([ball(name) for name in BALLS]).astype(np.uint8))

    def change(dataset):
        groups = dataset.PerFrameFunctionalGroupsSequence
        groups[1].PlanePositionSequence = groups[0].PlanePositionSequence
        groups[-1].SegmentIdentificationSequence[0].ReferencedSegmentNumber = 9

    regions = open_regions(changed(path, change), CT_GRID)
    assert regions.mask("bright").any() and regions.mask("dark").sum() < ball("dark").sum()
    assert "1 frame of no segment (number 9) skipped" in caplog.text
    assert "segment 1 (bright): 1 frame at the position of another frame of it" in caplog.text


@pytest.mark.parametrize(
    ("array", "label", "remark"),
    [
        (LABELS, 1, None),
        (LABELS.astype(np.int64), 1, None),
        (LABELS.astype(np.float64) + 1e-7, 1, None),
        (LABELS.astype(">i2"), 1, None),
        (LABELS.astype(np.float32) * np.float32(1.0000001), 1, None),
        ((LABELS == 1) * np.uint8(255), 255, None),
        ((LABELS == 1) * np.int16(1000), None, None),
        ((LABELS == 1) * np.float32(1 / 255), 1, "has the two values 0 and 0.00392157; it is read as a mask, label 1"),
        ((LABELS == 1) * np.float32(0.3), None, "has the two values 0 and 0.3"),
        ((LABELS == 1) * np.int8(-1), 1, "has the two values 0 and -1"),
        (np.where(LABELS == 1, 1, -1).astype(np.int16), 1, "labels below 0 are skipped: -1"),
        ((LABELS == 1) * np.int64(3_000_000_000), 3_000_000_000, None),
        ((LABELS == 1) * np.float64(70_000) + (LABELS == 2) * 5, 70_000, None),
    ],
)
def test_labels_of_any_type_and_scale_are_integers(array, label, remark, tmp_path, caplog):
    nibabel.save(nibabel.Nifti1Image(array.T, CT_GRID.affine, dtype=array.dtype), tmp_path / "l.nii.gz")
    regions = open_regions(tmp_path / "l.nii.gz", CT_GRID)
    assert np.array_equal(regions.mask(label), ball("bright"))
    assert label in regions.list_regions() or label is None
    assert remark in caplog.text if remark else not caplog.records


def test_probabilities_images_and_nan_are_rejected(tmp_path):
    rng = np.random.default_rng(0)
    noise = rng.normal(0, 10, CT_GRID.shape)
    for array, line in (
        (LABELS / 3, r"holds fractions from 0 to 0.6667, as probabilities or an interpolated mask do"),
        (phantom_files.object_hu() + noise, "holds fractions from -10"),
        (np.rint(phantom_files.object_hu() + noise), r"an image, not regions"),
        (np.rint(rng.uniform(0, 4000, CT_GRID.shape)), "different values above 0, up to 4000: an image, not regions"),
        (np.where(LABELS, np.nan, 0), "NaN"),
    ):
        path = write_nifti_array(array.astype(np.float32), tmp_path / "l.nii.gz")
        with pytest.raises(InputError, match=line):
            open_regions(path, CT_GRID)


def itk(array, path, grid=CT_GRID, header=(), vector=False):
    """Write with SimpleITK, in its own frame (LPS) and axis order."""
    image = sitk.GetImageFromArray(lps(array) if not vector else array[:, ::-1, ::-1], isVector=vector)
    image.SetSpacing(grid.spacing[::-1])
    x, y, z = (axis[[0, -1]] + c for axis, c in zip(grid.axes_mm()[::-1], grid.centre_mm, strict=True))
    image.SetOrigin((-x[1], -y[1], z[0]))
    for key, value in dict(header).items():
        image.SetMetaData(key, value)
    sitk.WriteImage(image, str(path))
    return path


@pytest.mark.parametrize(
    "name", ["l.nrrd", "l.NRRD", "l.nhdr", "l.mha", "L.MHD", "l.Nii", "l.NII.GZ", "l.hdr", "L.IMG"]
)
def test_every_format_in_upper_and_lower_case(name, tmp_path):
    path = tmp_path / name
    if name.lower().endswith((".nii", ".nii.gz", ".hdr", ".img")):
        kind = nibabel.Nifti1Pair if name.lower().endswith((".hdr", ".img")) else nibabel.Nifti1Image
        image = kind(LABELS.T, CT_GRID.affine)
        if kind is nibabel.Nifti1Pair:
            suffixes = ("HDR", "IMG") if name.isupper() else ("hdr", "img")
            files = [path.with_suffix(f".{suffix}") for suffix in suffixes]
            image.to_file_map(
                nibabel.Nifti1Pair.make_file_map(dict(zip(("header", "image"), map(str, files), strict=True)))
            )
        else:
            content = image.to_bytes()
            path.write_bytes(gzip.compress(content) if name.lower().endswith("gz") else content)
    else:
        itk(LABELS, tmp_path / name.lower())
        (tmp_path / name.lower()).rename(path)
    for label, ball_name in enumerate(BALLS, 1):
        assert np.array_equal(open_regions(path, CT_GRID).mask(label), ball(ball_name))


def test_slicer_segmentations_have_names_and_layers(tmp_path, caplog):
    header = {
        "Segment0_ID": "Segment_1",
        "Segment0_Name": "liver",
        "Segment0_LabelValue": "1",
        "Segment0_Layer": "0",
        "Segment1_ID": "Segment_2",
        "Segment1_Name": "lesion é",
        "Segment1_LabelValue": "1",
        "Segment1_Layer": "1",
    }
    both = np.stack([ball("bright"), ball("bright") | ball("dark")], axis=-1).astype(np.uint8)
    path = itk(both[2:13], tmp_path / "s.seg.nrrd", _part(2, 13), header, vector=True)
    regions = open_regions(path, CT_GRID)
    stored = np.isin(np.arange(14), np.arange(2, 13))[:, None, None]
    assert list(regions.list_regions().values()) == ["liver", "lesion é"]
    assert np.array_equal(regions.mask("liver"), ball("bright") & stored)
    assert np.array_equal(regions.mask("lesion é"), (ball("bright") | ball("dark")) & stored)
    assert (
        "has 48 x 40 x 11 voxels (x, y, z) of the CT's grid, which has 48 x 40 x 14; the rest is empty" in caplog.text
    )
    with pytest.raises(InputError, match=r"segment 'spleen' is not there; there are: liver \(liver\), lesion é"):
        regions.mask("spleen")


def _part(first, last):
    z = CT_GRID.axes_mm()[0][first:last].mean()
    grid = CT_GRID
    return type(grid)((last - first, *grid.shape[1:]), grid.spacing, (*grid.centre_mm[:2], grid.centre_mm[2] + z))


@pytest.mark.parametrize("kind", ["nifti", "nrrd", "cut.gz"])
def test_truncated_file_is_one_line(kind, tmp_path):
    path = tmp_path / {"nifti": "l.nii", "nrrd": "l.nrrd", "cut.gz": "l.nii.gz"}[kind]
    if kind == "nrrd":
        itk(LABELS, path)
    else:
        nibabel.save(nibabel.Nifti1Image(LABELS.T, CT_GRID.affine), path)
    content = path.read_bytes()
    path.write_bytes(content[: 9 * len(content) // 10])
    with pytest.raises(InputError, match=rf"{path.name}: .*is the file complete\?"):
        open_regions(path, CT_GRID)


def test_stripes_in_a_label_map_are_reported_and_filled_on_request_only(tmp_path, caplog):
    cylinder = np.zeros(CT_GRID.shape, bool)
    cylinder[3:12] = ball("bright")[9]
    striped = cylinder.copy()
    striped[4::3] = striped[5::3] = False
    regions = open_regions(write_nifti_array(striped.astype(np.uint8), tmp_path / "l.nii.gz"), CT_GRID)
    assert np.array_equal(regions.mask(1), striped)
    assert "label 1: 4 of its 7 slices from z = 289.5 to 307.5 mm are not drawn and stay empty" in caplog.text
    assert np.array_equal(regions.mask(1, fill_gaps=True)[3:10], cylinder[3:10])


def test_label_outside_of_the_ct_does_not_stop_the_others(tmp_path):
    larger = np.zeros((20, *CT_GRID.shape[1:]), np.uint8)
    larger[:14] = LABELS
    larger[12:18, :5, :5] = 3
    grid = type(CT_GRID)(larger.shape, CT_GRID.spacing, (*CT_GRID.centre_mm[:2], CT_GRID.centre_mm[2] + 9))
    regions = open_regions(write_nifti_array(larger, tmp_path / "l.nii.gz", grid=grid), CT_GRID)
    assert np.array_equal(regions.mask(1), ball("bright")) and np.array_equal(regions.mask(2), ball("dark"))
    for label, name in ((3, "label 3"), (None, "the mask")):
        with pytest.raises(InputError, match=f"lies on another grid than the CT, and {name} goes beyond the CT"):
            regions.mask(label)
