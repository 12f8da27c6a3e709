"""Contours of RT Structure Sets: every contour, slice and name is read, or reported with the reason."""

import logging
from fractions import Fraction

import numpy as np
import phantom_files
import pydicom
import pytest
from structure_files import GRID, Z, circle, contour, disc, structure_set

from virtual_phantom.base.console import NOTES
from virtual_phantom.base.errors import InputError
from virtual_phantom.phantom.masks import open_regions, report_other_frame

XOR, INTERPOLATED = "CLOSEDPLANAR_XOR", "INTERPOLATED_PLANAR"
SLICES = range(4, 9)
OUTER = circle(20, Z[6])
# A ring as one contour: the outer circle, a narrow channel, and the inner circle in the opposite direction.
KEYHOLE = np.vstack([OUTER, OUTER[:1], circle(10, Z[6])[:1], circle(10, Z[6])[::-1]])
RING = disc(20) & ~disc(10)


def read(path, label=None, **options):
    return open_regions(path, GRID).mask(label, **options)


@pytest.fixture
def written(tmp_path):
    return lambda *rois, **more: structure_set(*rois, path=tmp_path / "rt.dcm", **more)


@pytest.mark.parametrize(
    ("contours", "expected", "remark"),
    [
        ([OUTER, OUTER], disc(20), "1 contour of it is stored more than once"),
        ([OUTER, OUTER[::-1], OUTER], disc(20), "2 contours of it are stored more than once"),
        ([OUTER, circle(20, Z[6], points=90, turn=0.3)], disc(20), "stored more than once"),
        ([OUTER, circle(20.3, Z[6])], disc(20), "stored more than once"),
        ([(OUTER, XOR), (OUTER, XOR)], disc(20), "stored more than once"),
        ([OUTER, np.vstack([OUTER, OUTER[:1]])], disc(20), "more than once"),
        ([OUTER, circle(10, Z[6])], RING, None),
        ([circle(10, Z[6])[::-1], OUTER], RING, None),
        ([OUTER, circle(10, Z[6]), circle(10, Z[6])], RING, "stored more than once"),
        ([OUTER, circle(14, Z[6]), circle(8, Z[6])], disc(20) & ~disc(14) | disc(8), None),
        ([KEYHOLE], RING, None),
        ([(OUTER, XOR), (circle(10, Z[6]), XOR)], RING, None),
        ([(OUTER, XOR), (circle(14, Z[6]), XOR), (circle(8, Z[6]), XOR)], disc(20) & ~disc(14) | disc(8), None),
        ([(circle(12, Z[6], x=-8), XOR), (circle(12, Z[6], x=9), XOR)], disc(12, -8) ^ disc(12, 9), None),
        (
            [circle(12, Z[6], x=-8), circle(12, Z[6], x=9)],
            disc(12, -8) | disc(12, 9),
            "1 contour of it overlaps another contour partly",
        ),
        ([circle(8, Z[6], x=-20), circle(8, Z[6], x=20)], disc(8, -20) | disc(8, 20), None),
        ([(OUTER, INTERPOLATED)], disc(20), None),
        ([(OUTER, INTERPOLATED), circle(10, Z[6])], RING, None),
        ([(OUTER, None)], disc(20), "1 contour without ContourGeometricType is read as CLOSED_PLANAR"),
        ([(OUTER, "")], disc(20), "without ContourGeometricType"),
    ],
)
def test_contours_of_a_slice_enclose_the_region(contours, expected, remark, written, caplog):
    items = [contour(*one) if isinstance(one, tuple) else contour(one) for one in contours]
    mask = read(written((1, "a", items)))
    assert np.array_equal(mask[6], expected) and mask.sum() == expected.sum()
    notes = [record.getMessage() for record in caplog.records if record.name == NOTES.name]
    assert (remark in notes[0]) if remark else not notes


def test_voxels_on_the_outline_belong_to_the_region_despite_rounding():
    """PS3.3, C.8.8.6.3: points on the contour are part of the ROI. Outlines through voxel centers are common."""
    from virtual_phantom.phantom.contours import Contour, _combine, _on_centers

    square = np.array([[2, 2], [2, 8], [8, 8], [8, 2]], float)
    for noise in (0, 1e-9, -1e-9, 0.004):
        plane = np.zeros((12, 12), bool)
        hole = np.array([[4, 4], [4, 6], [6, 6], [6, 4]], float)
        rounded = [_on_centers(one + noise, GRID) for one in (square, hole)]
        _combine([Contour(one, 0.0, False) for one in rounded], plane, np.zeros(2, int))
        expected = np.zeros((12, 12), bool)
        expected[2:9, 2:9] = True
        expected[5, 5] = False
        assert np.array_equal(plane, expected)


