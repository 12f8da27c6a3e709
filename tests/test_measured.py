from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from recording_folders import features_table

from virtual_phantom.base.errors import InputError
from virtual_phantom.features.extraction import FEATURES
from virtual_phantom.features.hu_offset import convert_to_hu
from virtual_phantom.io.files import read_csv
from virtual_phantom.statistics import dose_series, measured, repeats, wilcoxon
from virtual_phantom.statistics.dose_series import dose_variance
from virtual_phantom.statistics.ranking import KINDS

REAL = Path(__file__).resolve().parents[1] / "../shared/real"
STUDY = REAL / "ct_phantom4radiomics/features_2d.csv"
DOSE = REAL / "edge_dose_series/features_3d.csv"


def study_rows(**changes):
    rows = {
        "scan_id": ["101-n1-192", "830-met-170"],
        "group": [1, 8],
        "class": ["n1", "met"],
        "mask size": [844, 685],
        **features_table(1, mean=1064.0)[list(measured.PHANTOM4RADIOMICS_FEATURES)].to_dict("list"),
    }
    return pd.DataFrame(rows | changes)


def test_names_of_the_full_table_are_translated(tmp_path):
    study_rows().to_csv(tmp_path / "table.csv", index=False)
    table = measured.load_full_table(tmp_path / "table.csv")
    columns = ["scan", "group", "acquisition", "repositioned", "roi", "tissue_class", "n_voxels"]
    assert table[columns].to_numpy().tolist() == [
        [101, 1, 2, 0, "normal_1", "normal_liver", 844],
        [830, 8, 30, 1, "metastasis", "metastasis", 685],
    ]


@pytest.fixture(scope="module")
def study():
    if not STUDY.exists():
        pytest.skip("the table of CT-Phantom4Radiomics is not beside the checkout")
    return measured.load_full_table(STUDY)


def wide(study, roi):
    mean = "original_firstorder_Mean"
    return study[study["roi"] == roi].pivot(index="acquisition", columns="group", values=mean)


@pytest.mark.real
def test_all_groups_reconstruct_the_same_acquisitions(study):
    """Means of an ROI vary together from acquisition to acquisition in all groups, because the noise is the same."""
    as_named = study.assign(acquisition=study["scan"] % 100)
    for roi, least in (("cyst_1", 0.9), ("cyst_2", 0.8), ("normal_2", 0.5)):
        still = wide(study, roi).loc[:20]  # without re-positioning
        assert still.corr()[8].min() > least
        named = wide(as_named, roi).corr()[8]
        assert named[[1, 2, 3]].max() < 0.5 and named[[4, 7]].min() > 0.9
        for group in (1, 2, 3):  # no correlation with the previous or next acquisition
            assert max(still[group].shift(step).corr(still[8]) for step in (-1, 1)) < 0.1


@pytest.mark.real
def test_phantom_was_repositioned_for_acquisitions_21_to_30(study):
    """Bounding boxes of the large cyst, which are at the same pixels of 0.684 mm in all groups."""
    raw = pd.read_csv(STUDY)
    box = raw["diagnostics_Mask-original_BoundingBox"][(raw["class"] == "c1").to_numpy()]
    cyst = study[study["roi"] == "cyst_1"].assign(box=box)
    boxes = cyst.pivot(index="acquisition", columns="group", values="box")
    still = boxes.loc[:20].stack().dropna().unique()  # scans 130 and 230 are absent
    assert len(still) == 1 and not (boxes.loc[21:] == still[0]).any().any()
    assert (boxes.loc[21:].nunique(axis=1) == 1).sum() >= 9  # all groups show one position
    assert (cyst["repositioned"] == (cyst["box"] != still[0])).all()
    assert boxes.loc[21:, 8].nunique() >= 4


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"class": ["n1", "x"]}, "class 'x' is unknown"),
        ({"group": [1, 7]}, "does not begin with the digit of its group"),
        ({"scan_id": ["101-n1", "83-met"]}, "does not begin with the digit of its group"),
        ({measured.PHANTOM4RADIOMICS_FEATURES[3]: [1.0, np.nan]}, "features that are not finite"),
    ],
)
def test_other_tables_are_rejected(tmp_path, changes, message):
    study_rows(**changes).to_csv(tmp_path / "table.csv", index=False)
    with pytest.raises(InputError, match=message):
        measured.load_full_table(tmp_path / "table.csv")
    study_rows().drop(columns="mask size").to_csv(tmp_path / "table.csv", index=False)
    with pytest.raises(InputError, match="lacks 1 column.s. of the published table, the first 'mask size'"):
        measured.load_full_table(tmp_path / "table.csv")
    with pytest.raises(InputError, match="none.csv: no such file"):
        measured.load_full_table(tmp_path / "none.csv")


