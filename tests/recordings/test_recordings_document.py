"""recording.yaml: keys, names of files, and lengths that are not millimetres."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recording_folders import SCAN, changed, features_folder, projections_folder, refused, write_yaml

from virtual_phantom.base.errors import InputError, InputErrors
from virtual_phantom.recordings.document import read_document
from virtual_phantom.recordings.scan import has_view_times, scan_geometry, view_time_note


@pytest.fixture
def bench(tmp_path):
    return projections_folder(tmp_path / "bench")


def test_defaults_and_files(bench):
    folder, _ = bench
    document = read_document(folder)
    assert document.content["nominal"] == {} and document.content["origin"] == {}
    assert [path.name for path in document.files] == ["recording.yaml", "a.h5", "b.h5", "c.h5"]


@pytest.mark.parametrize(
    "path, value, message",
    [
        ("scna", {}, "unknown key 'scna' in recording.yaml; did you mean 'scan'?"),
        ("scan.coloumns", 40, "unknown key 'coloumns' in scan; did you mean 'columns'?"),
        ("nominal.kvp", 120, "unknown key 'kvp' in nominal"),
        ("kind", "sinograms", "kind is 'sinograms'; use one of images, projections, features"),
        ("kind", None, "'kind' is a required property"),
        ("name", "../up", "name"),
        ("repeats", [], "repeats"),
        ("scan", None, "'scan' is a required property"),
        ("scan.views", None, "'views' is a required property"),
        ("scan.views", 24.5, "scan.views: 24.5 is not of type 'integer'"),
        ("scan.direction", 0, "scan.direction is '0'; use one of 1, -1"),
        ("scan.column_offset_px", float("nan"), "scan.column_offset_px is nan; give a finite number"),
        ("nominal.tube_kvp", 120000, "nominal.tube_kvp: 120000 is greater than the maximum of 500"),
        ("features", {}, "'features' has no meaning in a recording of projections"),
        ("rois", [{"name": "a", "tissue_class": "b", "file": "a.h5"}], "'rois' has no meaning"),
        ("repeats", ["a.h5", "none.h5"], "'none.h5' does not exist"),
        ("repeats", ["a.h5", "a.h5"], "repeats"),
        ("repeats", ["a.h5", "./a.h5"], "are the same file"),
        ("held_out", ["b.h5"], "'b.h5' is under both repeats and held_out"),
        ("scan.table_feed_mm", 20, "not 0 in a circular scan"),
        ("scan.trajectory", "helical", "scan.table_feed_mm is missing; a helical scan needs it"),
        ("scan.detector", "curved", "flat, cylindrical"),
        ("scan.arc_radius_mm", 900.0, "set scan.detector: cylindrical"),
        ("scan.flying_focal_spot", [{"columns_mm": 1.0}], "flying_focal_spot"),
    ],
)
def test_mistakes_are_told_in_one_line(bench, path, value, message):
    folder, content = bench
    refused(write_yaml(folder, changed(content, path, value)), message)


def test_all_mistakes_are_told_at_once(bench):
    folder, content = bench
    wrong = {
        "scna": {},
        "scan.views": 24.5,
        "nominal.tube_kvp": 120000,
        "rois": [{"name": "a", "tissue_class": "b", "file": "a.h5"}],
        "scan.column_offset_px": float("nan"),
        "repeats": ["a.h5", "none.h5", "gone.h5"],
        "held_out": ["a.h5"],
    }
    for path, value in wrong.items():
        content = changed(content, path, value)
    with pytest.raises(InputErrors) as error:
        read_document(write_yaml(folder, content))
    said = (
        "scan.column_offset_px is nan; give a finite number",
        "unknown key 'scna'",
        "scan.views: 24.5 is not of type 'integer'",
        "tube_kvp: 120000 is greater",
        "'rois' has no meaning",
        "'none.h5' does not exist",
        "'gone.h5' does not exist",
        "'a.h5' is under both repeats and held_out",
    )
    for one in said:
        assert sum(one in line for line in error.value.lines) == 1, (one, error.value.lines)
    assert len(error.value.lines) == len(said)


@pytest.mark.parametrize(
    "name", ["../outside.h5", "sub/../../outside.h5", "..", "C:\\outside.h5", "..\\outside.h5", "."]
)
def test_paths_stay_in_the_folder(bench, tmp_path, name):
    folder, content = bench
    (tmp_path / "outside.h5").write_bytes(b"")
    refused(write_yaml(folder, changed(content, "repeats", [name])), "out of the folder")


def test_absolute_paths_and_links_out_of_the_folder_are_refused(bench, tmp_path):
    folder, content = bench
    outside = tmp_path / "outside.h5"
    outside.write_bytes((folder / "a.h5").read_bytes())
    refused(write_yaml(folder, changed(content, "repeats", [str(outside)])), "leads out of the folder")
    (folder / "link.h5").symlink_to(outside)
    refused(write_yaml(folder, changed(content, "repeats", ["link.h5"])), "is a link out of the folder")


@pytest.mark.parametrize(
    "text, message", [("a: [1", "cannot be read as YAML"), ("- 1", "is not a mapping"), ("", "is empty")]
)
def test_what_is_not_a_mapping_is_refused(tmp_path, text, message):
    (tmp_path / "recording.yaml").write_text(text)
    refused(tmp_path, message)


def test_a_folder_without_recording_yaml_is_refused(tmp_path):
    refused(tmp_path, "no such file; a recording is a folder with a recording.yaml")


def test_a_recording_of_features_has_no_scan(tmp_path):
    folder, content = features_folder(tmp_path / "table")
    refused(write_yaml(folder, content | {"scan": SCAN}), "'scan' has no meaning in a recording of features")


LENGTHS = ("source_to_isocentre_mm", "source_to_detector_mm", "column_pitch_mm", "row_pitch_mm")
CLINICAL = SCAN | {
    "source_to_isocentre_mm": 595,
    "source_to_detector_mm": 1085.6,
    "columns": 736,
    "column_pitch_mm": 1.2,
}


@given(st.sets(st.sampled_from(LENGTHS), min_size=1), st.sampled_from([0.1, 10.0]))
def test_any_length_in_centimetres_or_tenths_is_noticed(wrong, factor):
    """Whichever lengths are given in another unit, all of them included, the geometry becomes implausible."""
    scan = CLINICAL | {"rows": 64, "row_pitch_mm": 1.2}
    scan_geometry(scan, "right")
    mixed = scan | {key: scan[key] * factor for key in wrong}
    with pytest.raises(InputError) as error:
        read_like(mixed)
    assert "mm" in str(error.value)


def read_like(scan):
    """What the schema and then the geometry say of a scan section."""
    from virtual_phantom.io.schema import read_schema, validate
    from virtual_phantom.recordings.document import SCHEMA

    content = {"name": "a", "kind": "projections", "repeats": ["a"], "scan": scan}
    validate(content, read_schema(SCHEMA), "a/recording.yaml")
    scan_geometry(scan, "a/recording.yaml")


@pytest.mark.parametrize(
    ("stated", "interval_ms", "exposure_ms", "words"),
    [
        ({"rotation_time_ms": 480}, 20, None, None),
        ({"view_interval_ms": 20, "exposure_ms": 5}, 20, 5, None),
        ({"rotation_time_ms": 480, "view_interval_ms": 20.1, "exposure_ms": 0}, 20, 0, None),
        ({"exposure_ms": 1200}, 1200, 1200, "assumed to be the exposure, 1200 ms"),
        ({"exposure_ms": 0}, None, 0, "cannot be diagnosed"),
        ({}, None, None, "cannot be diagnosed"),
    ],
)
def test_times_are_as_stated_or_said_to_be_taken_for_granted(stated, interval_ms, exposure_ms, words):
    scan = {key: value for key, value in SCAN.items() if key != "rotation_time_ms"} | stated
    geometry = scan_geometry(scan, "a")
    assert (geometry.view_interval_ms, geometry.exposure_ms) == (interval_ms, exposure_ms)
    assert words is None and view_time_note(scan) is None or words in view_time_note(scan)
    assert has_view_times({"kind": "projections", "scan": scan}) == (interval_ms is not None)
    if interval_ms is None:
        with pytest.raises(InputError, match="the time between views is not known"):
            geometry.times_s  # noqa: B018
    else:
        # 24 views, each in the middle of its interval
        assert geometry.times_s * 1000 == pytest.approx((np.arange(24) - 11.5) * interval_ms)
        assert geometry.duration_s == pytest.approx(0.024 * interval_ms)
        assert geometry.every(5).times_s == pytest.approx(geometry.times_s[::5])


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ({"view_interval_ms": 25}, "scan.view_interval_ms is 25, but rotation_time_ms / views_per_rotation is 20"),
        ({"exposure_ms": 30}, "scan.exposure_ms 30 is longer than the time between views, 20 ms"),
    ],
)
def test_times_that_contradict_each_other_are_refused(stated, message):
    with pytest.raises(InputError, match=message):
        scan_geometry(SCAN | stated, "a")


def test_geometry_of_circle_and_helix():
    circle = scan_geometry(SCAN, "a")
    assert circle.angles_rad[:2] == pytest.approx([0.5235987756, 0.2617993878])  # 30 and 15 degrees: direction -1
    assert not circle.source_z_mm.any()
    helix = scan_geometry(
        SCAN | {"trajectory": "helical", "table_feed_mm": 12, "start_z_mm": -6, "views": 49, "column_offset_px": 0.25},
        "a",
    )
    assert helix.source_z_mm[[0, 24, 48]] == pytest.approx([-6, 6, 18])
    assert helix.feed_per_rotation_mm == pytest.approx(12) and helix.column_offset_px == 0.25
