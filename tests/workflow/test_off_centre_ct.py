"""A CT at any world position, like clinical ones, through all outputs of a phantom.

It is a DICOM series with a label map, a DICOM SEG and an RTSTRUCT. The tutorial of a user's CT does the same with
NIfTI. The expected values follow from the object in phantom_files, and not from the tested code.
"""

import json

import nibabel
import numpy as np
import pandas as pd
import pydicom
import pytest
import SimpleITK as sitk
import yaml
from phantom_files import (
    BALLS,
    CENTRE,
    ball,
    ct_slices,
    write_nifti_array,
    write_rtstruct,
    write_seg,
    write_series,
)
from workflow_runs import tiny

PLACES = {f"{name}_{kind}": (name, kind) for name in BALLS for kind in ("labels", "seg", "rtstruct")}
MOVED = (20.0, -10.0, 7.0)  # isocenter of the scanner that records its images: (0, 0, 0) minus this
STUDY = {
    "grid": {"shape": [14, 34, 42], "spacing_mm": [3.0, 2.0, 2.0]},
    "scan": {"columns": 76, "column_pitch_mm": 2.4, "rows": 18, "row_pitch_mm": 4.0},
    "measured": {"overlay": False},
    "noise": {"levels": {"dose10": {"A": 1.0e-6}}},
    "protocols": {"sirt_300": None, "fbp_300": None},
    "analyses": {
        "optimal": {"sirt": "sirt_150", "fbp": "fbp_150", "noise": "dose10"},
        "noise_calibration": None,
        "pca": None,
    },
}


@pytest.fixture(scope="module")
def overlay(tmp_path_factory):
    """Study of the CT, which is first written as a DICOM series."""
    folder = tmp_path_factory.mktemp("ct")
    slices = ct_slices()
    labels = sum(number * ball(name).astype(np.uint8) for number, name in enumerate(BALLS, start=1))
    files = {
        "labels": write_nifti_array(labels, folder / "labels.nii.gz", flip_y=True),
        "seg": write_seg(slices, folder / "seg.dcm"),
        "rtstruct": write_rtstruct(folder / "rtstruct.dcm"),
    }
    rois = []
    for place, (name, kind) in PLACES.items():
        label = [*BALLS].index(name) + 1 if kind == "labels" else name
        rois.append({"name": place, "tissue_class": name, "file": files[kind], "label": label})
    ct = {"image": write_series(slices, folder / "dicom"), "rois": rois}
    return STUDY | {"phantom": {"source": "ct", "ct": ct}}


@pytest.fixture(scope="module")
def made(overlay, tmp_path_factory):
    """Folder of the study, run to its features, its viewer and its images in DICOM."""
    folder = tmp_path_factory.mktemp("off_centre") / "results"
    process = tiny(folder, folder / "features.csv", folder / "viewer.html", "dicom", overlay=overlay)
    assert process.returncode == 0, process.stderr[-4000:]
    return folder


def test_features_are_those_of_the_balls(made):
    features = pd.read_csv(made / "features.csv")
    assert len(features) == 2 * 3 * len(PLACES)
    for place, (name, _) in PLACES.items():
        rows = features[features["roi"] == place]
        assert rows["n_voxels"].unique() == pytest.approx(ball(name).sum(), rel=0.02)
        assert rows["original_firstorder_Median"].mean() == pytest.approx(BALLS[name][2], abs=15)


@pytest.mark.parametrize("name", BALLS)
def test_images_and_regions_are_at_the_position_of_the_object(made, name):
    offset, _, value = BALLS[name]
    expected = np.add(CENTRE, offset)
    places = {}
    for kind in ("labels", "seg", "rtstruct"):
        mask = nibabel.load(made / "phantom" / "rois" / f"{name}_{kind}.nii.gz")
        places[kind] = nibabel.affines.apply_affine(mask.affine, np.argwhere(mask.get_fdata() > 0)).mean(axis=0)
    nifti = nibabel.load(made / "images" / "sirt_150" / "dose10" / "seed00.nii.gz")
    (exported,) = (made / "dicom" / "sirt_150").glob("*/*/series")
    reader = sitk.ImageSeriesReader()
    reader.SetFileNames(reader.GetGDCMSeriesFileNames(str(exported)))
    dicom = reader.Execute()
    for voxels, to_world in (
        (nifti.get_fdata(), lambda index: nibabel.affines.apply_affine(nifti.affine, index)),
        (
            sitk.GetArrayFromImage(dicom).T,
            lambda index: np.array([dicom.TransformIndexToPhysicalPoint(i.tolist()) for i in index]) * [-1, -1, 1],
        ),
    ):
        inside = (voxels > 50) if value > 0 else (voxels < -30) & (voxels > -200)
        world = to_world(np.argwhere(inside))
        near = np.linalg.norm(world - expected, axis=1) < 15  # the body's edge has such values too
        places[len(places)] = world[near].mean(axis=0)
    for place in places.values():
        np.testing.assert_allclose(place, expected, atol=0.7)


