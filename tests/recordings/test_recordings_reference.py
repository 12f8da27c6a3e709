"""Feature recordings as references: groups by conditions, values in HU, and scores; with the two real tables."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from recording_folders import features_folder, features_table, write_yaml

from virtual_phantom.base.data import RESOURCES
from virtual_phantom.base.errors import InputError
from virtual_phantom.features.extraction import FEATURES
from virtual_phantom.features.names import features_of
from virtual_phantom.io.files import read_csv
from virtual_phantom.recordings import reference
from virtual_phantom.recordings.importers.feature_tables import import_features
from virtual_phantom.recordings.reading import load_recording
from virtual_phantom.statistics import measured, pca, ranking

REAL = Path(__file__).resolve().parents[2] / "../shared/real"
real = [
    pytest.mark.real,
    pytest.mark.skipif(not REAL.exists(), reason="the real measurements are not beside this checkout"),
]


def images_of(recording):
    table = reference.with_group(reference.in_hu(recording), recording.conditions)
    return table[["group", "roi", "tissue_class", *features_of(table)]]


def of(recording, **options):
    return reference.reference_features(reference.in_hu(recording), recording.conditions, **options)


@pytest.fixture
def recording(tmp_path):
    """Six images: doses 10, 20 and 20, 10, 10, 30 mGy."""
    folder, _ = features_folder(tmp_path / "table")
    for name, start, doses in (("a", 0, (10, 20, 20)), ("b", 3, (10, 10, 30))):
        features_table(start=start).assign(dose_mgy=np.repeat(doses, 2)).to_csv(folder / f"{name}.csv", index=False)
    return load_recording(folder)


def test_conditions_are_numbered_in_their_order(recording):
    assert reference.with_group(recording.repeats, recording.conditions)["group"].tolist() == [
        1,
        1,
        2,
        2,
        2,
        2,
        1,
        1,
        1,
        1,
        3,
        3,
    ]
    means = of(recording)
    assert list(means.columns) == ["group", "roi", "tissue_class", *FEATURES] and len(means) == 6
    rows = recording.repeats.query("dose_mgy == 10 and roi == 'cyst_1'")
    found = means.query("group == 1 and roi == 'cyst_1'")
    assert found[list(FEATURES)].iloc[0].to_numpy() == pytest.approx(rows[list(FEATURES)].mean().to_numpy())


def test_conditions_select_rows(recording):
    assert len(reference.select_rows(recording.repeats, {"dose_mgy": 20, "roi": "cyst_1"}, "r")) == 2
    assert len(reference.select_rows(recording.repeats, {}, "r")) == 12
    with pytest.raises(InputError, match="recording r: no images with dose_mgy 40; choose from 10, 20, 30"):
        reference.select_rows(recording.repeats, {"dose_mgy": 40}, "recording r")
    with pytest.raises(InputError, match="recording r: has no column kernel"):
        reference.select_rows(recording.repeats, {"kernel": "B"}, "recording r")


def test_condition_has_a_name_and_the_mean_of_its_images(recording):
    table = of(recording, named=True)
    assert table["condition"].tolist() == ["10", "10", "20", "20", "30", "30"]
    ten = recording.repeats[recording.repeats["dose_mgy"] == 10]
    mean = ten.groupby("roi", sort=False)["original_firstorder_Mean"].mean()
    assert table.loc[table["condition"] == "10", "original_firstorder_Mean"].tolist() == pytest.approx(mean.tolist())
    with pytest.raises(InputError, match="'scanner' is not a column of the features"):
        reference.reference_features(reference.in_hu(recording), ["scanner"])


def test_stored_values_are_converted_to_hu(tmp_path):
    folder, content = features_folder(tmp_path / "table")
    write_yaml(folder, content | {"features": {"stored_offset_hu": 1000}})
    for name, start in (("a", 0), ("b", 3)):
        features_table(start=start, mean=1040).to_csv(folder / f"{name}.csv", index=False)
    table = images_of(load_recording(folder))
    assert table["original_firstorder_Median"].mean() == pytest.approx(40, abs=1)
    contrast = "original_glcm_Contrast"  # textures are unchanged
    stored = pd.concat([features_table(start=start, mean=1040) for start in (0, 3)])
    assert table[contrast].tolist() == stored[contrast].tolist()
    assert (table["group"] == 1).all()


def test_condition_of_a_single_image_is_excluded_from_scores(recording):
    scores = reference.stability_scores(recording, 100)
    assert (scores["stability_comparisons"] == 2).all() and len(scores) == 86  # one pair of groups, two ROIs
    unrelated = pd.DataFrame(np.eye(86), index=list(FEATURES), columns=list(FEATURES))
    assert ranking.overlap(scores, scores, unrelated)["area_stability"][0] == pytest.approx(
        ranking.overlap(scores, reference.stability_scores(recording, 100, threshold=1.0), unrelated)["area_stability"][
            0
        ]
    )


def test_scores_use_as_many_images_as_the_study_has_repeats(tmp_path):
    folder, content = features_folder(tmp_path / "table")
    for name, start, doses in (("a", 0, (10, 20, 10)), ("b", 3, (20, 10, 20)), ("c", 6, (10, 10, 20))):
        features_table(start=start).assign(dose_mgy=np.repeat(doses, 2)).to_csv(folder / f"{name}.csv", index=False)
    write_yaml(folder, content | {"repeats": ["a.csv", "b.csv", "c.csv"], "features": {"conditions": ["dose_mgy"]}})
    recording = load_recording(folder)
    assert recording.images_per_condition().tolist() == [5, 4]
    scores = reference.stability_scores(recording, 2)
    assert (scores["repeats"] == 2).all() and (scores["of"] == 4).all()
    assert scores["draw"].nunique() == 30 and len(scores) == 30 * 86
    assert (reference.stability_scores(recording, 9)["repeats"] == 4).all()


def test_one_condition_has_no_stability(tmp_path):
    recording = load_recording(features_folder(tmp_path / "table")[0])
    with pytest.raises(InputError) as caught:
        reference.stability_scores(recording, 10)
    assert "recording table: stability needs at least 2 conditions" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    return import_features(REAL / "ct_phantom4radiomics" / "features_2d.csv", tmp_path_factory.mktemp("r") / "study")


@pytest.fixture(scope="module")
def dose_series(tmp_path_factory):
    return import_features(REAL / "edge_dose_series" / "features_3d.csv", tmp_path_factory.mktemp("r") / "dose")


class TestReal:
    pytestmark = real

    def test_tandem_study_reproduces_the_published_result(self, study):
        scores = reference.stability_scores(study, 100)  # 29 of each group
        assert (scores["repeats"] == 29).all()
        assert scores["stability_percent"].mean() == pytest.approx(11, abs=0.5)
        # 88.0 over the pairs of different classes; 87 with pairs of one class
        assert scores["discrimination_percent"].mean() == pytest.approx(87.5, abs=0.6)
        published = measured.load_published_top().query("kind == 'stability' and source == 'phantom'")["feature"]
        best = scores.sort_values("stability_percent", ascending=False, kind="stable")["feature"][:12]
        assert len(published) == 10 and len(set(best) & set(published)) >= 6
        shipped = read_csv(RESOURCES / "ct_phantom4radiomics_scores.csv")  # of all images, 30 in most groups
        for kind in ranking.KINDS:
            assert np.corrcoef(shipped[f"{kind}_percent"], scores[f"{kind}_percent"])[0, 1] > 0.99

    def test_means_equal_those_in_resources(self, study):
        means = of(study).sort_values(["group", "roi"], ignore_index=True)
        shipped = measured.group_means()[list(means.columns)].sort_values(["group", "roi"], ignore_index=True)
        pd.testing.assert_frame_equal(means, shipped, rtol=1e-6, check_dtype=False)

    def test_both_recordings_are_markers_and_lists(self, study, dose_series):
        simulated = images_of(dose_series).rename(columns={"group": "seed"})
        simulated = simulated.assign(protocol="a", algorithm="FBP", projections=1, noise="n", noise_level=1.0)
        points = pca.project(simulated, of(study))
        assert (points["source"] == "measured").sum() == 48
        assert points.loc[points["source"] == "measured", "group"].nunique() == 8
        shared = ranking.overlap(
            reference.stability_scores(dose_series, 10),
            reference.stability_scores(study, 10),
            ranking.shared_variance(dose_series.repeats, FEATURES),
        )
        assert shared["n_features"][0] == 85 and shared["area_stability"].between(0, 1).all()
        assert (
            dose_series.dimensions == 3
            and reference.stability_scores(dose_series, 10)["stability_comparisons"][0] == 15 * 6
        )
