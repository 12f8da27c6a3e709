from itertools import permutations, product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import hypergeom, spearmanr

from virtual_phantom.base.errors import InputError
from virtual_phantom.features.extraction import FEATURES
from virtual_phantom.statistics import measured, ranking, repeats, wilcoxon

STUDY = Path(__file__).resolve().parents[2] / "../shared/real/ct_phantom4radiomics/features_2d.csv"


def table(stability, discrimination=None, features=FEATURES):
    stability = np.asarray(stability, dtype=float)
    discrimination = stability if discrimination is None else np.asarray(discrimination, dtype=float)
    return pd.DataFrame(
        {
            "feature": list(features)[: len(stability)],
            "stability_percent": stability,
            "discrimination_percent": discrimination,
        }
    )


def independent(features=FEATURES):
    return pd.DataFrame(np.eye(len(features)), index=list(features), columns=list(features))


@pytest.mark.parametrize("items, n", [(12, 3), (15, 7), (10, 1)])
def test_unrelated_lists_of_independent_features_follow_the_hypergeometric_distribution(items, n):
    scores = np.random.default_rng(1).normal(size=items)
    found = np.round(ranking.random_overlaps(ranking.memberships(scores), np.eye(items))[:, n - 1] * n)
    for shared in range(n + 1):
        expected = hypergeom.pmf(shared, items, n, n)
        assert np.mean(found == shared) == pytest.approx(expected, abs=4 * np.sqrt(0.25 / ranking.RANDOM_LISTS))


def test_identical_features_are_selected_together():
    """Ten pairs of identical features, adjacent in the given list: a random list shares whole pairs."""
    pairs = np.kron(np.eye(10), np.ones((2, 2)))
    found = ranking.random_overlaps(ranking.memberships(-np.arange(20.0)), pairs)[:, 9] * 10
    assert np.array_equal(found, 2 * np.round(found / 2))  # five of ten pairs, and all of a pair
    for shared in range(6):
        expected = hypergeom.pmf(shared, 10, 5, 5)
        assert np.mean(found == 2 * shared) == pytest.approx(expected, abs=4 * np.sqrt(0.25 / ranking.RANDOM_LISTS))


def test_shared_variance_is_the_mean_square_of_spearmans_coefficient():
    rng = np.random.default_rng(4)
    values = rng.normal(size=(40, 3)) @ rng.normal(size=(3, 3))
    rows = pd.DataFrame(values, columns=list("abc")).assign(roi=["x"] * 15 + ["y"] * 25, d=1.0)
    found = ranking.shared_variance(rows, list("abcd"))
    for first, second in (("a", "b"), ("a", "c"), ("b", "c")):
        each = [spearmanr(part[first], part[second]).statistic ** 2 for _, part in rows.groupby("roi")]
        assert found.loc[first, second] == found.loc[second, first] == pytest.approx(np.mean(each))
    assert np.diag(found).tolist() == [1] * 4 and (found.loc["d", list("abc")] == 0).all()  # d never varies


def unrelated_study(rng, root, spread_of_merits):
    """Study whose groups and ROIs differ by random values, with features correlated by `root`.

    One root is for values, and one for the changes between groups, which correlated features share.
    """
    merit = np.exp(spread_of_merits * (root[1] @ rng.standard_normal(len(root[0]))))
    rows = []
    for roi in range(3):
        where = 5 * root[0] @ rng.standard_normal(len(root[0]))
        for group in range(5):
            shift = merit * (root[0] @ rng.standard_normal(len(root[0])))
            values = where + shift + rng.standard_normal((8, len(root[0]))) @ root[0].T
            rows.append(pd.DataFrame(values).assign(group=group, roi=roi, tissue_class=roi))
    return pd.concat(rows, ignore_index=True)


@pytest.mark.real
@pytest.mark.skipif(not STUDY.exists(), reason="the table of CT-Phantom4Radiomics is not beside the checkout")
def test_scores_correlate_by_the_squared_correlation_of_features_without_group_differences():
    """Real scans, assigned to groups at random: the order of features is then random."""
    study = measured.load_full_table(STUDY)
    study = study[(study["repositioned"] == 0) & (study["group"] <= 5)]
    names = list(measured.PHANTOM4RADIOMICS_FEATURES)
    rng = np.random.default_rng(np.random.SeedSequence(4))
    stability = []
    for _ in range(60):
        dealt = study.groupby("roi")["group"].transform(lambda groups: rng.permutation(groups.to_numpy()))
        stability.append(wilcoxon.scores(study.assign(group=dealt), names)["stability_percent"])
    pairs = np.triu_indices(len(names), 1)
    squares = ranking.shared_variance(study, names).to_numpy()[pairs]
    slope, offset = np.polyfit(squares, np.corrcoef(np.transpose(stability))[pairs], 1)
    # A coefficient of 60 realizations has a standard error of 0.13; those of 3,570 pairs are dependent.
    assert slope == pytest.approx(1, abs=0.15) and offset == pytest.approx(0, abs=0.1)


