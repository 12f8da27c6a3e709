"""Comparison of extraction settings: published ICC, and the choice of a setting for each feature."""

import numpy as np
import pandas as pd
import pytest

from virtual_phantom.base.errors import InputError
from virtual_phantom.statistics import extraction_settings
from virtual_phantom.statistics.changes import fisher, jackknife_interval
from virtual_phantom.statistics.extraction_settings import choice_table, long_table, settings_table, wide_table

FEATURE, OTHER = "original_firstorder_Mean", "original_glcm_Idn"
# Shrout and Fleiss (Psychol. Bull. 86, 420, 1979), Table 2: six targets (rows), four judges; ICC(2,1) is 0.29.
JUDGED = np.array([[9, 2, 5, 8], [6, 1, 3, 2], [8, 4, 6, 8], [7, 1, 2, 6], [10, 5, 6, 9], [6, 2, 4, 7]], float)


def table(values, other=None, repeats=1):
    """Features of ROIs (rows) in conditions (columns); repeats differ by a rounding error of the published values."""
    rows = [
        {
            "protocol": f"p{condition}",
            "noise": "low",
            "group": condition,
            "seed": seed,
            "roi": f"roi_{roi}",
            "tissue_class": "ab"[roi % 2],
            FEATURE: values[roi, condition] + 1e-9 * seed,
            OTHER: (values if other is None else other)[roi, condition] + 1e-9 * seed,
        }
        for roi in range(values.shape[0])
        for condition in range(values.shape[1])
        for seed in range(repeats)
    ]
    return pd.DataFrame(rows)


@pytest.fixture(scope="module")
def compared():
    means = np.repeat(JUDGED.mean(axis=1, keepdims=True), 4, axis=1)
    return settings_table({"study": table(JUDGED), "bin_width_10": table(means, JUDGED)})


def test_robustness_is_the_published_icc(compared):
    rows = compared[compared["feature"] == FEATURE].set_index("setting")
    assert rows.loc["study", "robustness"] == pytest.approx(0.29, abs=0.005)
    assert rows.loc["bin_width_10", "robustness"] == 1 and set(rows["robust_by"]) == {"ICC(2,1)"}
    assert rows.loc["bin_width_10", "change"] == pytest.approx(0.71, abs=0.005)
    low, z, high = rows.loc["bin_width_10", ["change_z_low", "change_z", "change_z_high"]]
    assert 0 < low < z < high  # settings differ without any of the ROIs
    assert z == pytest.approx(np.arctanh(1 - 1e-12) - np.arctanh(rows.loc["study", "robustness"]))
    assert list(rows["rois"]) == [6, 6] and list(rows["conditions"]) == [4, 4]


def test_the_studys_setting_is_kept_if_nothing_is_gained(compared):
    choice = choice_table(compared).set_index("feature")
    assert choice.loc[FEATURE, "setting"] == "bin_width_10" and choice.loc[FEATURE, "more_robust"] == "yes"
    assert choice.loc[OTHER, "setting"] == "study" and choice.loc[OTHER, "more_robust"] == "no"
    assert compared[compared["feature"] == OTHER].set_index("setting")["has_effect"].to_dict() == {
        "study": "no",
        "bin_width_10": "no",
    }
    assert (compared["most_robust"] == "yes").sum() == 2


def test_cost_is_the_change_of_discrimination():
    """Regions of both classes overlap with the study's setting and do not with the other: 9 of 9 pairs differ."""
    apart = JUDGED + 100 * (np.arange(6) % 2)[:, None]
    rows = settings_table({"study": table(JUDGED, repeats=4), "bin_count_8": table(apart, repeats=4)})
    rows = rows[rows["feature"] == FEATURE].set_index("setting")
    assert rows.loc["bin_count_8", "discrimination_percent"] == 100
    change = 100 - rows.loc["study", "discrimination_percent"]
    assert rows.loc["bin_count_8", "discrimination_change"] == pytest.approx(change) and change > 0


def test_one_condition_is_judged_by_its_repeats():
    repeated = table(JUDGED).rename(columns={"seed": "group", "group": "seed"}).assign(group=1)
    rows = settings_table({"study": repeated})
    assert set(rows["robust_by"]) == {"ICC(2,1) between repeats"}
    assert rows["robustness"].to_numpy() == pytest.approx([0.29, 0.29], abs=0.005)


