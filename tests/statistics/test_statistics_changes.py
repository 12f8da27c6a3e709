"""Agreement between settings: published examples, other estimators of the library, and known variances."""

from itertools import combinations

import numpy as np
import pytest

from virtual_phantom.statistics import agreement_measures
from virtual_phantom.statistics.changes import Change, agreement, exchanged_icc

# Shrout and Fleiss (Psychol. Bull. 86, 420, 1979), Table 2: six targets (rows), four judges.
SHROUT_FLEISS = np.array(
    [[9, 2, 5, 8], [6, 1, 3, 2], [8, 4, 6, 8], [7, 1, 2, 6], [10, 5, 6, 9], [6, 2, 4, 7]], dtype=float
)
CLASSES = ("a", "a", "b", "b", "c", "c")


def all_pairs(x, relation="paired"):
    """Changes between all settings of x[feature, region, setting, repeat]."""
    return [
        Change("test", str(a), str(b), x[:, :, a], x[:, :, b], relation) for a, b in combinations(range(x.shape[2]), 2)
    ]


def repeats_of(x):
    """The change of random repeats, for x[feature, region, repeat]."""
    return [Change("repeats", "", "", x, x, "repeats")]


def drawn(seed, features, regions, settings, repeats, between, error, noise):
    """Values with known variances between regions, of their change between settings, and of repeats."""
    rng = np.random.default_rng(seed)
    return (
        np.sqrt(between) * rng.normal(size=(features, regions, 1, 1))
        + np.sqrt(error) * rng.normal(size=(features, regions, settings, 1))
        + np.sqrt(noise) * rng.normal(size=(features, regions, settings, repeats))
    )


def test_iccs_equal_published_values():
    """Shrout and Fleiss, Table 4: ICC(1,1) = 0.17, ICC(2,1) = 0.29."""
    between = agreement(all_pairs(SHROUT_FLEISS[None, ..., None]), CLASSES).measures["icc"].value
    assert between == pytest.approx([0.29], abs=0.005)
    assert agreement(repeats_of(SHROUT_FLEISS[None]), CLASSES).measures["icc"].value == pytest.approx([0.17], abs=0.005)


def test_pairs_of_several_settings_give_the_measures_of_all_settings():
    x = drawn(1, 5, 6, 4, 3, 2.0, 1.0, 0.5) + np.array([0, 1, -2, 3])[:, None]
    found = agreement(all_pairs(x), CLASSES).measures
    assert found["icc"].value == pytest.approx(agreement_measures.icc_agreement(x).value)
    assert found["ccc"].value == pytest.approx(agreement_measures.concordance(x))


def test_large_offset_does_not_change_the_measures():
    x = drawn(2, 3, 6, 2, 3, 2.0, 1.0, 0.5)
    found, moved = (agreement(all_pairs(y), CLASSES).measures for y in (x, x + 1e7))
    for measure in ("icc", "ccc", "w"):
        assert moved[measure].value == pytest.approx(found[measure].value, rel=1e-5)


@pytest.mark.parametrize("relation", ["paired", "independent"])
def test_measures_recover_known_variances(relation):
    x = drawn(3, 40, 300, 2, 4, 4.0, 1.0, 0.5)
    classes = [str(region % 3) for region in range(300)]
    shift = np.array([0.0, 1.0])[:, None]  # variance 0.5 between two settings
    found = agreement(all_pairs(x + shift, relation), classes)
    assert found.measures["icc"].value.mean() == pytest.approx(4 / (4 + 1.5 + 0.5), abs=0.01)
    assert found.deviations.mean() == pytest.approx(0.5, abs=0.02)
    # The repeatability coefficient is 2.77 SD of a single measurement; here relative to the SD of the class means.
    level = x.mean(axis=(2, 3))
    spread = np.stack([level[:, place::3].mean(axis=1) for place in range(3)]).std(axis=0, ddof=1)
    assert (found.measures["repeatability"].value * spread).mean() == pytest.approx(2.77 * np.sqrt(2.0), rel=0.01)


def test_repeats_recover_known_variances():
    x = drawn(4, 40, 300, 1, 5, 4.0, 0.0, 1.0)[:, :, 0]
    assert agreement(repeats_of(x), ["a"] * 300).measures["icc"].value.mean() == pytest.approx(0.8, abs=0.01)


@pytest.mark.parametrize("icc", [0.5, 0.75, 0.95])
def test_intervals_of_six_regions_cover_the_true_value(icc):
    """The level is 95 %. Coverage of 1000 intervals has an SD of 0.7 %."""
    x = drawn(5, 1000, 6, 2, 5, icc, (1 - icc) / 2, (1 - icc) / 2)
    found = agreement(all_pairs(x), CLASSES).measures["icc"]
    assert 0.92 < ((found.low <= icc) & (icc <= found.high)).mean() < 0.97


