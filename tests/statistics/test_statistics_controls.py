"""Controls of the mean scores: chance against counts and scipy, shares of a constructed table."""

from itertools import combinations

import numpy as np
import pandas as pd
import pytest
from scipy.stats import mannwhitneyu, ranksums
from test_statistics_wilcoxon import ROIS, table

from virtual_phantom.base.errors import InputError
from virtual_phantom.statistics import controls, ranking, stability_measures, trust, wilcoxon
from virtual_phantom.statistics.rank_sum import differing_probability, stable_probability

MEAN, VOLUME, CONSTANT = "original_firstorder_Mean", "original_shape_MeshVolume", "original_firstorder_Minimum"
CUT_OFFS = {"w_stability_percent": 50.0, "icc": 0.75, "ccc": 0.9, "cv": 0.1, "qcd": 0.067}


@pytest.mark.parametrize(("n", "m"), [(1, 1), (2, 2), (3, 3), (2, 4), (5, 3), (5, 5)])
@pytest.mark.parametrize("threshold", [1.0, 1.5])
def test_chance_of_a_difference_is_the_share_of_all_orders(n, m, threshold):
    ranks = np.arange(n + m)
    rows = [np.isin(ranks, chosen) for chosen in map(list, combinations(range(n + m), n))]
    w = [wilcoxon.ranksum_z(ranks[row][:, None], ranks[~row][:, None])[0] for row in rows]
    assert differing_probability(n, m, threshold) == pytest.approx(np.mean(np.array(w) > threshold), abs=1e-12)


def test_ten_repeats_against_scipy_and_random_samples():
    assert differing_probability(10, 10) == pytest.approx(0.315, abs=5e-4)
    assert stable_probability(10) == pytest.approx(0.685, abs=5e-4)
    # W is 1 if U is 50 +- 13.2, so the chance is the two-sided p-value of U = 36: 3 values above all others, one above
    # 6 of them, and 6 below all.
    b = np.arange(10.0)
    a = np.array([11.0, 12, 13, 5.5, *range(-6, 0)])
    exact = mannwhitneyu(a, b, method="exact")
    assert exact.statistic == 36 and abs(ranksums(a, b).statistic) > 1
    assert differing_probability(10, 10) == pytest.approx(exact.pvalue, rel=1e-12)
    a, b = np.random.default_rng(1).normal(size=(2, 10, 40_000))
    share = np.mean(wilcoxon.ranksum_z(a, b) > 1)
    assert share == pytest.approx(exact.pvalue, abs=4 * np.sqrt(0.315 * 0.685 / 40_000))


def test_a_statistic_at_the_threshold_is_neither_stable_nor_different():
    """With 13 repeats, |W| is exactly 1 for rank sums that are 19.5 from their mean; with one repeat, always."""
    assert stable_probability(1) == differing_probability(1, 1) == 0
    assert stable_probability(13) + differing_probability(13, 13) < 0.99
    assert stable_probability(10) + differing_probability(10, 10) == pytest.approx(1)


def of(found, score, control):
    return found.set_index(["score", "control"]).loc[(score, control)]


def test_shares_of_a_constructed_table():
    # The two cysts differ in groups 1 and 2 of 4. The metastasis differs from both cysts in groups 2, 3 and 4, and in
    # group 1 only from cyst_2, so in 7 of 8 comparisons.
    shift = {"cyst_1": [0, 0, 0, 0], "cyst_2": [100, 100, 0, 0], "metastasis": [0, 300, 300, 300]}
    made = table(lambda group, roi, repeat: shift[roi][group - 1] + repeat, groups=(1, 2, 3, 4))
    found = controls.controls(made, [MEAN])
    across, same = of(found, "discrimination", "different classes"), of(found, "discrimination", "same class")
    assert across[["percent", "count", "comparisons", "pairs"]].tolist() == [87.5, 7, 8, 2]
    assert same[["percent", "count", "comparisons", "pairs"]].tolist() == [50, 2, 4, 1]
    # There are 6 pairs of groups: cyst_1 is stable in 6, cyst_2 in 2, the metastasis in 3.
    stable = of(found, "stability", "protocols")
    assert stable[["count", "comparisons", "pairs", "features", "repeats"]].tolist() == [11, 18, 6, 1, 6]
    scores = wilcoxon.scores(made, [MEAN])
    assert across["percent"] == scores["discrimination_percent"].mean()
    assert stable["percent"] == pytest.approx(scores["stability_percent"].mean())
    assert of(found, "stability", "chance")["percent"] == pytest.approx(100 * stable_probability(6))
    assert of(found, "discrimination", "chance")["percent"] == pytest.approx(100 * differing_probability(6, 6))
    assert controls.headline(found)["discrimination"] == (
        f"87.5 % (pairs of one tissue class: 50.0 %; by chance: {100 * differing_probability(6, 6):.1f} %)"
    )