@pytest.mark.parametrize(
    ("item", "remark"),
    [
        (contour([[0, 0, Z[6]]], "POINT"), "1 contour of type POINT, which encloses no area, is skipped"),
        (contour(OUTER[:40], "OPEN_PLANAR"), "1 contour of type OPEN_PLANAR, which encloses no area, is skipped"),
        (
            contour(OUTER[:40] + [0, 0, 40], "OPEN_NONPLANAR"),
            "1 contour of type OPEN_NONPLANAR, which encloses no area",
        ),
        (contour(OUTER, "CLOSED_CURVE"), "1 contour of the unknown type CLOSED_CURVE is skipped"),
        (contour(OUTER[:2]), "1 contour of fewer than 3 points, which encloses no area, is skipped"),
        (contour([], NumberOfContourPoints=None), "1 contour without points is skipped"),
        (contour([], ContourData=None, NumberOfContourPoints=0), "1 contour without points is skipped"),
        (contour(circle(15, Z[6] + 1.5)), "1 contour between slices of the CT is skipped"),
        (contour(circle(15, Z[6] + 0.6)), "1 contour between slices of the CT is skipped"),
    ],
)
def test_skipped_contour_is_named_with_the_reason(item, remark, written, caplog):
    items = [contour(circle(20, Z[k])) for k in (6, 7)] + [item]
    mask = read(written((1, "a", items)))
    assert np.array_equal(mask[6], disc(20)) and np.array_equal(mask[7], disc(20)) and mask.sum() == 2 * disc(20).sum()
    (record,) = caplog.records
    assert f"ROI a: {remark}" in record.getMessage()


@pytest.mark.parametrize(
    ("item", "line"),
    [
        (contour(OUTER, NumberOfContourPoints=200), "has 256 points in ContourData and 200 by NumberOfContourPoints"),
        (contour(OUTER, ContourData=["1", "2", "3", "4"]), "has no valid ContourData"),
        (contour(OUTER, ContourData=None), "has 0 points in ContourData and 256 by NumberOfContourPoints"),
        (contour(OUTER * [1, 1, 0] + np.linspace([0, 0, Z[5]], [0, 0, Z[6]], 256)), "spans 3 mm along z"),
        (contour(circle(20, Z[6] + 1.5)), "does not lie in a slice of the CT"),
        (contour(circle(20, Z[-1] + 30)), "does not lie in a slice of the CT"),
        (contour(circle(20, Z[6], x=40)), "leaves the CT"),
        (contour(circle(0.5, Z[6], x=0.0)), "encloses no voxel center"),
        (contour([[0, 0, Z[6]]], "POINT"), "has no closed contour that can be filled"),
    ],
)
def test_unreadable_region_is_rejected_and_the_others_are_read(item, line, written):
    path = written((1, "bad", [item]), (2, "good", [contour(OUTER)]))
    with pytest.raises(InputError, match=f"ROI bad .*{line}|of ROI bad .*{line}") as caught:
        read(path, "bad")
    assert str(caught.value).isprintable()
    assert read(path, "good").sum() == disc(20).sum()


def test_two_rois_of_one_name_are_read_by_number(written):
    path = written(
        (3, "cyst", [contour(OUTER)]), (7, "cyst", [contour(circle(10, Z[6]))]), (8, "Cyst ", [contour(OUTER)])
    )
    regions = open_regions(path, GRID)
    assert regions.list_regions() == {3: "cyst", 7: "cyst", "Cyst": "Cyst"}
    assert regions.mask(3).sum() == disc(20).sum() and regions.mask("7").sum() == disc(10).sum()
    assert np.array_equal(regions.mask(8), regions.mask("Cyst"))
    with pytest.raises(InputError, match=r"2 ROIs are called 'cyst'; give the number as the label: 3 and 7"):
        regions.mask("cyst")
    with pytest.raises(InputError, match=r"ROI 'cysts' is not there; did you mean 'cyst'\?"):
        regions.mask("cysts")