@pytest.mark.parametrize("offset", [1000, 1024])
def test_first_order_features_in_hu_equal_those_of_shifted_values(offset):
    hu = np.random.default_rng(0).normal(5, 12, 300)
    stored = hu + offset

    def first_order(x):
        return {
            "10Percentile": np.percentile(x, 10),
            "90Percentile": np.percentile(x, 90),
            "Maximum": x.max(),
            "Mean": x.mean(),
            "Median": np.median(x),
            "Minimum": x.min(),
            "Variance": x.var(),
            "Energy": (x**2).sum(),
            "TotalEnergy": 0.5 * (x**2).sum(),
            "RootMeanSquared": np.sqrt((x**2).mean()),
            "Range": np.ptp(x),
        }

    def row(x):
        return pd.DataFrame([{f"original_firstorder_{k}": v for k, v in first_order(x).items()} | {"n_voxels": x.size}])

    pd.testing.assert_frame_equal(convert_to_hu(row(stored), offset), row(hu), rtol=1e-9)
    assert convert_to_hu(row(hu), 0).equals(row(hu))
    few = row(stored)[["original_firstorder_Median", "original_firstorder_Range"]]
    assert convert_to_hu(few, offset).iloc[0].tolist() == pytest.approx([np.median(hu), np.ptp(hu)])
    with pytest.raises(InputError, match="Energy is of stored values .* without original_firstorder_Variance"):
        bare = row(stored).drop(columns=["original_firstorder_Variance", "original_firstorder_RootMeanSquared"])
        convert_to_hu(bare, offset)


def test_summaries_are_complete():
    groups, dose = measured.load_group_summary(), read_csv(dose_series.TABLE)
    assert len(groups) == 8 * 6 * 85 and len(dose) == 3 * 2 * 6 * 86
    assert set(groups["feature"]) == set(measured.PHANTOM4RADIOMICS_FEATURES) and set(dose["feature"]) == set(FEATURES)
    assert groups.notna().all().all() and dose.notna().all().all()
    assert (dose["n"] == 10).all() and groups["n"].between(26, 30).all()
    assert measured.group_means().shape == (48, 3 + 85)


def test_mean_hu_of_the_rois_agrees_with_the_data_sets_notes():
    means = measured.group_means().groupby("roi")["original_firstorder_Mean"].mean()
    noted = {"normal_1": 98, "normal_2": 86, "cyst_1": 5, "cyst_2": 14, "hemangioma": 43, "metastasis": 45}
    assert means.to_dict() == pytest.approx(noted, abs=1)


@pytest.mark.parametrize("reconstruction, variances", [("fbp", [1253, 740, 365]), ("iterative", [674, 413, 228])])
def test_variance_of_the_large_cyst_against_dose(reconstruction, variances):
    assert [dose_variance(reconstruction, dose) for dose in (1, 3, 10)] == pytest.approx(variances, abs=1)


def test_unknown_dose_is_rejected():
    with pytest.raises(InputError, match="no value for reconstruction fbp, 2 mGy, ROI cyst_1"):
        dose_variance("fbp", 2)


