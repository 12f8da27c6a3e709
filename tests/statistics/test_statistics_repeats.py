import numpy as np
import pandas as pd
import pytest

from virtual_phantom.statistics import repeats, wilcoxon

FEATURE = "original_firstorder_Mean"


def table(units=12, groups=(1, 2, 3), seed=0):
    """Groups that share their acquisitions: value = random value of the acquisition, plus a small one of the group."""
    rng = np.random.default_rng(seed)
    draw = rng.normal(size=units)
    return pd.DataFrame(
        [
            {"group": group, "roi": roi, "tissue_class": roi, "unit": unit, FEATURE: draw[unit] + 0.1 * group}
            for group in groups
            for roi in ("a", "b")
            for unit in range(units)
        ]
    )


def test_each_group_has_as_many_repeats_drawn_without_replacement():
    rows = table()
    found = list(repeats.subsamples(rows, 5, "unit", shared=False))
    assert len(found) == repeats.DRAWS and {of for _, of in found} == {12}
    for chosen, _ in found:
        assert (chosen.groupby(["group", "roi"])["unit"].nunique() == 5).all() and len(chosen) == 5 * 6
    similar = [chosen.groupby("group")["unit"].agg(frozenset).nunique() == 1 for chosen, _ in found]
    assert not all(similar)
    # Every unit is drawn: 30 draws of 5 of 12 miss one with probability (7 / 12)^30
    assert set().union(*(chosen["unit"] for chosen, _ in found)) == set(range(12))


def test_shared_acquisitions_are_equal_in_all_groups():
    rows = table()
    rows = rows[(rows["group"] != 2) | (rows["unit"] > 0)]  # missing in group 2
    for chosen, of in repeats.subsamples(rows, 5, "unit", shared=True):
        assert of == 11 and chosen.groupby("group")["unit"].agg(frozenset).nunique() == 1
        assert 0 not in set(chosen["unit"])


def test_stream_is_fixed_and_a_full_sample_is_taken_once():
    one, other = (repeats.score_draws(table(), [FEATURE], 5, unit="unit") for _ in range(2))
    assert one.equals(other) and one["stability_percent"].nunique() > 1
    every = repeats.score_draws(table(), [FEATURE], 12, unit="unit")
    more = repeats.score_draws(table(), [FEATURE], 100, unit="unit")
    assert every.equals(more) and len(every) == 1 and every["repeats"][0] == every["of"][0] == 12
    whole = wilcoxon.scores(table(), [FEATURE])
    assert every[list(whole.columns)].equals(whole)
    assert np.isnan(repeats.mean_over_features(every, "stability")[1])


def test_spread_of_subsamples_is_scaled_to_that_of_new_samples():
    """Means of 10 of 29 values have the finite population's SD, sigma sqrt((1 - 10 / 29) / 10)."""
    rng = np.random.default_rng(1)
    values = rng.normal(size=29)
    means = np.array([rng.choice(values, 10, replace=False).mean() for _ in range(20000)])
    assert repeats.sd_of_draws(means, 10 / 29) == pytest.approx(values.std(ddof=1) / np.sqrt(10), rel=0.02)
    assert np.isnan(repeats.sd_of_draws(means[:1], 10 / 29))