def test_inconsistent_roi_numbers(written, caplog):
    ring = [contour(OUTER)]
    path = written((1, "a", ring), (1, "b", None), (2, None, ring), (4, "", ring), (5, "5 mm", None), (0, "zero", ring))
    regions = open_regions(path, GRID)
    assert set(regions.list_regions()) == {"a", "b", 2, 4, "5 mm", "zero"}
    with pytest.raises(InputError, match=r"ROI number 1 is given to several ROIs \(a, b\)"):
        regions.mask("a")
    assert regions.mask(2).sum() == regions.mask(4).sum() == regions.mask("0").sum() == disc(20).sum()
    assert "ROI number 2: is not in StructureSetROISequence" in caplog.text
    assert not regions.mask("5 mm").any()


def test_contours_of_one_roi_in_several_items_are_combined(written, caplog):
    path = written((1, "a", [contour(circle(20, Z[5]))]), (1, None, [contour(circle(10, Z[6]))]))
    mask = read(path, "a")
    assert mask[5].sum() == disc(20).sum() and mask[6].sum() == disc(10).sum()
    assert "2 items of ROIContourSequence refer to it" in caplog.text


@pytest.mark.parametrize("charset", [None, "ISO_IR 192", "ISO_IR 100"])
def test_names_in_other_scripts(charset, tmp_path):
    names = ["Lebér", "Größe"] + ([] if charset == "ISO_IR 100" else ["печень", "肝"])
    rois = [(n, name, [contour(circle(10 + n, Z[6]))]) for n, name in enumerate(names, 1)]
    path = structure_set(*rois, path=tmp_path / "rt.dcm", charset=charset or "ISO_IR 192")
    if charset is None:  # many programs write UTF-8 without declaring it
        dataset = pydicom.dcmread(path)
        raw = [name.encode() for name in names]
        del dataset.SpecificCharacterSet
        for item, name in zip(dataset.StructureSetROISequence, raw, strict=True):
            del item.ROIName
            item[0x30060026] = pydicom.dataelem.RawDataElement(
                pydicom.tag.Tag(0x30060026), "LO", len(name), name + b" " * (len(name) % 2), 0, False, True
            )
        dataset.save_as(path)
    regions = open_regions(path, GRID)
    assert list(regions.list_regions()) == names
    assert [int(regions.mask(name).sum()) for name in names] == [disc(10 + n).sum() for n in range(1, len(names) + 1)]


def sphere(every=1, radius=20.0):
    """Circles of a sphere around the CT's center in every n-th slice."""
    offsets = GRID.axes_mm()[0]
    inside = [k for k in range(len(Z)) if abs(offsets[k]) < radius - 1]
    return [contour(circle(np.sqrt(radius**2 - offsets[k] ** 2), Z[k])) for k in inside[::every]]


def test_slices_without_contours_are_reported_and_filled_on_request_only(written, caplog):
    z, y, x = np.ix_(*GRID.axes_mm())
    whole = z**2 + y**2 + x**2 < 400
    path = written((1, "ball", sphere(every=3)))
    striped = read(path)
    drawn = np.flatnonzero(striped.any(axis=(1, 2)))
    assert list(drawn) == [1, 4, 7, 10] and np.array_equal(striped[drawn], whole[drawn])
    assert "ROI ball: 6 of its 10 slices from z = 283.5 to 310.5 mm are not drawn and stay empty; to interpolate" in (
        caplog.text
    )
    filled = read(path, fill_gaps=True)
    assert np.array_equal(filled[drawn], whole[drawn])
    # Signed distances of concentric circles are linear in the radius.
    offsets = GRID.axes_mm()[0]
    for k in np.setdiff1d(np.arange(1, 11), drawn):
        radius = np.interp(k, drawn, np.sqrt(400 - offsets[drawn] ** 2))
        assert not (disc(radius - 1) & ~filled[k]).any() and not (filled[k] & ~disc(radius + 1)).any()
    assert "6 of its 10 slices from z = 283.5 to 310.5 mm are interpolated" in caplog.text


def test_separate_lesions_along_z_are_not_joined(written, caplog):
    path = written((1, "nodes", [contour(circle(8, Z[3], x=-20)), contour(circle(8, Z[7], x=20))]))
    mask = read(path, fill_gaps=True)
    assert mask.any(axis=(1, 2)).sum() == 2
    assert "3 stay empty, as the slices on both sides do not overlap" in caplog.text


