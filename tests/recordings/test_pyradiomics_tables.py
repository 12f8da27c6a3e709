"""Tables of pyradiomics' batch command as recordings of features."""

import pandas as pd
import pytest
import SimpleITK as sitk
from pyradiomics_batch import LABELS, SAME, SPACING_MM, batch, label_map, scans
from recording_folders import refused, write_yaml

from virtual_phantom.base.geometry import Grid
from virtual_phantom.features import extraction
from virtual_phantom.features.names import FEATURES
from virtual_phantom.features.settings import STUDY, differences, distinct_extractions, read_extractions
from virtual_phantom.io.volumes import Volume
from virtual_phantom.recordings.reading import load_recording
from virtual_phantom.recordings.summary import summarize_recording

ROIS = [{"name": name, "tissue_class": name, "label": label} for name, label in LABELS.items()]


def by_label(images, folder):
    return [
        {"ID": f"case{number}", "Image": path, "Mask": folder / "labels.nii.gz", "Label": label, "Dose": dose}
        for number, ((dose, _), path) in enumerate(images.items())
        for label in LABELS.values()
    ]


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scans")
    return folder, scans(folder)


@pytest.fixture(scope="module")
def written(images, tmp_path_factory):
    """Tables of the same cases: with the study's settings, with a filter and other settings, and by masks."""
    folder, paths = images
    out = tmp_path_factory.mktemp("tables")
    cases = by_label(paths, folder)
    other = {"binWidth": 10, "voxelArrayShift": 300, "distances": [1, 2], "label": 1}
    masks = [
        {"Image": path, "Mask": folder / "masks" / f"{name}.nii.gz", "Dose": dose}
        for (dose, _), path in paths.items()
        for name in LABELS
    ]
    return {
        "same": batch(cases, out / "same.csv").read_text(),
        "other": batch(cases[:4], out / "other.csv", other, ("Original", "Wavelet")).read_text(),
        "masks": batch(masks, out / "masks.csv").read_text(),
    }


@pytest.fixture
def table(written, tmp_path):
    """Function that makes a recording of one of the tables, optionally with a change of its DataFrame."""

    def make(name="same", change=None, rois=ROIS, **features):
        content = {"name": "clinic", "kind": "features", "repeats": ["t.csv"], "features": features}
        folder = write_yaml(tmp_path / "clinic", content | ({"rois": rois} if rois else {}))
        (folder / "t.csv").write_text(written[name])
        if change:
            change(pd.read_csv(folder / "t.csv")).to_csv(folder / "t.csv", index=False)
        return folder

    return make


def test_values_equal_the_study_extraction(table, images):
    recording = load_recording(table(conditions=["Dose"]))
    assert recording.features == FEATURES and recording.images_per_condition().to_dict() == {3: 3, 10: 3}
    labels = label_map()
    masks = {name: labels == label for name, label in LABELS.items()}
    for (dose, repeat), path in images[1].items():
        image = sitk.GetArrayFromImage(sitk.ReadImage(str(path)))
        extracted = extraction.extract(Volume(image, Grid(labels.shape, SPACING_MM[::-1])), masks)
        theirs = recording.repeats.query(f"image == 'dose{dose}/r{repeat}.nii.gz'")
        assert theirs["roi"].tolist() == theirs["tissue_class"].tolist() == list(masks)
        pd.testing.assert_frame_equal(
            extracted[list(FEATURES)], theirs[list(FEATURES)].reset_index(drop=True), check_exact=False, rtol=1e-9
        )
    notes = summarize_recording(recording)["notes"]
    # 14 of shape, 5 of NGTDM, the co-occurrence's MCC and SumAverage.
    assert len(notes) == 1 and notes[0].startswith("ignored: 21 features")


def test_masks_and_labels_give_the_same_table(table):
    by_labels = load_recording(table(conditions=["Dose"])).repeats
    masks = [{"name": name, "tissue_class": name, "file": f"{name}.nii.gz"} for name in LABELS]
    by_masks = load_recording(table("masks", rois=masks, conditions=["Dose"])).repeats
    columns = ["image", "roi", "tissue_class", "Dose", *FEATURES]
    pd.testing.assert_frame_equal(by_labels[columns], by_masks[columns])
    patterns = [{"name": name, "tissue_class": name, "file": f"masks/{name[:2]}*"} for name in LABELS]
    pd.testing.assert_frame_equal(by_masks, load_recording(table("masks", rois=patterns, conditions=["Dose"])).repeats)


def test_settings_are_read_and_differences_are_reported(table):
    recording = load_recording(table("other"))
    (found,) = recording.extractions
    assert found.settings["binWidth"] == 10 and found.version == extraction.pyradiomics.__version__
    notes = summarize_recording(recording)["notes"]
    assert [note for note in notes if note.startswith("setting")] == [
        "setting: binWidth is 10, the study's 25 (changes 70 of 86 features)",
        "setting: distances is [1, 2], the study's [1] (changes 32 of 86 features)",
        "setting: voxelArrayShift is 300, the study's 0 (changes 3 of 86 features)",
    ]
    assert notes[0].startswith("ignored: 765 features")


