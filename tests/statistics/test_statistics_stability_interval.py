"""Confidence interval of the stability: closed forms, scipy, and coverage of a known truth."""

from itertools import combinations, product

import numpy as np
import pandas as pd
import pytest
from scipy.stats import mannwhitneyu, ranksums

from virtual_phantom.statistics import rank_sum, stability_interval, trust
from virtual_phantom.statistics.rank_sum import stable_probability
from virtual_phantom.statistics.stability_interval import stability_intervals

ROIS = 6
APART = [[roi] for roi in range(ROIS)]


def studies(number, groups, repeats, spread, seed=0, rois=ROIS):
    """Features [feature, roi, group, repeat] of normal values with SD 1, and the groups' means."""
    rng = np.random.default_rng(seed)
    means = spread * rng.normal(size=(rois, groups))
    return means + np.zeros((number, 1, 1)), rng.normal(size=(number, rois, groups, repeats)) + means[..., None]


def stable_by_scipy(x, units=APART):
    """Share of comparisons with |W| < 1, by single scipy.stats.ranksums."""
    groups = range(x.shape[1])
    found = [
        abs(ranksums(x[unit][:, a].ravel(), x[unit][:, b].ravel()).statistic) < 1
        for unit in units
        for a, b in product(groups, groups)
        if a < b
    ]
    return np.mean(found)


@pytest.mark.parametrize("repeats", [1, 2, 3, 4, 5])
def test_equal_groups_agree_as_often_as_the_exact_distribution_states(repeats):
    """All assignments of the ranks; scipy's exact p-value of the first statistic that is not stable."""
    ranks = np.arange(2 * repeats)
    rows = [np.isin(ranks, chosen) for chosen in map(list, combinations(range(2 * repeats), repeats))]
    stable = [abs(ranksums(ranks[row], ranks[~row]).statistic) < 1 for row in rows]
    assert stable_probability(repeats) == pytest.approx(np.mean(stable))
    unstable = [
        mannwhitneyu(ranks[row], ranks[~row], method="exact").pvalue
        for row, yes in zip(rows, stable, strict=True)
        if not yes
    ]
    assert stable_probability(repeats) == pytest.approx(1 - max(unstable, default=0.0))


def test_many_repeats_approach_the_normal_distribution(monkeypatch):
    exact = stable_probability(50)
    monkeypatch.setattr(rank_sum, "EXACT_UP_TO", 49)
    assert stable_probability(50) == pytest.approx(exact, abs=2e-3)
    assert stable_probability(3, 2.0) > stable_probability(3, 1.0)


@pytest.mark.parametrize("units", [APART, [[0, 3], [1, 4], [2, 5]]])
def test_value_equals_scipys_share(units):
    _, x = studies(4, 3, 5, 0.5)
    x[0] = np.round(x[0])  # ties
    x[1, 2] = 7.0  # an ROI without variation
    found = stability_intervals(x, units, range(3))
    assert found.value == pytest.approx([stable_by_scipy(one, units) for one in x])
    for inside in (found.low <= found.value, found.value <= found.high, found.twice_low <= found.twice_high):
        assert inside.all()
    assert (found.low >= 0).all() and (found.high <= 1).all()


def test_equal_and_different_groups():
    _, equal = studies(1, 4, 6, 0.0)
    _, different = studies(1, 4, 6, 100.0)
    found = stability_intervals(np.concatenate([equal, different]), APART, range(4))
    assert found.value[1] == found.low[1] == 0 and 0 < found.high[1] < 0.25
    assert found.low[0] > 0.3 and found.high[0] >= stable_probability(6)
    # More repeats show existing differences better, and no others.
    assert found.twice[0] > 0.4 and found.twice[1] < 0.01


def test_one_repeat_gives_no_interval():
    _, x = studies(2, 3, 1, 1.0)
    found = stability_intervals(x, APART, range(3))
    assert (found.value == 0).all() and np.isnan(found.low).all() and np.isnan(found.twice_high).all()


def test_shared_noise_is_simulated():
    """Without a true difference, reconstructions of the same scans agree more often than different scans."""
    rng = np.random.default_rng(3)
    scans = rng.normal(size=(ROIS, 1, 8))
    x = np.concatenate([scans + 0.5 * rng.normal(size=(ROIS, 2, 8)), rng.normal(size=(ROIS, 1, 8))], axis=1)
    shared = np.array([[True, True, False], [True, True, False], [False, False, True]])
    root = stability_interval._root_of_correlation(x, x.std(axis=-1, ddof=1), shared)
    each = np.mean([np.corrcoef(one) for one in x], axis=0)
    assert root @ root.T == pytest.approx(np.where(shared, each, 0)) and each[0, 1] > 0.6
    design = stability_interval._Design.of((ROIS, 3), 8, APART, 1.0, 400)
    together, alone = (
        stability_interval._ScaledStudies(x, one, design).stability(0.0).mean() for one in (shared, np.eye(3))
    )
    # One pair of three: if both were the same, all of its comparisons would agree.
    assert 0.04 < together - alone < (1 - stable_probability(8)) / 3


