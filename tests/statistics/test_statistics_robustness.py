"""Robustness of features: verdicts, reasons and controls on a simulated study with known changes."""

import numpy as np
import pandas as pd
import pytest
from robust_study import (
    CUT_OFFS,
    DOSE,
    FEATURES,
    NOISE,
    ROBUST,
    SHAPE,
    SIZED,
    extracted_table,
    extraction_pairs,
    feature_table,
    robustness_table,
    setting_pairs,
)

from virtual_phantom.base.errors import InputError
from virtual_phantom.statistics import ANY_PROTOCOL, EXTRACTION, REPEATS, REPOSITIONING, robustness


@pytest.fixture(scope="module")
def found():
    return robustness_table()


def use(found, feature):
    return found.loc[found["feature"] == feature, ["use", "reason"]].drop_duplicates().iloc[0].tolist()


def test_a_row_per_feature_and_change(found):
    assert len(found) == len(FEATURES) * 4 and not found.duplicated(["feature", "change"]).any()
    assert set(found["change"]) == {REPEATS, REPOSITIONING, "dose", ANY_PROTOCOL}
    assert (found["rois"] == 6).all()


def test_features_are_put_to_use_by_their_changes(found):
    assert use(found, ROBUST)[0] == "robust"
    assert use(found, ROBUST)[1].startswith("Above the cut-off for every change.")
    kind, reason = use(found, DOSE)
    assert kind == "one protocol" and reason.startswith("Not robust for dose.")
    assert "rises by 8.0 % from 10 mGy to 3 mGy" in reason
    kind, reason = use(found, NOISE)
    assert kind == "avoid" and "Not robust for random repeats" in reason


def test_shape_features_are_never_robust(found):
    assert use(found, SHAPE) == ["does not vary", "Depends on the mask only, which is the same in all images."]
    rows = found[found["feature"] == SHAPE]
    assert set(rows["robust"]) == set(rows["stable"]) == {"does not vary"}
    assert (
        rows[["icc", "icc_low", "ccc", "repeatability", "stability_percent", "exchanged_percent"]].isna().all(axis=None)
    )


def test_features_that_grow_with_the_region_are_marked(found):
    rows = found[found["feature"] == SIZED]
    assert (rows["robust"] == "yes").all()  # the regions differ in size, so the ICC is high
    kind, reason = use(found, SIZED)
    assert kind == "region size" and reason.startswith("Grows with the size of the region")


def test_control_with_exchanged_regions_is_low(found):
    rows = found[(found["feature"] == ROBUST) & (found["change"] == "dose")]
    assert rows["icc"].item() > 0.99 and rows["exchanged_percent"].item() < 10


def test_rows_of_protocols_keep_the_columns_of_w(found):
    between = robustness.between_protocols(found)
    assert list(between["feature"]) == list(FEATURES)
    row = between.set_index("feature").loc[ROBUST]
    assert row["comparisons"] == 6 and row["groups"] == 2 and 0 <= row["ci95_low"] <= row["stability_percent"]
    assert "By W:" in row["sentence"] and np.isfinite(row["twice_repeats_percent"])
    assert found.loc[found["change"] == "dose", "comparisons"].isna().all()


def test_study_without_repeats_or_protocols_is_undecided_at_best():
    pairs = [pair for pair in setting_pairs() if pair["kind"] == "dose"]
    for pair in pairs:
        for end in ("first", "second"):
            pair[end]["seeds"] = [0]
    found = robustness.robustness_table(feature_table(), FEATURES, pairs, CUT_OFFS)
    assert use(found, ROBUST)[0] == "robust" and use(found, DOSE)[0] == "avoid"


def test_one_region_gives_no_verdict():
    table = feature_table()
    alone = table[table["roi"] == "cyst_1"]
    found = robustness.robustness_table(alone, FEATURES, setting_pairs(), CUT_OFFS)
    assert set(found.loc[found["feature"] == ROBUST, "robust"]) == {"undecided"}
    assert "ICC not defined" in found["sentence"].iloc[0]


def test_missing_images_are_named():
    table = feature_table()
    without = table[~((table["noise"] == "low") & (table["seed"] == 2))]
    with pytest.raises(InputError, match="features: no row of ROI cyst_1, seed 2 for protocol thin, noise low"):
        robustness.robustness_table(without, FEATURES, setting_pairs(), CUT_OFFS)
    with pytest.raises(InputError, match="two rows for protocol thin, noise high"):
        robustness.robustness_table(pd.concat([table, table]), FEATURES, setting_pairs(), CUT_OFFS)


def test_extraction_settings_are_rows_that_do_not_count(found):
    changed = robustness.with_extraction(found, extracted_table(), extraction_pairs(), CUT_OFFS)
    pd.testing.assert_frame_equal(robustness.acquisition_changes(changed), found)
    rows = changed[changed["change"] == EXTRACTION].set_index("feature")
    assert set(rows.index) == set(FEATURES) - {SHAPE}
    assert rows.loc[ROBUST, "robust"] == "yes" and rows.loc[ROBUST, "icc"] == 1
    assert (
        rows.loc[NOISE, "robust"] == "no" and "rises by 100 % from study to bin_width_10" in rows.loc[NOISE, "sentence"]
    )
    assert (rows["use"] == [use(found, feature)[0] for feature in rows.index]).all()
    assert list(changed["feature"].unique()) == list(FEATURES)


def test_single_images_beside_repeats_do_not_make_a_constant_feature_vary():
    pairs = setting_pairs()
    for pair in pairs:
        if pair["kind"] == REPOSITIONING:
            pair["second"]["seeds"] = [4]
    table = feature_table().assign(**{NOISE: 3.0})
    found = robustness.robustness_table(table, FEATURES, pairs, CUT_OFFS)
    assert use(found, NOISE) == ["does not vary", "Has the same value in all repeats."]
    assert use(found, ROBUST)[0] == "robust"


@pytest.mark.parametrize(
    ("percent", "sd", "text"),
    [
        (8.04, 1.0, "rises by 8.0 % from 10 mGy to 3 mGy"),
        (-12.4, -1.0, "falls by 12 % from 10 mGy to 3 mGy"),
        (-0.02, -0.3, "changes by less than 0.1 % from 10 mGy to 3 mGy"),
        (np.nan, -0.3, "falls by 0.3 SD between regions from 10 mGy to 3 mGy"),
        (np.nan, 0.01, "changes by less than 0.1 SD between regions from 10 mGy to 3 mGy"),
        (np.nan, np.nan, ""),
    ],
)
def test_mean_changes_in_words(percent, sd, text):
    row = {"change": "dose", "change_percent": percent, "change_sd": sd}
    assert robustness.changed(row | {"change_from": "10 mGy", "change_to": "3 mGy"}) == text


def test_any_name_of_a_tissue_class_keeps_the_intervals(found):
    table = feature_table()
    named = table.assign(tissue_class=table["tissue_class"].map({"cyst": "low", "liver": "high", "met": "percent"}))
    renamed = robustness.robustness_table(named, FEATURES, setting_pairs(), CUT_OFFS)
    same = ["icc", "icc_low", "icc_high", "stability_percent"]
    rows = found["change"] != ANY_PROTOCOL  # their columns of W are those of trust_table
    assert renamed.loc[rows, same].equals(found.loc[rows, same])
    assert renamed["icc_of_low"].equals(found["icc_of_cyst"])
