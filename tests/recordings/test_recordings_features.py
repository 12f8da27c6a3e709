"""Feature recordings: tables are read value by value, and wrong columns, names and rows are rejected."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recording_folders import changed, features_folder, features_table, refused, write_yaml

from virtual_phantom.features.extraction import FEATURES
from virtual_phantom.features.settings import other_settings
from virtual_phantom.features.table_files import read_table
from virtual_phantom.recordings.reading import load_recording
from virtual_phantom.recordings.summary import readable, summarize_recording, summary_table
from virtual_phantom.statistics.comparability import SIZED


@pytest.fixture
def table(tmp_path):
    return features_folder(tmp_path / "table")


def test_values_are_read_bit_for_bit(table):
    recording = load_recording(table[0])
    written = pd.concat([features_table(), features_table(start=3)], ignore_index=True)
    pd.testing.assert_frame_equal(recording.repeats, written[recording.repeats.columns], check_exact=True)
    assert recording.features == FEATURES and recording.held_out.empty
    assert recording.images_per_condition().to_dict() == {10: 6}


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=2, max_size=2))
@settings(max_examples=25, deadline=None)
def test_any_finite_value_survives(tmp_path_factory, values):
    path = tmp_path_factory.mktemp("t") / "t.csv"
    features_table(1).assign(original_glcm_Id=values).to_csv(path, index=False)
    np.testing.assert_array_equal(read_table(path)["original_glcm_Id"], values)


def damaged(table, change):
    folder, _ = table
    change(features_table(start=3)).to_csv(folder / "b.csv", index=False)
    return folder


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda t: t.drop(columns="roi"), "b.csv: has no column roi"),
        (lambda t: t.drop(columns="tissue_class"), "b.csv: has no column tissue_class"),
        (lambda t: t.drop(columns="dose_mgy"), "b.csv: has no column dose_mgy"),
        (
            lambda t: t.drop(columns=list(FEATURES[3:5])),
            f"b.csv: has no column {FEATURES[3]} and 1 more; add it",
        ),
        (lambda t: t.rename(columns={FEATURES[0]: "original_firstorder_10Percentil"}), f"did you mean {FEATURES[0]}?"),
        (lambda t: t.assign(original_ngtdm_Busyness=1.0), "unknown feature original_ngtdm_Busyness"),
        (lambda t: t.assign(original_glcm_MCC=1.0), "unknown feature original_glcm_MCC"),
        (lambda t: t.assign(**{"wavelet-LLH_glcm_Idmn": 1.0}), "unknown feature wavelet-LLH_glcm_Idmn"),
        (lambda t: t.assign(**{FEATURES[7]: np.nan}), f"{FEATURES[7]} is nan for roi cyst_1"),
        (lambda t: t.assign(**{FEATURES[7]: "high"}), f"{FEATURES[7]} holds text"),
        (lambda t: t.assign(roi="cyst_1", tissue_class="cyst"), "two rows for ROI cyst_1 of image i3"),
        (lambda t: t.assign(tissue_class=[f"c{i}" for i in range(6)]), "roi cyst_1 has more than one tissue_class"),
        (lambda t: t.assign(dose_mgy=range(6)), "image i3 has more than one dose_mgy"),
        (lambda t: t.assign(image=[None, *t["image"][1:]]), "image is empty in row 2"),
        (lambda t: t.iloc[:0], "b.csv: has no rows"),
        (lambda t: t.assign(image=t["image"].replace("i3", "i0")), "b.csv: image i0 is also in a.csv"),
        (lambda t: features_table(start=3, mean=1100.0), "set features.stored_offset_hu: 1024"),
    ],
)
def test_other_tables_are_rejected(table, change, message):
    refused(damaged(table, change), message)


def test_duplicate_column_is_rejected(table):
    folder, _ = table
    lines = (folder / "b.csv").read_text().splitlines()
    (folder / "b.csv").write_text("\n".join(f"{line},{'roi' if i == 0 else 'x'}" for i, line in enumerate(lines)))
    refused(folder, "the column 'roi' occurs twice")


@pytest.mark.parametrize("content", [b"", b"\xff\xfe\x00", b'a,"b\n1'])
def test_files_other_than_csv_are_rejected(table, content):
    (table[0] / "b.csv").write_bytes(content)
    refused(table[0], "b.csv: ")


def test_absent_features_must_be_named_and_known(table):
    folder, content = table
    for name, start in (("a", 0), ("b", 3)):
        features_table(start=start).drop(columns=FEATURES[15]).to_csv(folder / f"{name}.csv", index=False)
    refused(folder, f"has no column {FEATURES[15]}; add it; if it was not extracted, list it under features.absent")
    recording = load_recording(write_yaml(folder, changed(content, "features.absent", [FEATURES[15]])))
    assert len(recording.features) == 85 and FEATURES[15] not in recording.features
    refused(write_yaml(folder, changed(content, "features.absent", ["original_glcm_MC"])), "unknown feature")


def test_stored_values_must_be_declared_and_are_unchanged(table):
    folder, content = table
    for name, start in (("a", 0), ("b", 3)):
        features_table(start=start, mean=1064.0).to_csv(folder / f"{name}.csv", index=False)
    refused(folder, "set features.stored_offset_hu: 1024")
    recording = load_recording(write_yaml(folder, changed(content, "features.stored_offset_hu", 1024)))
    assert recording.stored_offset_hu == 1024 and "HU + 1024" in recording.notes[0]
    assert recording.repeats["original_firstorder_Mean"].between(1060, 1070).all()
    features_table().to_csv(folder / "a.csv", index=False)
    refused(folder, "set features.stored_offset_hu: 0")


def test_summary_reports_other_voxels_than_the_study(table):
    """TotalEnergy is Energy times the volume of a voxel; without them nominal.voxel_mm is used."""
    folder, content = table
    for name, start in (("a", 0), ("b", 3)):
        rows = features_table(start=start)
        rows["original_firstorder_TotalEnergy"] = 8 * rows["original_firstorder_Energy"]
        rows.to_csv(folder / f"{name}.csv", index=False)
    line = (
        "voxels have 8 mm³, the study's voxels 27 mm³: {} of the features depend on the number of voxels and cannot be "
        "compared"
    )
    recording = load_recording(write_yaml(folder, content))
    assert summarize_recording(recording, voxel_sizes=[[3, 3, 3]])["notes"][-1] == line.format(len(SIZED))
    assert summarize_recording(recording, voxel_sizes=[[2, 2, 2], [3, 3, 3]])["notes"] == []
    assert summarize_recording(recording)["notes"] == []
    flat = load_recording(write_yaml(folder, changed(content, "features.dimensions", 2)))
    assert summarize_recording(flat, voxel_sizes=[[3, 3, 3]], section="largest")["notes"] == []
    absent = changed(content, "features.absent", ["original_firstorder_TotalEnergy"])
    for name in ("a", "b"):
        pd.read_csv(folder / f"{name}.csv").drop(columns="original_firstorder_TotalEnergy").to_csv(
            folder / f"{name}.csv", index=False
        )
    assert summarize_recording(load_recording(write_yaml(folder, absent)), voxel_sizes=[[3, 3, 3]])["notes"] == []
    stated = load_recording(write_yaml(folder, changed(absent, "nominal.voxel_mm", [2, 2, 2])))
    assert summarize_recording(stated, voxel_sizes=[[3, 3, 3]])["notes"][-1] == line.format(len(SIZED) - 1)


def test_summary_reports_other_sections_than_the_study(table):
    """The default study extracts features from the largest slices, pyradiomics from whole regions."""
    folder, content = table
    recording = load_recording(write_yaml(folder, content))
    assert summarize_recording(recording, section="whole")["notes"] == []
    assert summarize_recording(recording, section="largest")["notes"] == [
        "setting: section is whole, the study's largest (changes 86 of 86 features)",
        "set features.section: whole in the study, or correct features.dimensions in recording.yaml",
    ]
    flat = load_recording(write_yaml(folder, changed(content, "features.dimensions", 2)))
    assert summarize_recording(flat, section="largest")["notes"] == []
    other = other_settings(FEATURES, recording.repeats, section="largest", dimensions=3)
    assert set(other) == set(FEATURES) and set(other.values()) == {"section is whole, the study's largest"}


def test_summary_counts_images_by_condition(table):
    folder, content = table
    features_table(start=3).query("image != 'i3' or roi != 'cyst_1'").assign(dose_mgy=3).to_csv(
        folder / "b.csv", index=False
    )
    features_table(2, start=9).to_csv(folder / "c.csv", index=False)
    found = summarize_recording(load_recording(write_yaml(folder, content | {"held_out": ["c.csv"]})))
    assert (found["repeats"], found["held_out"]) == (6, 2)
    assert found["content"]["conditions"] == {"dose_mgy": [10, 3]} and found["content"]["images_per_condition"] == [
        3,
        3,
    ]
    assert found["notes"] == ["ROIs are missing in 1 of 6 images"]


def test_listing_reads_only_what_it_needs_from_a_table(table):
    folder, content = table

    def listing(features):
        written = write_yaml(
            folder, {key: content[key] for key in ("name", "kind", "repeats")} | {"features": features}
        )
        return readable(summary_table({"clinic": summarize_recording(load_recording(written))}))

    rois = len(set(features_table()["roi"]))
    without = listing({}).splitlines()
    assert without == ["clinic: features, 6 repeats", f"  content  86 features (3D) of {rois} ROIs, 6 images"]
    assert f"86 features (3D) of {rois} ROIs, 1 condition of 6 images" in listing({"conditions": ["dose_mgy"]})
    content["repeats"] = ["b.csv"]
    features_table(1).query("roi == 'cyst_1'").to_csv(folder / "b.csv", index=False)
    alone = listing({})
    assert "clinic: features, 1 repeat\n" in alone and "of 1 ROI, 1 image\n" in alone
    assert "missing  a second repeat (with one repeat, the noise is not known)" in alone