def test_interval_does_not_depend_on_other_features():
    _, x = studies(3, 3, 4, 0.5)
    both, alone = stability_intervals(x, APART, range(3)), stability_intervals(x[1:2], APART, range(3))
    assert both.low[1] == alone.low[0] and both.twice_high[1] == alone.twice_high[0]


@pytest.mark.parametrize("spread, groups, repeats", [(0.3, 4, 5), (1.0, 4, 5), (3.0, 4, 3)])
def test_intervals_cover_the_expected_stability(spread, groups, repeats, monkeypatch):
    """The level is 95 %. For 150 intervals, coverage of fewer than 135 or of all has a probability of 1 in 2000.

    The truth is the mean over 4000 studies with the same means. All numbers: benchmarks/stability_interval.py.
    """
    monkeypatch.setattr(stability_interval, "SIMULATIONS", 150)
    means, x = studies(150, groups, repeats, spread, seed=5)
    design = stability_interval._Design.of(means.shape[1:], repeats, APART, 1.0, 1)
    noise = np.random.default_rng(6).normal(size=(4000, *x.shape[1:]))
    truth = design.stability(noise + means[0][..., None]).mean()
    found = stability_intervals(x, APART, range(groups))
    covered = int(((found.low <= truth) & (truth <= found.high)).sum())
    assert 135 <= covered < 150
    assert 0.02 < (found.high - found.low).mean() < 0.45


def rows(x, features):
    """A feature table in the form of `features.tables.read_groups`."""
    _, rois, groups, repeats = x.shape
    return pd.DataFrame(
        [
            {"group": group + 1, "roi": f"roi{roi}", "tissue_class": f"class{roi // 2}", "seed": seed}
            | {name: x[place, roi, group, seed] for place, name in enumerate(features)}
            for roi in range(rois)
            for group in range(groups)
            for seed in range(repeats)
        ]
    )


FEATURES = ("original_firstorder_Mean", "original_glcm_Idn", "original_firstorder_Energy")


@pytest.fixture(scope="module")
def said():
    x = np.concatenate([studies(1, 6, 4, spread)[1] for spread in (0.0, 1.0, 50.0)])
    return trust.trust_table(rows(x, FEATURES), FEATURES, dict(enumerate("abcabc", 1)), cut_off=25)


def test_row_states_its_comparisons(said):
    assert list(said["feature"]) == list(FEATURES) and set(said["family"]) == {"first order", "GLCM"}
    numbers = said[["groups", "rois", "repeats", "comparisons", "cut_off_percent"]].drop_duplicates()
    assert numbers.to_numpy().tolist() == [[6, ROIS, 4, 15 * ROIS, 25.0]]
    assert said["if_equal_percent"].to_numpy() == pytest.approx(100 * stable_probability(4))
    assert list(said["stable"]) == ["yes", "undecided", "no"]
    first, last = said["sentence"].iloc[[0, 2]]
    assert first.startswith("Stable: ") and "of 90 comparisons between protocols agree" in first
    assert last.startswith("Not stable: 0 % of 90 comparisons between protocols agree (95 % interval 0 to ")
    assert last.endswith("%).") and "Twice the repeats would give about " in last


def test_classes_are_pooled_like_the_score(said):
    x = studies(1, 3, 4, 0.7)[1]
    found = trust.trust_table(
        rows(x, FEATURES[:1]), FEATURES[:1], {1: 1, 2: 2, 3: 3}, cut_off=50, compare="tissue_class"
    )
    assert found["comparisons"].tolist() == [9]
    assert found["stability_percent"].to_numpy() / 100 == pytest.approx(stable_by_scipy(x[0], [[0, 1], [2, 3], [4, 5]]))
    assert found["if_equal_percent"].to_numpy() == pytest.approx(100 * stable_probability(8))


def test_verdict_uses_the_interval():
    low, high = np.array([50.0, 49.0, 10.0, np.nan]), np.array([80.0, 80.0, 49.9, np.nan])
    assert list(trust.verdicts(low, high, 50)) == ["yes", "undecided", "no", "undecided"]
    alone = {"ci95_low": np.nan}
    assert trust.sentence(alone).startswith("Undecided: one repeat per group")


@pytest.mark.parametrize("value, text", [(0, "0"), (0.62, "0.6"), (9.94, "9.9"), (9.96, "10"), (67.4, "67")])
def test_percentages(value, text):
    assert trust.percent(value) == text