def test_band_covers_95_percent_of_unrelated_studies_unlike_that_of_independent_features():
    """40 features in 5 clusters of 8 with a correlation of 0.95, in two otherwise unrelated studies."""
    rng = np.random.default_rng(np.random.SeedSequence(23))
    correlations = np.where(np.kron(np.eye(5), np.ones((8, 8))) > 0, 0.95, 0) + 0.05 * np.eye(40)
    root = np.linalg.cholesky(correlations), np.linalg.cholesky(correlations**2)
    names = list(FEATURES[:40])
    inside, independent_inside = [], []
    for _ in range(25):
        one, other = (unrelated_study(rng, root, 1.0).rename(columns=dict(enumerate(names))) for _ in range(2))
        scores = [wilcoxon.scores(study, names) for study in (one, other)]
        for shared, stored in ((ranking.shared_variance(one, names), inside), (independent(names), independent_inside)):
            found = ranking.overlap(*scores, shared)
            for kind in ranking.KINDS:
                share, lower, upper = (
                    found[f"{what}_{kind}_percent"].to_numpy()[:-1] for what in ("overlap", "lower", "upper")
                )
                stored.append(np.mean((share >= lower - 1e-9) & (share <= upper + 1e-9)))
    # 50 curves with dependent lengths: the mean share inside has a standard error of 0.02.
    assert np.mean(inside) > 0.93
    assert np.mean(independent_inside[::2]) < 0.87  # of stability


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.integers(0, 2), min_size=5, max_size=5),
    st.lists(st.integers(0, 2), min_size=5, max_size=5),
    st.integers(1, 5),
)
def test_overlap_with_ties_is_the_mean_over_every_order(a, b, n):
    def tops(scores):  # every order of the five items that the scores allow, cut after n
        return [
            set(order[:n])
            for order in permutations(range(5))
            if all(scores[i] >= scores[j] for i, j in zip(order, order[1:], strict=False))
        ]

    brute = np.mean([len(x & y) for x, y in product(tops(a), tops(b))])
    assert ranking.membership(np.array(a), n) @ ranking.membership(np.array(b), n) == pytest.approx(brute)


def test_equal_and_opposite_rankings():
    scores = np.arange(10.0)
    same = ranking.overlap(table(scores), table(scores), independent())
    assert (same["overlap_stability_percent"] == 100).all() and (same["area_stability"] == 1).all()
    opposite = ranking.overlap(table(scores), table(scores[::-1]), independent())
    # The best n and the worst n of ten share max(0, 2n - 10).
    assert opposite["overlap_discrimination_percent"].tolist() == pytest.approx(
        [100 * max(0, 2 * n - 10) / n for n in range(1, 11)]
    )
    assert same["percent"].tolist() == pytest.approx(list(range(10, 101, 10)))


def test_constant_scores_give_the_overlap_of_unrelated_lists():
    result = ranking.overlap(table(np.zeros(12)), table(np.arange(12.0)), independent())
    # n^2 / 12 on average; 2000 lists differ by at most 4 standard errors
    expected = 100 * np.arange(1, 13) / 12
    assert result["overlap_stability_percent"].tolist() == pytest.approx(expected.tolist())
    assert np.abs(result["expected_stability_percent"] - expected).max() < 4 * 50 / np.sqrt(ranking.RANDOM_LISTS)
    assert result["area_stability"].iloc[0] == pytest.approx(13 / 24)  # mean of n / 12


def test_features_of_one_table_only_are_excluded():
    simulated = table(np.arange(86.0))
    result = ranking.overlap(simulated, measured.load_score_draws(10), independent())
    assert (result["n_features"] == 85).all() and len(result) == 85
    assert result["overlap_stability_percent"].iloc[-1] == pytest.approx(100)
    with pytest.raises(InputError, match="share 0 features"):
        ranking.overlap(simulated, table(np.arange(3.0), features=["a", "b", "c"]), independent())


def test_top_lists_are_ordered_and_mark_ties():
    stability = np.zeros(86)
    stability[[40, 3]] = 70, 90
    stability[[10, 60]] = 50
    top = ranking.top_features(table(stability, np.arange(86)), measured.load_published_top())
    assert list(top["rank"]) == list(range(1, 11))
    assert list(top["stability_simulated"][:4]) == [FEATURES[i] for i in (3, 40, 10, 60)]
    assert list(top["stability_simulated_percent"][:5]) == [90, 70, 50, 50, 0]
    assert list(top["stability_simulated_tied"][:5]) == [1, 1, 2, 2, 82]
    assert top["discrimination_simulated"][0] == FEATURES[85]


def test_fewer_features_than_ranks_give_as_many_rows():
    few, draws = table(np.arange(86)).head(4), table(np.arange(86)).assign(draw=1, repeats=1, of=3)
    top = ranking.top_features(few, measured.load_published_top(), draws)
    assert list(top["rank"]) == [1, 2, 3, 4] and list(top["stability_simulated"]) == list(FEATURES[3::-1])
    assert top["stability_measured"][0] == FEATURES[85]


