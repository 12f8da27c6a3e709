from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import ranksums

from virtual_phantom.base.data import RESOURCES
from virtual_phantom.base.errors import InputError
from virtual_phantom.io.files import read_csv
from virtual_phantom.statistics import measured, repeats, wilcoxon

FEATURE = "original_firstorder_Mean"
TABLE = Path(__file__).resolve().parents[2] / "../shared/real/ct_phantom4radiomics/features_2d.csv"


def column(*values):
    return np.array(values, dtype=float)[:, None]


@pytest.mark.parametrize(
    "a, b, expected",
    [
        # Ranks 1 2 3, sum 6; expected 3 x 7 / 2 = 10.5, variance 3 x 3 x 7 / 12 = 5.25.
        (column(1, 2, 3), column(4, 5, 6), 4.5 / np.sqrt(5.25)),
        # Ranks 1 and 2.5 (tied), sum 3.5; expected 2 x 5 / 2 = 5, variance 2 x 2 x 5 / 12.
        (column(1, 2), column(2, 3), 1.5 / np.sqrt(5 / 3)),
        # Ranks 1 and 4 of 4, sum 5: exactly the expectation.
        (column(1, 9), column(2, 3), 0.0),
    ],
)
def test_w_of_simple_values(a, b, expected):
    assert wilcoxon.ranksum_z(a, b) == pytest.approx([expected])
    assert wilcoxon.ranksum_z(b, a) == pytest.approx([expected])


def test_w_of_many_features_at_once_equals_that_of_each():
    a, b = np.random.default_rng(0).integers(0, 9, (2, 7, 5)).astype(float)
    each = [abs(ranksums(a[:, i], b[:, i]).statistic) for i in range(5)]
    assert wilcoxon.ranksum_z(a, b).tolist() == each


ROIS = {"cyst_1": "cyst", "cyst_2": "cyst", "metastasis": "metastasis"}


def table(value, groups=(1, 2, 3), repeats=6, rois=ROIS):
    """value(group, roi, repeat) of every row."""
    return pd.DataFrame(
        [
            {"group": group, "roi": roi, "tissue_class": name, FEATURE: float(value(group, roi, repeat))}
            for group in groups
            for roi, name in rois.items()
            for repeat in range(repeats)
        ]
    )


def percents(result, *more):
    return result.loc[0, ["stability_percent", "discrimination_percent", *more]].tolist()


def test_feature_that_depends_on_the_class_only_scores_100_and_100():
    scores = wilcoxon.scores(table(lambda g, roi, k: 100 * (roi == "metastasis") + k), [FEATURE])
    assert percents(scores) == [100, 100]


def test_feature_that_depends_on_the_group_only_scores_0_and_0():
    assert percents(wilcoxon.scores(table(lambda g, roi, k: 100 * g + k), [FEATURE])) == [0, 0]


def test_counts_and_classes():
    # Only the metastasis drifts: its 3 pairs of groups are unstable, the cysts' 6 are stable. Cyst and metastasis are
    # distinguished in groups 2 and 3 (2 pairs each) and not in group 1 (2 pairs).
    drift = table(lambda g, roi, k: 100 * (g - 1) * (roi == "metastasis") + k)
    scores = wilcoxon.scores(drift, [FEATURE])
    assert percents(scores, "stability_cyst", "stability_metastasis") == pytest.approx([600 / 9, 400 / 6, 100, 0])
    assert scores.loc[0, ["stability_comparisons", "discrimination_comparisons"]].tolist() == [9, 6]
    pooled = wilcoxon.scores(drift, [FEATURE], compare="tissue_class")
    assert percents(pooled, "stability_cyst", "stability_metastasis") == pytest.approx([50, 200 / 3, 100, 0])
    assert pooled.loc[0, ["stability_comparisons", "discrimination_comparisons"]].tolist() == [6, 3]


def test_eight_groups_of_the_paper_give_28_pairs_per_roi():
    rois = dict(zip(("n1", "n2", "c1", "c2", "hem", "met"), "nncchm", strict=True))
    scores = wilcoxon.scores(table(lambda g, roi, k: k, groups=range(8), repeats=2, rois=rois), [FEATURE])
    assert scores.loc[0, ["stability_comparisons", "discrimination_comparisons"]].tolist() == [6 * 28, 8 * 13]


def test_threshold_changes_both_scores():
    # 1 2 3 against 4 5 6 in either direction: W is 1.964 (see above).
    difference = table(lambda g, roi, k: 3 * g + 3 * (roi == "metastasis") + k, groups=(1, 2), repeats=3)
    assert percents(wilcoxon.scores(difference, [FEATURE], threshold=1.96)) == [0, 100]
    assert percents(wilcoxon.scores(difference, [FEATURE], threshold=1.97)) == [100, 0]


@settings(max_examples=25, deadline=None)
@given(values=st.lists(st.integers(-20, 20), min_size=36, max_size=36), seed=st.integers(0, 2**16))
def test_monotonic_transforms_and_the_order_of_repeats_have_no_effect(values, seed):
    start = table(lambda g, roi, k: 0, groups=(1, 2), repeats=6).assign(**{FEATURE: np.array(values, dtype=float)})
    scores = wilcoxon.scores(start, [FEATURE])
    cubed = start.assign(**{FEATURE: start[FEATURE] ** 3 + start[FEATURE]})
    assert wilcoxon.scores(cubed, [FEATURE]).equals(scores)
    shuffled = start.sample(frac=1, random_state=seed)
    assert wilcoxon.scores(shuffled, [FEATURE])[scores.columns].equals(scores)