def test_exported_regions_name_the_exported_slices(made):
    (regions,) = (made / "dicom" / "fbp_150").glob("*/*/rois.dcm")
    seg = pydicom.dcmread(regions)
    assert [one.SegmentLabel for one in seg.SegmentSequence] == [*PLACES]


def test_body_beyond_the_detector_is_rejected_also_with_effects(made, overlay):
    """Line integrals without effects, which show this first, are not made then."""
    rich = {"physics": {"scatter": {"amount": 0.05}}, "noise": overlay["noise"] | {"model": "physical"}}
    narrow = {"scan": overlay["scan"] | {"columns": 62}}
    target = made / "images" / "fbp_150" / "dose10" / "seed00.nii.gz"
    process = tiny(made, target, overlay=overlay | rich | narrow, config_folder=made.parent / "narrow")
    assert process.returncode == 1
    assert "Error: scan: the phantom reaches 4" in process.stderr, process.stderr[-3000:]


@pytest.fixture(scope="module")
def measured(made, overlay):
    """Its images as a recording of a scanner with another world: aligned, compared and diagnosed."""
    recording = made.parent / "scanner"
    recording.mkdir()
    for seed in range(3):
        image = nibabel.load(made / "images" / "fbp_150" / "dose10" / f"seed{seed:02d}.nii.gz")
        affine = image.affine.copy()
        affine[:3, 3] -= np.add(CENTRE, MOVED)
        nibabel.save(nibabel.Nifti1Image(np.asarray(image.dataobj), affine), recording / f"seed{seed:02d}.nii.gz")
    content = {"name": "scanner", "kind": "images", "repeats": [f"seed{seed:02d}.nii.gz" for seed in range(3)]}
    (recording / "recording.yaml").write_text(yaml.safe_dump(content))
    diagnosed = {"protocol": "fbp_150", "samples": 1, "effects": ["hu_calibration"]}
    more = {
        "recordings": {"scanner": str(recording)},
        "analyses": overlay["analyses"]
        | {"comparison": {"same": {"recording": "scanner", "protocol": "fbp_150", "noise": "dose10"}}},
        "diagnosis": {"recordings": {"scanner": diagnosed}},
    }
    table = made / "tables" / "comparison_same_families.csv"
    process = tiny(
        made, "alignment", "diagnosis", table, overlay=overlay | more, config_folder=made.parent / "measured"
    )
    assert process.returncode == 0, process.stderr[-4000:]
    return made


def test_recording_in_another_world_is_aligned(measured):
    folder = measured / "recordings" / "scanner"
    found = json.loads((folder / "alignment.json").read_text())
    np.testing.assert_allclose(found["translation_mm"], -np.add(CENTRE, MOVED), atol=0.05)
    assert found["rois_from"] == "phantom"
    original, carried = (pd.read_csv(place / "rois.csv") for place in (measured / "phantom", folder))
    assert carried["roi"].tolist() == original["roi"].tolist()
    assert carried["n_voxels"].tolist() == pytest.approx(original["n_voxels"].tolist(), rel=0.05)
    assert (measured / "figures" / "alignment_scanner.png").stat().st_size > 10_000


def test_comparison_with_itself_shows_no_difference(measured):
    families = pd.read_csv(measured / "tables" / "comparison_same_families.csv").set_index("family")
    assert families.loc["all", "share_mean_differs"] == 0


def test_diagnosis_of_itself_shows_no_difference(measured):
    found = json.loads((measured / "diagnosis" / "scanner" / "diagnosis.json").read_text())
    assert found["verdict"] == "match", found["sentence"]
    assert set(found["agreement"]["rois"]) <= set(PLACES) and found["agreement"]["rois"]