def test_intervals_of_repeats_cover_the_true_value():
    x = drawn(6, 1000, 8, 1, 5, 0.8, 0.0, 0.2)[:, :, 0]
    found = agreement(repeats_of(x), ["a"] * 8).measures["icc"]
    assert 0.92 < ((found.low <= 0.8) & (0.8 <= found.high)).mean() < 0.97


def test_differences_of_a_class_are_compared_with_the_spread_of_all():
    x = drawn(7, 200, 6, 2, 1, 9.0, 0.0, 0.1)
    x[:, 4:] += np.random.default_rng(8).normal(size=(200, 2, 2, 1)) * 3
    found = agreement(all_pairs(x), CLASSES)
    for measure in ("icc", "ccc"):
        by_class = {name: np.median(values) for name, values in found.by_class[measure].items()}
        assert by_class["a"] > 0.95 and by_class["b"] > 0.95 and by_class["c"] < 0.75
    mean = np.mean([1 / found.by_class["icc"][name] - 1 for name in "abc"], axis=0)
    assert 1 / (1 + mean) == pytest.approx(found.measures["icc"].value)
    mean = np.mean([found.by_class["ccc"][name] for name in "abc"], axis=0)
    assert mean == pytest.approx(found.measures["ccc"].value)


def test_exchanged_regions_rarely_agree():
    x = drawn(9, 50, 6, 2, 3, 1.0, 0.01, 0.01)
    found = agreement(all_pairs(x), CLASSES)
    assert (found.measures["icc"].value > 0.75).all()
    exchanged = exchanged_icc(all_pairs(x))
    assert exchanged.shape == (50, 719) and exchanged.mean() == pytest.approx(0, abs=0.05)


@pytest.mark.filterwarnings("error")
def test_few_regions_and_constant_values():
    x = drawn(10, 2, 6, 2, 3, 1.0, 0.1, 0.1)
    alone = agreement(all_pairs(x[:, :1]), CLASSES[:1]).measures
    assert np.isnan(alone["icc"].value).all() and np.isfinite(alone["w"].value).all()
    two = agreement(all_pairs(x[:, [0, 2]]), ("a", "b")).measures["icc"]
    assert np.isfinite(two.value).all() and np.isnan(two.low).all()
    equal = agreement(all_pairs(np.repeat(x[:, :, :1], 2, axis=2)), CLASSES).measures
    constant = agreement(all_pairs(np.full_like(x, 7.0)), CLASSES).measures
    assert np.isnan(constant["icc"].value).all() and equal["w"].value.tolist() == [1, 1]


def test_interval_of_w_counts_each_region_once():
    """scipy.stats.binomtest(6, 6) and (0, 6), method exact: 0.541 to 1 and 0 to 0.459."""
    same = np.tile(np.arange(5.0), (1, 6, 1))
    found = agreement([Change("test", "a", "b", same, same + 0.1)], CLASSES).measures["w"]
    assert (found.value, found.low, found.high) == (1, pytest.approx(0.541, abs=5e-4), 1)
    found = agreement([Change("test", "a", "b", same, same + 9)], CLASSES).measures["w"]
    assert (found.value, found.low, found.high) == (0, 0, pytest.approx(0.459, abs=5e-4))


def test_w_needs_two_repeats():
    x = drawn(11, 3, 6, 2, 4, 1.0, 0.1, 0.1)
    single = Change("test", "a", "b", x[:, :, 0, :1], x[:, :, 1, :1])
    assert np.isnan(agreement([single], CLASSES).measures["w"].value).all()
    both = agreement([single, *all_pairs(x)], CLASSES).measures["w"].value
    assert both == pytest.approx(agreement(all_pairs(x), CLASSES).measures["w"].value)


@pytest.mark.filterwarnings("error")
def test_mean_change_in_sd_needs_a_variance_between_regions():
    x = drawn(12, 200, 6, 2, 3, 0.0, 1.0, 0.1)
    found = agreement(all_pairs(x), CLASSES)
    assert np.array_equal(np.isnan(found.deviations), found.measures["icc"].value <= 0)
    alone = agreement(all_pairs(x[:, :1]), CLASSES[:1])
    assert np.isnan(alone.deviations).all() and np.isnan(alone.measures["ccc"].value).all()
    constant = agreement(all_pairs(np.full_like(x, 7.0)), CLASSES)
    assert np.isnan(constant.by_class["ccc"]["a"]).all()