def test_white_noise_has_rows_of_its_own():
    made = table(lambda group, roi, repeat: 100 * group + repeat)
    noise_only = table(lambda group, roi, repeat: 100 * (roi == "metastasis") + repeat)
    found = controls.add_noise_control(controls.controls(made, [MEAN]), noise_only, [MEAN])
    assert of(found, "stability", "white noise")[["percent", "count", "comparisons"]].tolist() == [100, 9, 9]
    assert of(found, "discrimination", "white noise")["percent"] == 100
    chance = f"by chance: {100 * stable_probability(6):.1f} %"
    assert controls.headline(found)["stability"] == f"0.0 % (noise without a scan: 100.0 %; {chance})"


def test_control_without_two_rois_of_one_class_is_reported_as_not_possible():
    single = {"cyst_1": "cyst", "metastasis": "metastasis"}
    found = controls.controls(table(lambda g, roi, k: k, rois=single), [MEAN])
    same = of(found, "discrimination", "same class")
    assert np.isnan(same["percent"]) and same["pairs"] == same["comparisons"] == 0
    assert same["meaning"] == "Not possible: no tissue class has two ROIs."
    assert "(no control of one tissue class; by chance: " in controls.headline(found)["discrimination"]
    pooled = controls.controls(table(lambda g, roi, k: k), [MEAN], compare="tissue_class")
    assert of(pooled, "discrimination", "same class")["meaning"].startswith("Not possible: statistics.compare pools")
    # Cysts are pooled: 12 values against 6.
    chance = of(pooled, "discrimination", "chance")["percent"]
    assert chance == pytest.approx(100 * differing_probability(12, 6))


@pytest.fixture
def with_shape():
    """A feature with noise, the volume of each ROI, and a value that is constant within each group."""
    rng = np.random.default_rng(2)
    rows = table(lambda g, roi, k: rng.normal() + 5 * (roi == "metastasis"))
    volume = dict(zip(ROIS, (10.0, 20.0, 30.0), strict=True))
    return rows.assign(
        seed=[*range(6)] * 9, **{VOLUME: rows["roi"].map(volume), CONSTANT: 7.0 + rows["roi"].map(volume)}
    )


def test_features_that_do_not_vary_are_not_stable(with_shape):
    features = [MEAN, VOLUME, CONSTANT]
    assert wilcoxon.varying(with_shape, features).tolist() == [True, False, False]
    scores = wilcoxon.scores(with_shape, features)
    percents = [name for name in scores if name.endswith("_percent") or name.startswith("stability_c")]
    assert scores.loc[1:, ["stability_percent", "discrimination_percent", "stability_cyst"]].isna().all(axis=None)
    assert scores.loc[[0], percents].equals(wilcoxon.scores(with_shape, [MEAN])[percents])
    assert controls.controls(with_shape, features).equals(controls.controls(with_shape, [MEAN]))
    found = trust.trust_table(with_shape, features, {1: 1, 2: 2, 3: 3}, 50.0)
    assert found["stable"].tolist()[1:] == ["does not vary"] * 2
    assert found.loc[1:, ["stability_percent", "ci95_low", "twice_repeats_percent"]].isna().all(axis=None)
    assert found["sentence"][1] == "Does not vary: shape features depend on the ROI only, not on the images."
    assert found["sentence"][2].startswith("Does not vary: all repeats")
    measures = stability_measures.measure_table(with_shape, found, features, CUT_OFFS)
    by_feature = stability_measures.stable_by_feature(measures)
    assert by_feature["stable_by"].tolist()[1:] == [0, 0]
    assert set(measures.loc[measures["feature"] != MEAN, "stable"]) == {"does not vary"}
    assert list(ranking.assessed(scores, "scores")["feature"]) == [MEAN]
    assert list(ranking.top_features(ranking.assessed(scores, "scores"))["stability_simulated"]) == [MEAN]


def test_shape_features_of_moved_rois_are_not_stable(with_shape):
    moved = with_shape.assign(**{VOLUME: with_shape[VOLUME] + with_shape["seed"]})
    assert wilcoxon.varying(moved, [VOLUME, MEAN]).tolist() == [False, True]


def test_single_repeats_count_as_varying(with_shape):
    once = with_shape[with_shape["seed"] == 0]
    assert wilcoxon.varying(once, [MEAN, VOLUME, CONSTANT]).tolist() == [True, False, True]


def test_study_of_shape_features_only_is_one_clear_line(with_shape):
    scores = wilcoxon.scores(with_shape, [VOLUME])
    with pytest.raises(InputError, match="tables/stability.csv: no feature varies over repeats"):
        ranking.assessed(scores, "tables/stability.csv")
    draws = pd.concat([wilcoxon.scores(with_shape, [MEAN, VOLUME]).assign(draw=draw) for draw in (1, 2)])
    assert set(ranking.assessed(draws, "draws")["feature"]) == {MEAN}