def test_scores_of_equal_repeats():
    """|W| grows with the root of the repeats: fewer repeats give higher stability and lower discrimination."""
    means = {
        number: [repeats.mean_over_features(measured.load_score_draws(number), kind)[0] for kind in KINDS]
        for number in (3, 10, 19)
    }
    assert means[3][0] > means[10][0] > means[19][0] and means[3][1] < means[10][1] < means[19][1]
    ten = measured.load_score_draws(10)
    assert len(ten) == repeats.DRAWS * 85 and (ten["of"] == 19).all()
    assert list(ten["feature"][:85]) == list(measured.PHANTOM4RADIOMICS_FEATURES)
    assert (measured.load_score_draws(100)["repeats"] == 19).all()
    assert (measured.load_score_draws(3, "all")["of"] == 29).all()
    with pytest.raises(InputError, match="'some' is not known; choose from fixed, all"):
        measured.load_score_draws(10, "some")
    with pytest.raises(InputError, match="there are no draws of 1 acquisitions from 'all'"):
        measured.load_score_draws(1, "all")


@pytest.mark.real
def test_stored_draws_equal_those_of_the_table(study):
    for acquisitions, table in (("fixed", study[study["acquisition"] <= 20]), ("all", study)):
        shipped = measured.load_score_draws(10, acquisitions)
        found = next(repeats.subsamples(table, 10, "acquisition", shared=True))
        scores = wilcoxon.scores(found[0], measured.PHANTOM4RADIOMICS_FEATURES)
        for kind in KINDS:
            assert np.allclose(shipped.loc[shipped["draw"] == 1, f"{kind}_percent"], scores[f"{kind}_percent"])
    # Ten per group, drawn by another program: 17.5 and 79.2 %, with an SD of about 1 %
    assert repeats.mean_over_features(shipped, "stability")[0] == pytest.approx(17.5, abs=1)
    assert repeats.mean_over_features(shipped, "discrimination")[0] == pytest.approx(79.2, abs=1)


@pytest.mark.real
@pytest.mark.skipif(not STUDY.exists(), reason="the table of CT-Phantom4Radiomics is not beside the checkout")
def test_stored_group_summary_equals_that_of_the_table():
    table = convert_to_hu(measured.load_full_table(STUDY))
    means = (
        table.groupby(["group", "roi", "tissue_class"])[list(measured.PHANTOM4RADIOMICS_FEATURES)].mean().reset_index()
    )
    shipped = measured.group_means()[list(means.columns)]
    pd.testing.assert_frame_equal(shipped, means, rtol=1e-7, check_dtype=False)
    raw = measured.load_full_table(STUDY)  # assumptions of convert_to_hu about the file
    square = raw["original_firstorder_Variance"] + raw["original_firstorder_Mean"] ** 2
    assert np.allclose(raw["original_firstorder_Energy"], raw["n_voxels"] * square, rtol=1e-12)


@pytest.mark.real
@pytest.mark.skipif(not DOSE.exists(), reason="the table of the dose series is not beside the checkout")
def test_stored_dose_series_equals_that_of_the_table():
    raw = pd.read_csv(DOSE)
    shipped = read_csv(dose_series.TABLE)
    for (dose, code, name), rows in raw.groupby(["dose_mGy", "recon_code", "roi6"]):
        of = shipped[
            (shipped["dose_mgy"] == dose)
            & (shipped["reconstruction"] == measured.DOSE_RECONSTRUCTIONS[code])
            & (shipped["roi"] == measured.DOSE_ROIS[name])
        ].set_index("feature")
        assert np.allclose(of.loc[list(FEATURES), "mean"], rows[list(FEATURES)].mean(), rtol=1e-7)
        assert np.allclose(of.loc[list(FEATURES), "sd"], rows[list(FEATURES)].std(), rtol=1e-6)