def test_measured_top_lists_are_sorted_by_means_over_realizations():
    draws = pd.concat(
        [
            table(scores).assign(draw=draw, repeats=1, of=3)
            for draw, scores in enumerate([np.arange(86.0), np.where(np.arange(86) == 7, 300, np.arange(86.0))], 1)
        ],
        ignore_index=True,
    )
    top = ranking.top_features(table(np.arange(86)), measured.load_published_top(), draws)
    assert list(top["stability_measured"][:2]) == [FEATURES[7], FEATURES[85]]
    assert list(top["stability_measured_percent"][:2]) == [(7 + 300) / 2, 85]
    # SD of 7 and 300 is 293 / sqrt(2), for one of three: divided by sqrt(1 - 1 / 3)
    assert top["stability_measured_sd"][0] == pytest.approx(293 / np.sqrt(2) / np.sqrt(2 / 3))
    assert top["stability_measured_sd"][1] == 0


def test_overlap_is_the_mean_over_realizations_with_their_spread():
    order = np.arange(10.0)
    draws = pd.concat(
        [table(scores).assign(draw=draw, repeats=5, of=20) for draw, scores in ((1, order), (2, order[::-1]))],
        ignore_index=True,
    )
    found = ranking.overlap(table(order), draws, independent())
    # The same order shares all five, the opposite order none.
    assert found["overlap_stability_percent"][4] == pytest.approx(50)
    assert found["overlap_stability_sd"][4] == pytest.approx(100 / np.sqrt(2) / np.sqrt(1 - 5 / 20))
    assert ranking.overlap(table(order), table(order), independent())["overlap_stability_sd"].isna().all()
    assert (
        ranking.lengths_above(found.assign(upper_stability_percent=49.0), "stability")
        == (found["overlap_stability_percent"] > 49).sum()
    )
    assert repeats.sampling_fraction(draws) == 0.25


def test_other_phantoms_have_no_columns_of_the_printed_phantom():
    top = ranking.top_features(table(np.arange(86)))
    assert len(top) == 10 and list(top.filter(regex="published|measured")) == []
    assert list(top) == [
        "rank",
        *(f"{kind}_simulated{end}" for kind in ranking.KINDS for end in ("", "_percent", "_tied")),
    ]


def test_published_lists_equal_the_papers():
    published = measured.load_published_top()
    assert published.groupby(["kind", "source"]).size().tolist() == [10] * 4
    assert set(published["feature"]) <= set(FEATURES)
    top = ranking.top_features(table(np.arange(86)), published)
    # First and last lines of the two halves of the paper's appendix table.
    ends = top.filter(like="published").iloc[[0, 9]].map(lambda name: name.removeprefix("original_"))
    assert ends.to_numpy().tolist() == [
        [
            "glszm_SmallAreaLowGrayLevelEmphasis",
            "gldm_LargeDependenceHighGrayLevelEmphasis",
            "firstorder_90Percentile",
            "firstorder_Median",
        ],
        [
            "glcm_Idn",
            "glrlm_LowGrayLevelRunEmphasis",
            "glszm_LargeAreaEmphasis",
            "glszm_SizeZoneNonUniformity",
        ],
    ]


@pytest.mark.parametrize(
    "spoil, message",
    [
        (lambda scores: scores.drop(columns="stability_percent"), "lacks the column stability_percent"),
        (lambda scores: scores.assign(discrimination_percent=np.nan), "values that are not finite"),
        (lambda scores: scores.assign(discrimination_percent="5,0"), "values that are not finite"),
    ],
)
def test_broken_score_table_is_rejected(spoil, message):
    good = table(np.arange(86.0))
    with pytest.raises(InputError, match=f"simulated scores: .*{message}"):
        ranking.top_features(spoil(good), measured.load_published_top())
    with pytest.raises(InputError, match=f"simulated scores: .*{message}"):
        ranking.overlap(spoil(good), good, independent())
    with pytest.raises(InputError, match=f"measured scores: .*{message}"):
        ranking.overlap(good, spoil(good), independent())


def test_scores_of_both_are_in_one_table():
    """Means over realizations, their SD, and shared ranks of ties."""
    features = ["a", "b", "c"]
    simulated = pd.DataFrame({"feature": features, "family": "x", "stability_percent": [10.0, 30.0, 30.0]})
    simulated["discrimination_percent"] = 90.0
    recorded = pd.DataFrame({"feature": ["a", "b", "d"] * 2, "stability_percent": [40, 2, 1, 60, 4, 1]}).assign(
        discrimination_percent=80.0, repeats=3, of=10
    )
    table = ranking.compare_scores(simulated, recorded).set_index("feature")
    assert list(table.index) == ["a", "b"]
    assert table.loc["a", ["stability_percent_measured", "rank_measured", "rank_simulated"]].tolist() == [50, 1, 2]
    assert table.loc["a", "stability_sd_measured"] == pytest.approx(200**0.5)
    assert table.loc["b", ["stability_percent_simulated", "stability_percent_measured"]].tolist() == [30, 3]
    assert set(table["repeats"]) == {3}