def test_structure_set_is_recognized_by_its_class_and_without_a_preamble(written):
    path = written((1, "a", [contour(OUTER)]))
    dataset = pydicom.dcmread(path)
    del dataset.Modality
    dataset.save_as(path)
    assert read(path).sum() == disc(20).sum()
    bare = pydicom.Dataset()
    bare.update(dataset)
    for name, implicit in (("implicit.dcm", True), ("explicit.dcm", False)):
        bare.save_as(path.replace("rt.dcm", name), implicit_vr=implicit, little_endian=True, enforce_file_format=False)
        assert b"DICM" not in open(path.replace("rt.dcm", name), "rb").read(132)
        assert read(path.replace("rt.dcm", name)).sum() == disc(20).sum()


def test_missing_attribute_is_named(written):
    path = written((1, "a", [contour(OUTER)]))
    for keyword in ("StructureSetROISequence", "ROIContourSequence"):
        dataset = pydicom.dcmread(path)
        delattr(dataset, keyword)
        dataset.save_as(path.replace("rt", keyword))
        with pytest.raises(InputError, match=f"has no {keyword}; export the file again"):
            open_regions(path.replace("rt", keyword), GRID)


def test_notes_on_many_regions_are_one_line(written, caplog):
    from virtual_phantom.phantom.regions import Remark, report

    caplog.set_level(logging.WARNING)
    report("rt.dcm", [Remark("kind", f"ROI {n}", "text") for n in range(5)])
    assert [record.getMessage() for record in caplog.records] == [
        "rt.dcm: ROI 0: text",
        "rt.dcm: the same applies to 4 more regions (kind): ROI 1, ROI 2, ROI 3, ROI 4",
    ]


def test_balls_agree_with_their_contours(tmp_path):
    regions = open_regions(phantom_files.write_rtstruct(tmp_path / "rt.dcm"), GRID)
    for name in phantom_files.BALLS:
        assert np.array_equal(regions.mask(name), phantom_files.ball(name))


def test_other_frame_of_reference_is_reported(written, tmp_path, caplog):
    slices = phantom_files.ct_slices()
    series = phantom_files.write_series(slices, tmp_path / "ct")
    path = written((1, "a", [contour(OUTER)]))
    report_other_frame(path, series)  # no frame is named
    for frame, reported in ((slices[0].FrameOfReferenceUID, False), ("1.2.3", True)):
        dataset = pydicom.dcmread(path)
        dataset.StructureSetROISequence[0].ReferencedFrameOfReferenceUID = frame
        dataset.save_as(path)
        report_other_frame(path, series)
        assert ("another frame of reference than" in caplog.text) == reported
    seg = phantom_files.write_seg(slices, tmp_path / "seg.dcm")
    caplog.clear()
    report_other_frame(seg, series)
    report_other_frame(tmp_path / "missing.dcm", series)
    assert not caplog.records


def exactly(points, shape):
    """Voxels of a polygon by rational numbers: 0 outside, 1 inside, 2 on the outline."""
    corners = [tuple(map(Fraction, point)) for point in points.tolist()]
    found = np.zeros(shape, int)
    for row, column in np.ndindex(shape):
        for (r1, c1), (r2, c2) in zip(corners, corners[1:] + corners[:1], strict=True):
            if not min(r1, r2) <= row <= max(r1, r2):
                continue
            at = [c1, c2] if r1 == r2 else [c1 + (row - r1) * (c2 - c1) / (r2 - r1)]
            if min(at) <= column <= max(at):
                found[row, column] = 2
                break
            found[row, column] ^= r1 != r2 and row < max(r1, r2) and at[0] < column
    return found


def test_polygon_fill_agrees_with_rational_numbers_and_scikit_image():
    from skimage.measure import grid_points_in_poly

    from virtual_phantom.phantom.contours import _rasterized

    rng = np.random.default_rng(0)
    for number in range(120):
        points = rng.uniform(-0.5, 12.5, (rng.integers(3, 12), 2))
        if through := number % 4 == 0:  # voxel centers; scikit-image misses some of them on oblique edges
            points = np.clip(points.round(), 0, 12)
        box, within, on = _rasterized(points, (13, 13))
        found = np.zeros((13, 13), int)
        found[box] = within + 2 * on
        expected = exactly(points, (13, 13)) if through else grid_points_in_poly((13, 13), points, binarize=False)
        assert np.array_equal(found, expected)
