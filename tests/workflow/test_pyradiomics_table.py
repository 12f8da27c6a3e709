"""From a `pyradiomics` CSV of the study's images to `snakemake recordings` and a comparison."""

import json
import shutil

import pandas as pd
import pytest
import yaml
from pyradiomics_batch import SAME, batch
from workflow_runs import tiny

from virtual_phantom.features.names import FEATURES

PROTOCOL, NOISE = "sirt_150", "dose10"
COMPARISON = {"recording": "clinic", "protocol": PROTOCOL, "noise": NOISE}


@pytest.fixture(scope="module")
def read(study, tmp_path_factory):
    """The study's images of a protocol, extracted by pyradiomics with the study's settings and others, and read."""
    folder = tmp_path_factory.mktemp("pyradiomics")
    images = sorted((study / "images" / PROTOCOL / NOISE).glob("seed*.nii.gz"))
    rois = pd.read_csv(study / "phantom" / "rois.csv")
    cases = [
        {"Image": image, "Mask": study / "phantom" / "rois" / f"{roi}.nii.gz"}
        for image in images
        for roi in rois["roi"]
    ]
    recording = folder / "clinic"
    recording.mkdir()
    tables = [
        pd.read_csv(batch(cases, recording / f"{width}.csv", SAME | {"binWidth": width})).assign(width=width)
        for width in (25, 10)
    ]
    tables[1]["Image"] = tables[1]["Image"].str.replace("seed", "other")
    pd.concat(tables).to_csv(recording / "t.csv", index=False)
    content = {
        "name": "clinic",
        "kind": "features",
        "repeats": ["t.csv"],
        "rois": [
            {"name": itertuple.roi, "tissue_class": itertuple.tissue_class, "file": f"{itertuple.roi}.nii.gz"}
            for itertuple in rois.itertuples()
        ],
        "features": {"conditions": ["width"]},
    }
    (recording / "recording.yaml").write_text(yaml.safe_dump(content))
    comparison = {f"at_{width}": COMPARISON | {"where": {"width": width}} for width in (25, 10)}
    overlay = {"recordings": {"clinic": str(recording)}, "analyses": {"comparison": comparison}}
    results = folder / "results"
    shutil.copytree(study, results)
    process = tiny(results, "recordings", overlay=overlay)
    assert process.returncode == 0, process.stderr[-4000:]
    targets = [results / "tables" / f"comparison_{name}_features.csv" for name in comparison]
    figure = results / "figures" / "comparison_at_10.png"
    made = tiny(results, *targets, figure, overlay=overlay)
    assert made.returncode == 0, made.stderr[-4000:]
    return results, process.stdout, overlay


def test_listing_states_contents_and_different_settings(read):
    results, printed, _ = read
    assert (
        "clinic: features, 6 repeats" in printed and "86 features (3D) of 6 ROIs, 2 conditions of 3 images" in printed
    )
    assert "setting: binWidth is 10, the study's 25 (changes 70 of 86 features)" in printed
    found = json.loads((results / "recordings" / "clinic" / "summary.json").read_text())
    assert found["content"]["extraction"][1]["pyradiomics"].startswith("v")


def test_same_images_agree_and_features_of_other_settings_are_marked(read):
    results = read[0]
    same, other = (
        pd.read_csv(results / "tables" / f"comparison_at_{width}_features.csv").set_index("feature")
        for width in (25, 10)
    )
    assert set(same.index) == set(FEATURES) and same[["other_settings", "other_sizes"]].isna().all(axis=None)
    assert (same["median_abs_shift_sd"] < 1e-6).all() and same["median_sd_ratio"].between(1 - 1e-6, 1 + 1e-6).all()
    marked = other["other_settings"].notna()
    assert set(other.loc[marked, "other_settings"]) == {"binWidth is 10, the study's 25"} and marked.sum() == 70
    assert (other.loc[~marked, "median_abs_shift_sd"] < 1e-6).all()
    assert (other.loc[marked, "median_abs_shift_sd"] > 1).mean() > 0.9


def test_diagnosis_excludes_features_of_other_settings(read):
    results, _, overlay = read
    rois = [f"{tissue}_{number}" for tissue in ("normal", "cyst") for number in (1, 2)]
    comparison = {"at_10": overlay["analyses"]["comparison"]["at_10"] | {"rois": rois}}
    overlay = overlay | {"analyses": {"comparison": comparison}, "diagnosis": {"comparisons": ["at_10"]}}
    process = tiny(results, "diagnosis", overlay=overlay)
    assert process.returncode == 0, process.stderr[-4000:]
    found = json.loads((results / "diagnosis" / "at_10" / "diagnosis.json").read_text())
    reasons = json.dumps(found)
    assert "extracted with other settings: binWidth is 10, the study's 25" in reasons
    assert found["verdict"] == "match"
