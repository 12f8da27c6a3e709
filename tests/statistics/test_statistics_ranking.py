from itertools import combinations, permutations, product
from math import comb

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from virtual_phantom import measured
from virtual_phantom.errors import InputError
from virtual_phantom.radiomics import FEATURES
from virtual_phantom.statistics import ranking


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


@pytest.mark.parametrize("items, n", [(6, 3), (7, 2), (5, 5), (8, 1)])
def test_unrelated_overlap_by_listing_every_choice(items, n):
    counts = [len(set(range(n)) & set(choice)) for choice in combinations(range(items), n)]
    mean, lower, upper = ranking.uncorrelated_overlap(items, n)
    assert mean == pytest.approx(np.mean(counts)) == pytest.approx(n * n / items)
    cumulative = {k: sum(count <= k for count in counts) / comb(items, n) for k in range(-1, n + 1)}
    assert cumulative[lower - 1] < 0.025 <= cumulative[lower] + 1e-12
    assert cumulative[upper - 1] < 0.975 <= cumulative[upper] + 1e-12


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.integers(0, 2), min_size=5, max_size=5),
    st.lists(st.integers(0, 2), min_size=5, max_size=5),
    st.integers(1, 5),
)
def test_overlap_with_ties_is_the_mean_over_every_way_to_break_them(a, b, n):
    def tops(scores):  # every order of the five items that the scores allow, cut after n
        return [
            set(order[:n])
            for order in permutations(range(5))
            if all(scores[i] >= scores[j] for i, j in zip(order, order[1:], strict=False))
        ]

    brute = np.mean([len(x & y) for x, y in product(tops(a), tops(b))])
    assert ranking.expected_overlap(np.array(a), np.array(b), n) == pytest.approx(brute)


def test_equal_and_opposite_rankings():
    scores = np.arange(10.0)
    same = ranking.overlap(table(scores), table(scores))
    assert (same["overlap_stability_percent"] == 100).all() and (same["area_stability"] == 1).all()
    opposite = ranking.overlap(table(scores), table(scores[::-1]))
    # The best n and the worst n of ten share max(0, 2n - 10).
    assert opposite["overlap_discrimination_percent"].tolist() == pytest.approx(
        [100 * max(0, 2 * n - 10) / n for n in range(1, 11)]
    )
    assert same["percent"].tolist() == pytest.approx(list(range(10, 101, 10)))


def test_one_score_for_all_gives_what_unrelated_lists_give():
    result = ranking.overlap(table(np.zeros(12)), table(np.arange(12.0)))
    assert np.allclose(result["overlap_stability_percent"], result["expected_percent"])
    assert result["area_stability"].iloc[0] == pytest.approx(13 / 24)  # mean of n / 12


def test_random_rankings_stay_in_the_band_as_often_as_it_says():
    rng = np.random.default_rng(3)
    _, lower, upper = ranking.uncorrelated_overlap(40, 10)
    inside = []
    for _ in range(2000):
        shared = ranking.expected_overlap(rng.normal(size=40), rng.normal(size=40), 10)
        inside.append(lower <= shared <= upper)
    assert np.mean(inside) >= 0.95  # at n = 10 of 40 the discrete band holds 98 %


def test_features_of_one_table_only_are_left_out():
    simulated = table(np.arange(86.0))
    result = ranking.overlap(simulated, measured.load_scores())
    assert (result["n_features"] == 85).all() and len(result) == 85
    assert result["overlap_stability_percent"].iloc[-1] == pytest.approx(100)
    with pytest.raises(InputError, match="share 0 features"):
        ranking.overlap(simulated, table(np.arange(3.0), features=["a", "b", "c"]))


def test_top_lists_are_ordered_and_mark_ties():
    stability = np.zeros(86)
    stability[[40, 3]] = 70, 90
    stability[[10, 60]] = 50
    top = ranking.top(table(stability, np.arange(86)), measured.load_published_top())
    assert list(top["rank"]) == list(range(1, 11))
    assert list(top["stability_simulated"][:4]) == [FEATURES[i] for i in (3, 40, 10, 60)]
    assert list(top["stability_simulated_percent"][:5]) == [90, 70, 50, 50, 0]
    assert list(top["stability_simulated_tied"][:5]) == [1, 1, 2, 2, 82]
    assert top["discrimination_simulated"][0] == FEATURES[85]


def test_published_lists_are_the_papers():
    published = measured.load_published_top()
    assert published.groupby(["kind", "source"]).size().tolist() == [10] * 4
    assert set(published["feature"]) <= set(FEATURES)
    top = ranking.top(table(np.arange(86)), published)
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
def test_a_broken_table_of_scores_is_refused(spoil, message):
    good = table(np.arange(86.0))
    with pytest.raises(InputError, match=f"scores of the simulation: .*{message}"):
        ranking.top(spoil(good), measured.load_published_top())
    with pytest.raises(InputError, match=f"scores of the simulation: .*{message}"):
        ranking.overlap(spoil(good), good)
    with pytest.raises(InputError, match=f"measured scores: .*{message}"):
        ranking.overlap(good, spoil(good))
