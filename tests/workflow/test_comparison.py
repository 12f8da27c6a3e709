"""Comparison with recordings: the tiny study's own features as a recording."""

import html
import json
import shutil

import nibabel
import numpy as np
import pandas as pd
import pytest
import yaml
from workflow_runs import tiny

from virtual_phantom.features.extraction import FEATURES
from virtual_phantom.study import matched_noise

OVERLAY = {
    "noise": {
        "levels": {
            "matched": {
                "repeats": 3,
                "meets": {
                    "recording": "own",
                    "where": {"protocol": "sirt_150"},
                    "rois": ["cyst_1"],
                    "protocol": "sirt_150",
                },
            }
        }
    },
    "analyses": {
        "stability": {"recordings": ["own"]},
        "pca": {"sirt": {"recordings": ["own"]}},
        "comparison": {
            "same": {
                "recording": "own",
                "where": {"protocol": "sirt_150"},
                "protocol": "sirt_150",
                "noise": "matched",
            },
            "other": {
                "recording": "own",
                "where": {"protocol": "sirt_150"},
                "protocol": "sirt_300",
                "noise": "dose10",
            },
        },
    },
}


FIGURES = ("comparison_same", "overlap_own", "pca_sirt")
TABLES = ("comparison_same_families", "comparison_other_families", "matched_noise")


@pytest.fixture(scope="module")
def compared(study, tmp_path_factory):
    """The tiny study with its own features at noise level "double" as a recording of two conditions."""
    folder = tmp_path_factory.mktemp("compared")
    features = pd.read_csv(study / "features.csv").query("noise == 'double'")
    features = features.assign(image=features["protocol"] + "_" + features["seed"].astype(str))
    recording = folder / "own"
    recording.mkdir()
    features[["image", "roi", "tissue_class", "protocol", *FEATURES]].to_csv(recording / "features.csv", index=False)
    content = {
        "name": "own",
        "kind": "features",
        "repeats": ["features.csv"],
        "features": {"conditions": ["protocol"]},
    }
    (recording / "recording.yaml").write_text(yaml.safe_dump(content))
    results = folder / "results"
    shutil.copytree(study, results)
    made = (*(f"figures/{name}.png" for name in FIGURES), *(f"tables/{name}.csv" for name in TABLES))
    overlay = {"recordings": {"own": str(recording)}, **OVERLAY}
    process = tiny(results, *(results / name for name in made), overlay=overlay)
    assert process.returncode == 0, process.stderr[-4000:]
    return results


def test_noise_level_of_a_recording_is_found(compared):
    """The recording was simulated at A = 12e-6; its sampling error over three repeats is a few per cent."""
    level = matched_noise.read_level(compared / "noise" / "matched.json")
    assert level["A"] == pytest.approx(12e-6, rel=0.1)
    table = pd.read_csv(compared / "tables" / "matched_noise.csv")
    assert table["ratio"].iloc[0] == pytest.approx(1, abs=0.1)
    features = pd.read_csv(compared / "features.csv").query("noise == 'matched'")
    np.testing.assert_allclose(features["noise_level"], level["A"])


def test_recording_agrees_with_its_own_protocol_and_not_with_another(compared):
    families = {
        name: pd.read_csv(compared / "tables" / f"comparison_{name}_families.csv").set_index("family")
        for name in ("same", "other")
    }
    assert families["same"].loc["all", "share_mean_differs"] == 0
    assert families["same"].loc["all", "median_abs_shift_sd"] < 1.5
    # For study seeds 2022 to 2027, another protocol of three repeats has shares of 0.16 to 0.27 (SD 0.04) and shifts of
    # 3.2 to 4.9 (SD 0.6).
    assert families["other"].loc["all", "share_mean_differs"] > 0.1
    assert families["other"].loc["all", "median_abs_shift_sd"] > 2.5


def test_features_are_diagnosed(compared):
    """The same protocol is a match; another number of projections is not."""
    settings = {"recordings": {"own": str(compared.parent / "own")}, **OVERLAY}
    overlay = {**settings, "diagnosis": {"comparisons": ["same", "other"]}}
    process = tiny(compared, "diagnosis", overlay=overlay, config_folder=compared.parent / "diagnosed")
    assert process.returncode == 0, process.stderr[-4000:]
    found = {}
    for name in ("same", "other"):
        folder = compared / "diagnosis" / name
        found[name] = json.loads((folder / "diagnosis.json").read_text())
        page = (folder / "report.html").read_text()
        assert all(html.escape(line) in page for line in found[name]["verdict_lines"])
        assert "physics" in yaml.safe_load((folder / "physics.yaml").read_text())
        assert {path.stem for path in (folder / "maps").glob("*.npy")} == {"mean", "SD", "order of regions"}
    assert found["same"]["verdict"] == "match" and found["other"]["verdict"] != "match"
    for place in found["other"]["locations"]:
        assert place["p"] < 0.01 and (compared / "diagnosis" / "other" / "maps" / place["map"]).exists()
    overlay = {**settings, "diagnosis": {"recordings": {"own": {}}}}
    process = tiny(compared, "-n", "diagnosis", overlay=overlay, config_folder=compared.parent / "wrong")
    assert process.returncode == 1
    assert "Error: diagnosis.recordings.own: holds features; name comparisons" in process.stderr


def test_figures_and_tables_of_recordings_exist(compared):
    for name in FIGURES:
        assert (compared / "figures" / f"{name}.png").stat().st_size > 10_000
    points = pd.read_csv(compared / "tables" / "pca_sirt.csv")
    # One marker per condition and ROI.
    assert (points["source"] == "measured").sum() == 2 * 6
    assert len(pd.read_csv(compared / "recordings" / "own" / "scores.csv")) == 86
    assert nibabel.load(compared / "images" / "sirt_150" / "matched" / "seed00.nii.gz").shape == (80, 80, 24)
