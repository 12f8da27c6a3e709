"""A CT and its ROIs in every format: correct positions, and doubtful input is rejected in one line."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from phantom_files import (
    BALLS,
    CENTRE,
    CT_GRID,
    ball,
    ct_slices,
    object_hu,
    write_nifti_array,
    write_rtstruct,
    write_seg,
    write_series,
)
from pydicom.uid import generate_uid
from scipy.ndimage import binary_dilation, label
from scipy.spatial import cKDTree

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.phantom import ct, read_rois, write_phantom, write_rois
from virtual_phantom.phantom.rois import cut, separate, shrink

GRID = Grid((14, 40, 48), (3.0, 2.0, 2.0))  # the CT's own voxels
ROOT = Path(__file__).resolve().parents[2]


def roi(name="bright", **more):
    return {"name": name, "tissue_class": "liver", **more}


@pytest.fixture
def slices():
    return ct_slices()


@pytest.fixture
def nifti(tmp_path):
    """Settings for a NIfTI CT and a label map: 3 is the bright ball, 7 the dark one."""
    labels = np.zeros(CT_GRID.shape, np.int16)
    labels[ball("bright")], labels[ball("dark")] = 3, 7
    return {
        "image": write_nifti_array(object_hu(), tmp_path / "ct.nii.gz"),
        "labels": write_nifti_array(labels, tmp_path / "labels.nii.gz"),
        "rois": [roi(label=3), roi("dark", label=7)],
    }


def load(settings, grid, oversampling):
    return ct.load_phantom(ct.read_settings(settings), grid, oversampling)


def refuse(settings, match, grid=GRID):
    with pytest.raises(InputError, match=match) as caught:
        load(settings, grid, 1)
    assert "\n" not in str(caught.value)


# ---- correct input -------------------------------------------------------------------------------


def test_dicom_series_is_read_by_position_into_the_world_frame(slices, nifti, tmp_path):
    nifti["image"] = write_series(slices, tmp_path / "dicom")
    phantom = load(nifti, GRID, 1)
    assert phantom.image.grid.centre_mm == pytest.approx(CENTRE)
    np.testing.assert_allclose(phantom.image.array, object_hu(), atol=1e-2)


@pytest.mark.parametrize("kind", ["labels", "flipped", "mask", "seg number", "seg label", "rtstruct"])
def test_every_region_format_gives_the_same_mask(kind, slices, nifti, tmp_path):
    nifti["image"] = write_series(slices, tmp_path / "dicom")
    bright = ball("bright").astype(np.uint8)
    entry = {
        "labels": lambda: {"label": 3},
        "flipped": lambda: {
            "file": write_nifti_array(bright * 3, tmp_path / "f.nii.gz", flip_y=True),
            "label": 3,
        },
        "mask": lambda: {"file": write_nifti_array(bright, tmp_path / "m.nii")},
        "seg number": lambda: {"file": write_seg(slices, tmp_path / "seg.dcm"), "label": 1},
        "seg label": lambda: {"file": write_seg(slices, tmp_path / "seg.dcm"), "label": "bright"},
        "rtstruct": lambda: {"file": write_rtstruct(tmp_path / "rt.dcm"), "label": "bright"},
    }[kind]()
    nifti["rois"] = [roi(**entry)]
    (loaded,) = load(nifti, GRID, 1).rois
    np.testing.assert_array_equal(loaded.mask, ball("bright"))


def test_inner_contour_is_a_hole(slices, nifti, tmp_path):
    nifti["rois"] = [roi(file=write_rtstruct(tmp_path / "rt.dcm", hole=True), label="bright")]
    (loaded,) = load(nifti, GRID, 1).rois
    filled = ball("bright")
    contours = filled.any(axis=(1, 2)).sum()
    assert filled.sum() - loaded.mask.sum() == 9 * contours
    assert not (loaded.mask & ~filled).any()


@pytest.mark.parametrize(
    ("shape", "spacing", "oversampling"),
    [((10, 24, 28), (4.2, 3.5, 3.6), 2), ((28, 64, 80), (1.5, 1.3, 1.3), 1)],
)
def test_other_grids_show_the_same_object(nifti, shape, spacing, oversampling):
    grid = Grid(shape, spacing)
    phantom = load(nifti, grid, oversampling)
    assert phantom.fine.grid.matches(phantom.image.grid.refined(oversampling))
    z, y, x = grid.axes_mm()
    for loaded, (centre, radius, hu) in zip(phantom.rois, BALLS.values(), strict=True):
        index = np.argwhere(loaded.mask)
        assert [axis[i].mean() for axis, i in zip((x, y, z), index.T[::-1], strict=True)] == pytest.approx(
            centre, abs=0.5
        )
        voxels = ball(loaded.name).sum() * CT_GRID.voxel_volume_mm3
        assert loaded.mask.sum() * grid.voxel_volume_mm3 == pytest.approx(voxels, rel=0.08)
        core = (
            ((x - centre[0]) ** 2)[None, None] + ((y - centre[1]) ** 2)[:, None] + ((z - centre[2]) ** 2)[:, None, None]
        ) < (radius - 5) ** 2
        assert phantom.image.array[core].mean() == pytest.approx(hu, abs=1)
    assert phantom.image.array.min() >= -1000


def test_detail_finer_than_the_grid_is_averaged_not_skipped(tmp_path, nifti):
    """Columns of +-90 HU in turn, and voxels three columns wide: means of +-30, a third."""
    hu = object_hu()
    hu[hu > -500] = 0
    hu += np.where(np.arange(48) % 2, 90, -90) * (hu > -500)
    nifti["image"] = write_nifti_array(hu.astype(np.float32), tmp_path / "stripes.nii.gz")
    image = load(nifti, Grid((14, 40, 16), (3.0, 2.0, 6.0)), 1).image.array
    assert np.abs(image[7, 18:22, 5:11]) == pytest.approx(30, abs=0.1)


def test_outside_of_the_ct_and_below_air_is_air(nifti, tmp_path):
    hu = object_hu()
    hu[:, :2] = -3024  # as some scanners store outside the field of view
    nifti["image"] = write_nifti_array(hu, tmp_path / "padded.nii.gz")
    phantom = load(nifti, Grid((18, 48, 56), (3.0, 2.0, 2.0)), 1)
    assert phantom.image.array.min() == -1000
    assert (phantom.image.array[[0, -1]] == -1000).all() and (phantom.image.array[:, :4] == -1000).all()


def test_centre_moves_the_grid(nifti):
    moved = (CENTRE[0] + 2, CENTRE[1] - 2, CENTRE[2] + 3)
    shifted = load({**nifti, "centre_mm": moved}, Grid((14, 44, 52), (3.0, 2.0, 2.0)), 1)
    assert shifted.image.grid.centre_mm == moved
    np.testing.assert_allclose(shifted.image.array[:-1, 3:43, 1:49], object_hu()[1:], atol=1e-2)


def test_keep_mm_removes_a_table(nifti, tmp_path):
    hu = object_hu()
    hu[:, 0] = 200  # a table, far behind
    nifti["image"] = write_nifti_array(hu, tmp_path / "table.nii.gz")
    slim = Grid((14, 34, 42), (3.0, 2.0, 2.0))
    needed = r"The grid spans 68 and 84 mm; set grid.shape to at least \[14, 40, 48\] \(z, y, x\)"
    refuse(nifti, rf"does not fit\. .* 80 mm along y and 96 mm along x\. {needed}", slim)
    kept = load({**nifti, "keep_mm": [[-60, 60], [CENTRE[1] - 36, CENTRE[1] + 36]]}, slim, 1)
    np.testing.assert_allclose(kept.image.array, object_hu()[:, 3:-3, 3:-3], atol=1e-2)


@pytest.mark.parametrize("margin", [2.0, 5.0])
def test_margin_is_a_distance_in_mm(margin):
    """Compare with the distance of every voxel to the nearest one outside, by a nearest-neighbor search."""
    region = ball("bright")
    places = np.indices(CT_GRID.shape).reshape(3, -1).T * CT_GRID.spacing
    nearest, _ = cKDTree(places[~region.ravel()]).query(places)
    np.testing.assert_array_equal(shrink(region, margin, CT_GRID).ravel(), nearest > margin)


def test_margin_leaves_the_end_of_the_scan_alone():
    organ = np.zeros((6, 20, 20), bool)
    organ[:, 5:15, 5:15] = True
    inner = shrink(organ, 1.5, Grid(organ.shape, (2.0, 1.0, 1.0)))
    expected = np.zeros_like(organ)
    expected[:, 6:14, 6:14] = True
    np.testing.assert_array_equal(inner, expected)


def test_parts_are_compact_similar_separate_and_ordered(nifti):
    nifti["rois"] = [roi("dark", label=7), roi("bright", label=3, parts=3)]
    rois = load(nifti, GRID, 1).rois
    assert [r.name for r in rois] == ["dark", "bright_1", "bright_2", "bright_3"]
    parts = [r.mask for r in rois[1:]]
    for i, part in enumerate(parts):
        assert label(part, np.ones((3, 3, 3)))[1] == 1
        assert 0.1 < part.sum() / ball("bright").sum() < 0.5
        others = np.logical_or.reduce([p for j, p in enumerate(parts) if j != i])
        assert not (binary_dilation(part, np.ones((3, 3, 3))) & others).any()
    x = [np.argwhere(p)[:, 2].mean() for p in parts]
    assert x == sorted(x, reverse=True)
    again = load(nifti, GRID, 1).rois
    assert all((a.mask == b.mask).all() for a, b in zip(rois, again, strict=True))


def test_cut_loses_no_voxel_and_separate_only_removes_touching_ones():
    pieces = cut(ball("bright"), 4, CT_GRID)
    np.testing.assert_array_equal(sum(p.astype(int) for p in pieces), ball("bright"))
    a, b = np.zeros((2, 1, 1, 6), bool)
    a[..., :3], b[..., 3:] = True, True
    left, right = separate([a, b])
    assert left.ravel().tolist() == [1, 1, 0, 0, 0, 0] and right.ravel().tolist() == [0, 0, 0, 0, 1, 1]


# ---- rejected input ------------------------------------------------------------------------------


def test_ct_must_exist_and_be_complete_and_in_hu(nifti, tmp_path):
    hu = object_hu()
    refuse({**nifti, "image": str(tmp_path / "no.nii.gz")}, "no.nii.gz: no such file")
    refuse({**nifti, "image": str(tmp_path / "nowhere")}, "nowhere: no such CT")
    refuse(
        {**nifti, "image": write_nifti_array(hu + 1024, tmp_path / "raw.nii.gz")},
        "raw.nii.gz: .* subtract 1024",
    )
    for bad in (np.nan, np.inf):
        spoilt = hu.copy()
        spoilt[3, 4, 5] = bad
        refuse(
            {**nifti, "image": write_nifti_array(spoilt, tmp_path / "nan.nii.gz")},
            "1 voxels are NaN or infinite",
        )
    (tmp_path / "short.nii.gz").write_bytes((tmp_path / "ct.nii.gz").read_bytes()[:400])
    refuse({**nifti, "image": str(tmp_path / "short.nii.gz")}, "short.nii.gz: cannot be read as NIfTI")
    refuse(
        {**nifti, "image": write_nifti_array(np.full_like(hu, -1000), tmp_path / "air.nii.gz")},
        "denser than -500 HU",
    )


def _drop(s):
    del s[5]


def _drop_rescale(s):
    del s[2].RescaleIntercept


def _second_series(s):
    s[3].SeriesInstanceUID = generate_uid()


def _double(s):
    s[4].ImagePositionPatient = s[3].ImagePositionPatient


def _tilt(s):
    for one in s:
        one.ImageOrientationPatient = [1, 0, 0, 0, 0.98, 0.199]


def _gantry(s):
    for one in s:
        one.GantryDetectorTilt = 5


def _shear(s):
    for k, one in enumerate(s):
        one.ImagePositionPatient = [
            one.ImagePositionPatient[0],
            one.ImagePositionPatient[1] + k / 2,
            one.ImagePositionPatient[2],
        ]


def _mixed(s):
    s[6].ImageOrientationPatient = [-1, 0, 0, 0, -1, 0]


def _magnetic(s):
    s[0].Modality = "MR"


def _coarser(s):
    s[1].PixelSpacing = [2.5, 2.5]


def _lonely(s):
    del s[1:]


def _unplaced(s):
    del s[7].ImagePositionPatient


@pytest.mark.parametrize(
    ("spoil", "match"),
    [
        (_drop, "slices are 3 mm apart, but those at z = 292.5 and 298.5 mm 6 mm: a slice is missing"),
        (_drop_rescale, "has no RescaleIntercept, so its values cannot be turned into HU"),
        (_second_series, "more than one DICOM series"),
        (_double, "two slices at z = "),
        (_tilt, "tilted or not axial"),
        (_gantry, "tilted or not axial"),
        (_shear, "shifted sideways"),
        (_mixed, "orientation differs"),
        (_magnetic, "modality is MR, not CT"),
        (_coarser, "slice size or pixel spacing differs"),
        (_lonely, "one slice only"),
        (_unplaced, "has no ImagePositionPatient"),
    ],
)
def test_doubtful_series_is_rejected(spoil, match, slices, nifti, tmp_path):
    spoil(slices)
    refuse({**nifti, "image": write_series(slices, tmp_path / "dicom")}, match)


def test_broken_slice_and_empty_folder_are_rejected(slices, nifti, tmp_path):
    folder = Path(write_series(slices, tmp_path / "dicom"))
    whole = (folder / "003.dcm").read_bytes()
    (folder / "003.dcm").write_bytes(whole[: len(whole) // 2])
    refuse({**nifti, "image": str(folder)}, "pixel data cannot be read|cannot be read as DICOM")
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty/readme.txt").write_text("no DICOM here")
    refuse({**nifti, "image": str(tmp_path / "empty")}, "holds no DICOM file")


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"label": 9}, "no voxel has the label 9; there are: 3, 7"),
        ({"label": "liver"}, "label 'liver' must be a whole number"),
        ({"label": 3, "margin_mm": 20}, "ROI bright is lost by margin_mm 20"),
        ({"label": 0}, "phantom: ct: rois.0.label: 0 is less than the minimum of 1"),
        ({"label": 3, "margin_mm": -1}, "rois.0.margin_mm: -1 is less than the minimum of 0"),
        ({"label": 3, "parts": 0}, "rois.0.parts: 0 is less than the minimum of 1"),
        ({"label": 3, "parts": 2.0}, "rois.0.parts: 2.0 is not a whole number to YAML; write 2"),
        ({"label": 3, "parts": 60}, "ROI bright_[0-9]+ (is lost between|fills no voxel)"),
        ({"label": 3, "color": "red"}, "unknown key 'color' in rois.0; known keys: name, tissue_class"),
        ({"label": 3, "name": "dark"}, "the name dark is given twice"),
        ({"label": 3, "name": "DARK"}, "the names DARK and dark differ only in case; rename one of them"),
        ({"label": 3, "name": "a-b"}, "rois.0.name: 'a-b' must be of letters"),
        ({"label": 3, "tissue_class": None}, "rois.0.tissue_class: is null or empty to YAML; give text"),
        ({"file": "nowhere.nii.gz"}, "nowhere.nii.gz: no such file"),
    ],
)
def test_bad_roi_entry_is_rejected(change, match, nifti):
    nifti["rois"][0] = {**roi(), **change}
    refuse(nifti, match)


def test_names_of_parts_must_differ_from_other_names(nifti):
    nifti["rois"] = [roi("a", label=3, parts=2), roi("a_2", label=7)]
    refuse(nifti, "the name a_2 is given twice")


def test_bad_settings_are_rejected(nifti):
    refuse({**nifti, "scale": 2}, "phantom: ct: unknown key 'scale'")
    refuse({k: v for k, v in nifti.items() if k != "image"}, "^phantom: ct: image is missing")
    refuse({**nifti, "rois": []}, "phantom: ct: rois: ")
    refuse({k: v for k, v in nifti.items() if k != "labels"}, "bright: has no file")
    refuse({**nifti, "centre_mm": [0, 0]}, "centre_mm")
    refuse({**nifti, "centre_mm": [np.nan, 0, 0]}, "phantom: ct: centre_mm.0 is nan; give a finite number")
    refuse({**nifti, "centre_mm": [CENTRE[0], CENTRE[1], 0]}, "misses the CT")
    refuse({**nifti, "keep_mm": [0, 1]}, "keep_mm")
    refuse({**nifti, "keep_mm": [[900, 990], [0, 1]]}, "leaves nothing of the CT")


def test_masks_on_another_grid_empty_or_fractional_are_rejected(nifti, slices, tmp_path):
    mask = ball("bright").astype(np.float32)
    shifted = Grid(CT_GRID.shape, CT_GRID.spacing, (CENTRE[0] + 1, *CENTRE[1:]))
    for other in (
        shifted,
        Grid((14, 40, 47), CT_GRID.spacing, CENTRE),
        Grid(CT_GRID.shape, (3.0, 2.0, 2.1), CENTRE),
    ):
        array = np.ones(other.shape, np.uint8)
        nifti["rois"] = [roi(file=write_nifti_array(array, tmp_path / "o.nii.gz", grid=other))]
        refuse(nifti, "o.nii.gz: lies on another grid than the CT")
    nifti["rois"] = [roi(file=write_nifti_array(mask * 0, tmp_path / "e.nii.gz"))]
    refuse(nifti, "ROI bright is empty in .*e.nii.gz")
    soft = mask * np.linspace(0.2, 0.9, mask.shape[-1], dtype=np.float32)
    nifti["rois"] = [roi(file=write_nifti_array(soft, tmp_path / "p.nii.gz"))]
    refuse(nifti, "holds fractions")
    nifti["rois"] = [roi(file=write_nifti_array(mask * np.nan, tmp_path / "n.nii.gz"))]
    refuse(nifti, "holds NaN")


def test_bad_seg_and_rtstruct_are_rejected(nifti, slices, tmp_path):
    series = write_series(slices, tmp_path / "dicom")
    seg, rt = write_seg(slices, tmp_path / "seg.dcm"), write_rtstruct(tmp_path / "rt.dcm")

    def entry(**more):
        return {**nifti, "image": series, "rois": [roi(**more)]}

    refuse(
        entry(file=seg, label=5),
        r"segment 5 is not there; there are: 1 \(bright\), 2 \(dark\)",
    )
    refuse(entry(file=seg), "label is needed; there are: 1")
    refuse(
        entry(file=rt, label="liver"),
        r"ROI 'liver' is not there; there are: bright \(1\), dark \(2\), nothing \(3\)",
    )
    refuse(entry(file=rt, label="nothing"), "ROI bright is empty")
    refuse(
        entry(file=write_rtstruct(tmp_path / "s.dcm", shift_z_mm=1.5), label="dark"),
        "does not lie in a slice of the CT",
    )
    refuse(
        entry(file=str(tmp_path / "dicom/001.dcm")),
        "modality is CT; ROIs are read from DICOM SEG or RTSTRUCT",
    )
    (tmp_path / "text.dcm").write_text("not DICOM")
    refuse(entry(file=str(tmp_path / "text.dcm")), "neither NIfTI nor readable DICOM")
    for one in slices:
        one.ImagePositionPatient = [one.ImagePositionPatient[0] + 0.7, *one.ImagePositionPatient[1:]]
    refuse(
        {**entry(file=seg, label=1), "image": write_series(slices, tmp_path / "moved")},
        "lies on another grid than the CT",
    )


def test_roi_outside_the_grid_is_rejected(nifti):
    nifti["rois"] = [roi(label=3)]
    refuse(
        {**nifti, "centre_mm": [CENTRE[0], CENTRE[1], CENTRE[2] - 16]},
        "ROI bright: 100 % of it lies outside the grid; enlarge grid.shape",
        Grid((4, 40, 48), (3.0, 2.0, 2.0)),
    )


def test_roi_too_small_for_the_grid_is_rejected(nifti, tmp_path):
    dot = np.zeros(CT_GRID.shape, np.uint8)
    dot[7, 20, 24] = 1
    nifti["rois"] = [roi(file=write_nifti_array(dot, tmp_path / "dot.nii.gz"))]
    refuse(nifti, "ROI bright fills no voxel of the grid by half", Grid((7, 20, 24), (6.0, 4.0, 4.0)))


def test_roi_that_the_grid_cuts_is_rejected_with_the_share(nifti):
    """The share refers to the volume: the border passes through voxels."""
    nifti["rois"] = [roi(label=3)]
    z = CT_GRID.axes_mm()[0]
    for top in (13.5, 12.0, 10.0):
        above = np.clip((z + 1.5 - top) / 3, 0, 1)
        share = 100 * (ball("bright") * above[:, None, None]).sum() / ball("bright").sum()
        assert share > 1
        centre = [*CENTRE[:2], CENTRE[2] + top - 21]
        message = rf"ROI bright: {share:.3g} % of it lies outside the grid; enlarge grid\.shape or grid\.spacing_mm"
        refuse({**nifti, "centre_mm": centre}, message)
    load({**nifti, "centre_mm": [*CENTRE[:2], CENTRE[2] - 6]}, GRID, 1)  # its last slice ends at 15 mm


def test_roi_that_keep_mm_cuts_is_rejected_with_the_share(nifti):
    nifti["rois"] = [roi(label=3)]
    x = CT_GRID.axes_mm()[2]
    beyond = ball("bright") & (x > 20)
    share = 100 * beyond.sum() / ball("bright").sum()
    keep = [[-90, CENTRE[0] + 20], [-90, 90]]
    refuse({**nifti, "keep_mm": keep}, rf"ROI bright: {share:.3g} % of it lies outside phantom\.ct\.keep_mm")
    keep[0][1] = CENTRE[0] + 24
    load({**nifti, "keep_mm": keep}, GRID, 1)


def test_part_is_rejected_although_the_whole_would_pass(nifti, tmp_path):
    """Three voxels at the end of a bar are cut off: under 1 % of the bar, and over 1 % of its last part."""
    bar = np.zeros(CT_GRID.shape, np.uint8)
    bar[5:9, 18:22, 6:42] = 1
    bar[5, 18:21, 42] = 1
    nifti["rois"] = [roi(file=write_nifti_array(bar, tmp_path / "bar.nii.gz"))]
    nifti["keep_mm"] = [[-90, CENTRE[0] + CT_GRID.axes_mm()[2][41]], [-90, 90]]
    load(nifti, GRID, 1)
    nifti["rois"][0]["parts"] = 6
    refuse(nifti, r"ROI bright_1: [1-5][.0-9]* % of it lies outside phantom\.ct\.keep_mm")


def test_roi_that_ends_with_the_ct_is_not_cut_by_the_grid(nifti, tmp_path):
    column = np.zeros(CT_GRID.shape, np.uint8)
    column[:, 18:22, 20:24] = 1
    nifti["rois"] = [roi(file=write_nifti_array(column, tmp_path / "column.nii.gz"))]
    (loaded,) = load(nifti, GRID, 1).rois
    assert loaded.mask.sum() == column.sum()


def test_labels_of_the_file_are_listed_with_their_numbers(nifti, tmp_path):
    labels = 7 * ball("bright").astype(np.uint8) + 4 * ball("dark").astype(np.uint8)
    file = write_nifti_array(labels, tmp_path / "labels.nii.gz")
    rois = [{"name": "b", "tissue_class": "x", "file": file, "label": 7, "parts": 2}]
    rois.append({"name": "d", "tissue_class": "y", "file": file, "label": 4})
    made = load({**nifti, "rois": rois}, GRID, 1)
    write_phantom(made, tmp_path / "phantom")
    table = pd.read_csv(tmp_path / "phantom" / "rois.csv")
    assert list(table["roi"]) == ["b_1", "b_2", "d"] and list(table["label"]) == [1, 2, 3]
    assert list(table["label_in_file"]) == [7, 7, 4]
    # ROIs of a recording are those of the phantom and may come from a file without labels.
    again = read_rois(tmp_path / "phantom" / "rois.csv", made.image.grid)
    assert [(roi.name, roi.label_in_file) for roi in again] == [("b_1", "7"), ("b_2", "7"), ("d", "4")]
    write_rois([*again[1:], replace(again[0], name="whole", label_in_file=None)], made.image, tmp_path / "recording")
    again = read_rois(tmp_path / "recording" / "rois.csv", made.image.grid)
    assert [(roi.name, roi.label_in_file) for roi in again] == [("b_2", "7"), ("d", "4"), ("whole", None)]


# ---- a clinical CT -------------------------------------------------------------------------------


@pytest.mark.real
def test_clinical_abdomen_loads_as_configured(monkeypatch, tmp_path):
    if not (ROOT / "../shared/real/abdomen_ct").exists():
        pytest.skip("needs abdomen_ct among the real measurements")
    (tmp_path / "resources").mkdir()
    (tmp_path / "resources" / "abdomen_ct").symlink_to(ROOT / "../shared/real/abdomen_ct")
    monkeypatch.chdir(tmp_path)
    config = yaml.safe_load((ROOT / "config/abdomen.yaml").read_text())
    grid = Grid(config["grid"]["shape"], config["grid"]["spacing_mm"])
    phantom = load(config["phantom"]["ct"], grid, 1)
    mean = {r.name: float(phantom.image.array[r.mask].mean()) for r in phantom.rois}
    voxels = {r.name: int(r.mask.sum()) for r in phantom.rois}
    assert len(mean) == 9 and min(voxels.values()) > 500
    liver = [name for name in mean if name.startswith("liver")]
    weighted = np.average([mean[n] for n in liver], weights=[voxels[n] for n in liver])
    assert weighted == pytest.approx(89, abs=5)  # the whole organ: 89 HU, SD 22
    assert mean["aorta"] > 120 and 10 < mean["muscle_left"] < 45 and 60 < mean["spleen_1"] < 110
    x = grid.axes_mm()[2]
    side = {r.name: x[np.nonzero(r.mask)[2]].mean() for r in phantom.rois}
    assert side["liver_1"] > 50 and side["spleen_1"] < -50 and side["aorta"] < 0  # liver on the patient's right
    assert side["muscle_right"] > 0 > side["muscle_left"]
