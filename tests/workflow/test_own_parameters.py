"""A user's parameter file in the study: extraction, merging and statistics use its features."""

import shutil

import pandas as pd
import pytest
import yaml
from workflow_runs import tiny

PARAMETERS = {
    "imageType": {"Original": {}, "LoG": {"sigma": [8.0]}},
    "featureClass": {"firstorder": ["Mean", "Variance"], "glcm": ["Idn"], "ngtdm": ["Busyness"]},
    "setting": {"binWidth": 20},
}
OWN = [
    f"{image}_{name}"
    for image in ("original", "log-sigma-8-0-mm-3D")
    for name in ("firstorder_Mean", "firstorder_Variance", "glcm_Idn", "ngtdm_Busyness")
]
TABLES = ("stability", "stable_features", "top_features", "overlap")


@pytest.fixture(scope="module")
def own(study, tmp_path_factory):
    """The tiny study's images with features of the parameter file."""
    folder = tmp_path_factory.mktemp("own")
    shutil.copytree(study, folder / "results")
    shutil.rmtree(folder / "results" / "features")
    (folder / "my_params.yaml").write_text(yaml.safe_dump(PARAMETERS, sort_keys=False))
    overlay = {
        "features": {"parameters": str(folder / "my_params.yaml")},
        "noise": {"levels": dict.fromkeys(("dose10_plus12", "double", "quadruple"))},
        "analyses": {"noise_calibration": None, "pca": None, "extraction": None},
    }
    targets = [folder / "results" / "tables" / f"{name}.csv" for name in TABLES] + [folder / "results" / "index.html"]
    figure = folder / "results" / "figures" / "stability_discrimination.png"
    process = tiny(folder / "results", *targets, figure, overlay=overlay)
    assert process.returncode == 0, process.stderr[-4000:]
    return folder, overlay


def test_tables_have_the_features_of_the_file(own, study):
    results = own[0] / "results"
    features, default = (pd.read_csv(one / "features.csv").query("noise == 'dose10'") for one in (results, study))
    assert [name for name in features if name.startswith(("original_", "log-"))] == OWN
    keys = ["protocol", "noise", "seed", "roi"]
    both = features.merge(default, on=keys, suffixes=("", "_default"), validate="one_to_one")
    assert len(both) == len(default) == len(features)
    for name in OWN[:2]:  # independent of the bin width
        pd.testing.assert_series_equal(both[name], both[f"{name}_default"], check_names=False)
    assert (both["original_glcm_Idn"] != both["original_glcm_Idn_default"]).any()
    for name in TABLES[:2]:
        assert set(pd.read_csv(results / "tables" / f"{name}.csv")["feature"]) == set(OWN)
    assert len(pd.read_csv(results / "tables" / "overlap.csv")) == 3, "those that the measured phantom has too"


def test_mistake_in_the_file_stops_before_any_job(own):
    folder, overlay = own
    (folder / "my_params.yaml").write_text("setting: {binwidth: 3}")
    process = tiny(folder / "results", "-n", overlay=overlay)
    assert process.returncode == 1 and "Traceback" not in process.stderr
    assert f"Error: {folder}/my_params.yaml: is no parameter file of pyradiomics: Key 'binwidth'" in process.stderr