def test_one_region_is_judged_by_ranks():
    one = table(JUDGED[:1], repeats=3)
    rows = settings_table({"study": one, "bin_width_10": table(np.ones((1, 4)), repeats=3)})
    assert set(rows["robust_by"]) == {"W stability"} and rows["discrimination_percent"].isna().all()
    assert rows.set_index(["feature", "setting"]).loc[(FEATURE, "bin_width_10"), "robustness"] == 100
    assert rows["change_z_low"].isna().all() and set(choice_table(rows)["more_robust"]) == {"undecided"}


def test_one_region_in_one_condition_is_refused():
    with pytest.raises(InputError, match="one ROI in one condition has no robustness; add a protocol or an ROI"):
        settings_table({"study": table(JUDGED[:1, :1], repeats=3)})


def test_feature_that_a_setting_leaves_undefined_has_no_results_with_it():
    changed = table(JUDGED, JUDGED)
    changed.loc[3, FEATURE] = np.nan  # such as an ROI of two voxels after resampling
    tables = {"study": table(JUDGED), "resampled_mm_8": changed}
    rows = settings_table(tables)
    undefined = rows[(rows["feature"] == FEATURE) & (rows["setting"] == "resampled_mm_8")].iloc[0]
    assert undefined[list(extraction_settings.RESULTS)].isna().all() and undefined["most_robust"] == "no"
    others = rows.drop(undefined.name)
    assert others["robustness"].to_numpy() == pytest.approx(0.29, abs=0.005)
    assert choice_table(rows).set_index("feature").loc[FEATURE, "setting"] == "study"
    factors = {"resampled_mm_8": {"factor": "resampled_mm", "value": 8}}
    assert OTHER in wide_table(long_table(tables, factors)) and FEATURE not in wide_table(long_table(tables, factors))


def test_other_images_are_refused():
    with pytest.raises(InputError, match="setting bin_width_10: has other ROIs or images than the study's features"):
        settings_table({"study": table(JUDGED), "bin_width_10": table(JUDGED[:5])})


@pytest.mark.parametrize("rois", [6, 24])
def test_intervals_cover_the_true_change(rois):
    """ROIs and conditions from normal distributions: of 1000 features, about 950 intervals hold the change."""
    rng = np.random.default_rng(7)
    regions, noise = rng.normal(0, 1, (1000, rois, 1, 1)), rng.normal(0, 1, (2, 1000, rois, 4, 1))
    settings = regions + noise[0], regions + 0.5 * noise[1]  # ICC 1 / 2 and 1 / 1.25
    before, after = (fisher(extraction_settings._without_each(setting)) for setting in settings)
    found = jackknife_interval(after - before)
    true = np.arctanh(1 / 1.25) - np.arctanh(1 / 2)
    held = (found.low <= true) & (true <= found.high)
    assert 0.93 < held.mean() < 0.97
    assert (found.high < 0).mean() < 0.01


def test_long_table_has_every_value_once():
    tables = {"study": table(JUDGED), "bin_width_10": table(JUDGED + 1)}
    rows = long_table(tables, {"bin_width_10": {"factor": "bin_width", "value": 10}})
    assert len(rows) == 2 * 24 * 2 and not rows.duplicated(["setting", "protocol", "seed", "roi", "feature"]).any()
    chosen = rows[(rows["setting"] == "bin_width_10") & (rows["roi"] == "roi_2") & (rows["protocol"] == "p3")]
    assert set(chosen["value"]) == {9.0} and set(chosen["setting_value"]) == {"10"}


def test_wide_table_restores_the_features_of_all_settings():
    tables = {"study": table(JUDGED), "bin_width_10": table(JUDGED + 1).drop(columns=OTHER)}
    wide = wide_table(long_table(tables, {"bin_width_10": {"factor": "bin_width", "value": 10}}))
    assert list(wide) == ["setting", "protocol", "noise", "seed", "roi", "tissue_class", FEATURE]
    for name, one in tables.items():
        keys = ["protocol", "roi"]
        rows = wide[wide["setting"] == name].set_index(keys)[FEATURE]
        assert len(rows) == 24 and rows.to_dict() == one.set_index(keys)[FEATURE].to_dict()
