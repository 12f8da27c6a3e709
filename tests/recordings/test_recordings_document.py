"""recording.yaml: keys, names of files, and lengths that are not millimetres."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from recording_folders import SCAN, changed, features_folder, projections_folder, refused, write_yaml

from virtual_phantom.errors import InputError
from virtual_phantom.recordings.document import read_document
from virtual_phantom.recordings.scan import scan_geometry


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
        ("scan.column_offset_px", float("nan"), "not finite"),
        ("nominal.tube_kvp", 120000, "nominal.tube_kvp: 120000 is greater than the maximum of 500"),
        ("features", {}, "'features' has no meaning in a recording of projections"),
        ("rois", [{"name": "a", "tissue_class": "b", "file": "a.h5"}], "'rois' has no meaning"),
        ("repeats", ["a.h5", "none.h5"], "'none.h5' is not there"),
        ("repeats", ["a.h5", "a.h5"], "repeats"),
        ("repeats", ["a.h5", "./a.h5"], "are the same file"),
        ("held_out", ["b.h5"], "'b.h5' is among the repeats and held out"),
        ("scan.table_feed_mm", 20, "not 0 in a circular scan"),
        ("scan.trajectory", "helical", "scan.table_feed_mm is missing; a helical scan needs it"),
        ("scan.detector", "curved", "only flat ones can be simulated"),
    ],
)
def test_mistakes_are_told_in_one_line(bench, path, value, message):
    folder, content = bench
    refused(write_yaml(folder, changed(content, path, value)), message)


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
    "text, message", [("a: [1", "cannot be read as YAML"), ("- 1", "is not a mapping"), ("", "is not a")]
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
    from virtual_phantom.config import validate
    from virtual_phantom.recordings.document import _schema

    validate({"name": "a", "kind": "projections", "repeats": ["a"], "scan": scan}, _schema(), "a/recording.yaml")
    scan_geometry(scan, "a/recording.yaml")


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