@pytest.mark.parametrize(
    "change, options, message",
    [
        (lambda t: t, {"test": "t"}, "statistics.test: 't' is not known; choose from ranksum_z"),
        (
            lambda t: t,
            {"compare": "voxel"},
            "statistics.compare: 'voxel' is not known; choose from roi, tissue_class",
        ),
        (lambda t: t, {"threshold": 0}, "statistics.threshold: 0 must be positive"),
        (lambda t: t[(t["group"] != 2) | (t["roi"] != "cyst_2")], {}, "features: group 2 has no roi cyst_2"),
        # Two protocols with number 1
        (
            lambda t: t.assign(seed=[*range(6)] * 9, group=t["group"].replace(2, 1)),
            {},
            "features: two rows for ROI cyst_1, group 1, seed 0; give each protocol a different group",
        ),
        (
            lambda t: t.assign(**{FEATURE: t[FEATURE].mask(t.index == 20)}),
            {},
            "original_firstorder_Mean is nan for group 2, roi cyst_1",
        ),
    ],
)
def test_bad_input_is_one_clear_line(change, options, message):
    with pytest.raises(InputError) as caught:
        wilcoxon.scores(change(table(lambda g, roi, k: k)), [FEATURE], **options)
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_one_group_has_no_stability_and_one_class_no_discrimination():
    both = table(lambda g, roi, k: k)
    alone = wilcoxon.scores(both[both["group"] == 1], [FEATURE]).iloc[0]
    assert np.isnan(alone["stability_percent"]) and alone["discrimination_percent"] == 0
    assert alone["stability_comparisons"] == 0 and alone["discrimination_comparisons"] > 0
    cysts = wilcoxon.scores(both[both["tissue_class"] == "cyst"], [FEATURE]).iloc[0]
    assert cysts["stability_percent"] == 100 and np.isnan(cysts["discrimination_percent"])
    one = wilcoxon.scores(both[both["roi"] == "cyst_1"], [FEATURE]).iloc[0]
    assert one["stability_percent"] == 100 and one["stability_comparisons"] == 3


@pytest.mark.parametrize("column, value, kind", [("group", 1, "group"), ("tissue_class", "cyst", "tissue class")])
def test_scores_of_recordings_need_both(column, value, kind):
    rows = table(lambda g, roi, k: k)
    with pytest.raises(InputError, match=f"recording: 1 {kind}; stability and discrimination need at least two"):
        repeats.score_draws(rows[rows[column] == value], [FEATURE], 3, unit="seed", source="recording")


@pytest.fixture(scope="module")
def study():
    if not TABLE.exists():
        pytest.skip("the measured table of CT-Phantom4Radiomics is not beside the checkout")
    return measured.load_full_table(TABLE)


@pytest.mark.real
def test_measured_data_reproduce_the_published_result(study):
    scores = wilcoxon.scores(study, measured.PHANTOM4RADIOMICS_FEATURES)
    assert scores["stability_percent"].mean() == pytest.approx(11, abs=0.5)
    assert scores["discrimination_percent"].mean() == pytest.approx(88, abs=0.5)
    published = measured.load_published_top().query("kind == 'stability' and source == 'phantom'")["feature"]
    best = scores.sort_values("stability_percent", ascending=False, kind="stable")["feature"][:12]
    assert len(set(best) & set(published)) == 7
    # With pairs of ROIs of one class (15 instead of 13 per group), discrimination is 87 %.
    all_pairs = wilcoxon.scores(study.assign(tissue_class=study["roi"]), measured.PHANTOM4RADIOMICS_FEATURES)
    assert all_pairs["discrimination_percent"].mean() == pytest.approx(87, abs=0.5)


@pytest.mark.real
def test_roi_wise_comparison_ranks_published_discriminative_features_higher_than_pooling(study):
    published = measured.load_published_top().query("kind == 'discrimination' and source == 'phantom'")["feature"]
    rank = {
        compare: wilcoxon.scores(study, measured.PHANTOM4RADIOMICS_FEATURES, compare=compare)
        .set_index("feature")["discrimination_percent"]
        .rank(ascending=False)
        for compare in wilcoxon.COMPARE
    }
    sized = [
        feature
        for feature in published
        if feature in measured.PHANTOM4RADIOMICS_FEATURES and not feature.endswith(("Median", "Mean", "Minimum"))
    ]
    assert len(sized) == 6
    assert rank["roi"][sized].median() < 25 < 60 < rank["tissue_class"][sized].median()


@pytest.mark.real
def test_stored_scores_equal_those_of_the_table(study):
    stored = read_csv(RESOURCES / "ct_phantom4radiomics_scores.csv")
    scores = wilcoxon.scores(study, measured.PHANTOM4RADIOMICS_FEATURES)[list(stored.columns)]
    assert list(stored["feature"]) == list(scores["feature"])
    assert np.allclose(stored.iloc[:, 1:], scores.iloc[:, 1:], rtol=1e-7)