def test_setting_changes_the_stated_features(images, tmp_path):
    """The reference is pyradiomics: the same cases, with one setting changed at a time."""
    folder, paths = images
    cases = by_label(paths, folder)[:2]
    plain = pd.read_csv(batch(cases, tmp_path / "plain.csv"))
    changes = {
        "binWidth": 10,
        "binCount": 7,
        "voxelArrayShift": 300,
        "distances": [2],
        "symmetricalGLCM": False,
        "weightingNorm": "euclidean",
        "gldm_a": 1,
        "force2D": True,
        "normalize": True,
        "resampledPixelSpacing": [2, 2, 2],
        "resegmentRange": [-50, 150],
    }
    for setting, value in changes.items():
        other = pd.read_csv(batch(cases, tmp_path / f"{setting}.csv", SAME | {setting: value}))
        feature_changes = (plain[list(FEATURES)] - other[list(FEATURES)]).abs().max()
        moved = set(FEATURES) - set(feature_changes.index[feature_changes <= 1e-9 * plain[list(FEATURES)].abs().max()])
        (used,) = distinct_extractions(read_extractions(other, "t"))
        (found,) = [difference for difference in differences(STUDY, used) if difference.setting == setting]
        changed = {name for name in FEATURES if found.changes(name)}
        assert moved <= changed, (setting, moved - changed)
        assert len(moved) >= 0.75 * len(changed), (setting, changed - moved)


def test_rows_of_other_rois_and_features_are_skipped_and_counted(table):
    recording = load_recording(table(change=lambda t: t.drop(columns=FEATURES[40]), rois=ROIS[1:]))
    assert recording.repeats["roi"].unique().tolist() == ["cyst"] and len(recording.features) == 85
    assert "ignored: 6 rows of ROIs that recording.yaml does not name" in recording.notes
    assert f"missing: 1 of the 86 features ({FEATURES[40]})" in recording.notes


def test_user_columns(table):
    """User names: cases, and ROIs with their classes in columns."""

    def named(t):
        t = t.rename(columns={"ID": "Case", "Label": "Segment"}).drop(columns="Image")
        return t.assign(Segment=t["Segment"].map({label: name for name, label in LABELS.items()}))

    rois = [{"name": name, "tissue_class": name} for name in LABELS]
    recording = load_recording(table(change=named, rois=rois, image="Case", roi="Segment", conditions=["Dose"]))
    assert recording.repeats["image"].unique().tolist() == [f"case{number}" for number in range(6)]
    assert recording.repeats["roi"].tolist() == ["liver", "cyst"] * 6
    whole = load_recording(
        table(
            change=lambda t: named(t).rename(columns={"Mask": "tissue_class"}), rois=None, image="Case", roi="Segment"
        )
    )
    assert whole.repeats["tissue_class"].nunique() == 1 and len(whole.repeats) == 12


def damaged(**columns):
    return lambda t: t.assign(**columns)


@pytest.mark.parametrize(
    "change, rois, message",
    [
        (None, None, "has no column roi; name the ROI of each Label under rois in recording.yaml"),
        (
            None,
            [ROIS[0] | {"label": 7}],
            "no row matches ROI liver (label 7); the column Label contains 1, 5; the column Mask",
        ),
        (None, [*ROIS, ROIS[0] | {"name": "x"}], "row 2 matches both ROI liver (label 1) and ROI x (label 1)"),
        (None, [ROIS[0] | {"margin_mm": 2}], "rois: margin_mm of liver has no meaning in a recording of features"),
        (lambda t: t.drop(columns="Mask"), [{"name": "a", "tissue_class": "a", "file": "a"}], "has no column Mask"),
        (
            lambda t: t.drop(columns="Label"),
            ROIS,
            "has no column Label; name the column in recording.yaml under features.roi",
        ),
        (lambda t: t.drop(columns="Image"), ROIS, "has no column image or Image"),
        (lambda t: t.assign(**dict.fromkeys([c for c in t if c.startswith("original")])), ROIS, "row 2 (image "),
        (lambda t: t[[c for c in t if not c.startswith("original")]], ROIS, "has no columns of features"),
        (
            lambda t: t.iloc[:0],
            ROIS,
            "has no rows below its header; use the table that pyradiomics wrote",
        ),
        (lambda t: t.drop(columns=list(FEATURES)), ROIS, "have none of the 86 features of the study in common"),
        (damaged(**{FEATURES[3]: float("nan")}), ROIS, f"{FEATURES[3]} is nan for roi liver"),
        (
            damaged(diagnostics_Configuration_Settings="os.remove('x')"),
            ROIS,
            "not a dictionary as pyradiomics writes it",
        ),
        (damaged(diagnostics_Configuration_Settings="{" * 900), ROIS, "not a dictionary as pyradiomics"),
        (damaged(diagnostics_Configuration_Settings="{1: 2}"), ROIS, "not a dictionary as pyradiomics"),
        (
            damaged(diagnostics_Configuration_EnabledImageTypes="{'Original': 5}"),
            ROIS,
            "row 2: diagnostics_Configuration_EnabledImageTypes holds",
        ),
        (
            lambda t: t.assign(
                diagnostics_Configuration_Settings=["{'binWidth': 25}"] * 11 + ["{'binWidth': 50}"],
            ),
            ROIS,
            "repeats were extracted with binWidth 25 and 50; list a column that distinguishes them",
        ),
        (
            damaged(diagnostics_Configuration_Settings="{'force2D': True}"),
            ROIS,
            "was extracted slice by slice (force2D), but recording.yaml says features.dimensions 3",
        ),
    ],
)
def test_error_is_one_line(table, change, rois, message):
    refused(table(change=change, rois=rois), message)


def test_second_run_into_the_same_file_is_rejected(table, written):
    """pyradiomics appends to the file given by --out."""
    folder = table()
    (folder / "t.csv").write_text(written["same"] + written["same"])
    refused(folder, "t.csv: row 14 repeats the column names")


def test_conditions_may_have_their_own_settings(table):
    def other(t):
        return t.assign(diagnostics_Configuration_Settings=t["Dose"].map("{{'binWidth': {}}}".format))

    recording = load_recording(table(change=other, conditions=["Dose"]))
    assert [extraction.settings["binWidth"] for extraction in recording.extractions] == [3, 10]
