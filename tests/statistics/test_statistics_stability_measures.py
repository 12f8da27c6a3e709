import numpy as np
import pandas as pd
import pytest

from virtual_phantom.base.errors import InputError
from virtual_phantom.statistics import stability_measures

MEAN, SKEWNESS, ENTROPY = (f"original_firstorder_{name}" for name in ("Mean", "Skewness", "Entropy"))
FEATURES = (MEAN, SKEWNESS, ENTROPY)
CUT_OFFS = {"w_stability_percent": 50, "icc": 0.75, "ccc": 0.9, "cv": 0.1, "qcd": 0.067}
SCORES = pd.DataFrame({"feature": FEATURES[::-1], "stability_percent": [10.0, 50.0, 90.0]})


def table():
    """Mean depends on the ROI, Skewness on the group with changing sign, Entropy on neither."""
    rows = []
    for group in (1, 2, 3):
        for place, roi in enumerate(("cyst", "liver", "aorta")):
            for seed in range(2):
                wobble = (group + place + seed) % 3 - 1
                rows.append(
                    {
                        "group": group,
                        "roi": roi,
                        "seed": seed,
                        MEAN: 100.0 * (place + 1) + wobble,
                        SKEWNESS: group - 2 + 0.1 * wobble,
                        ENTROPY: 5 + 0.01 * wobble,
                    }
                )
    return pd.DataFrame(rows)


def test_w_has_the_interval_of_its_table():
    scores = SCORES.assign(ci95_low=[1.0, 2.0, 3.0], ci95_high=[11.0, 52.0, 93.0])
    measured = stability_measures.measure_table(table(), scores, FEATURES, CUT_OFFS)
    w = measured[measured["measure"] == "w_stability_percent"]
    assert w[["value", "ci95_low", "ci95_high"]].to_numpy().tolist() == [[90, 3, 93], [50, 2, 52], [10, 1, 11]]
    without = stability_measures.measure_table(table(), SCORES, FEATURES, CUT_OFFS)
    assert without[without["measure"] == "w_stability_percent"]["ci95_low"].isna().all()


def test_each_measure_has_its_cutoff():
    measured = stability_measures.measure_table(table(), SCORES, FEATURES, CUT_OFFS)
    assert list(measured.columns) == "feature family measure value ci95_low ci95_high cut_off stable".split()
    verdicts = measured.pivot(index="measure", columns="feature", values="stable").loc[
        list(stability_measures.CUT_OFFS)
    ]
    assert verdicts[MEAN].tolist() == ["yes"] * 6
    assert verdicts[SKEWNESS].tolist() == ["yes", "no", "no", "no", "undefined", "undefined"]
    # Very small spread, and no spread between ROIs: stable in size, and useless by its reliability.
    assert verdicts[ENTROPY].tolist() == ["no", "no", "no", "no", "yes", "yes"]
    with_interval = measured["ci95_low"].notna()
    assert set(measured.loc[with_interval, "measure"]) == {"icc_2_1", "icc_3_1"}
    inside = measured[with_interval]
    assert ((inside["ci95_low"] <= inside["value"]) & (inside["value"] <= inside["ci95_high"])).all()


def test_one_row_per_feature_lists_the_measures():
    features = stability_measures.stable_by_feature(
        stability_measures.measure_table(table(), SCORES, FEATURES, CUT_OFFS | {"w_stability_percent": 60})
    )
    assert features["feature"].tolist() == list(FEATURES)
    assert features["stable_by"].tolist() == [6, 0, 2]
    assert features["stable_qcd"].tolist() == ["yes", "undefined", "yes"]
    assert features["stable_w_stability_percent"].tolist() == ["yes", "no", "no"]


def test_order_of_rows_only_changes_the_order_of_rois():
    start = stability_measures.measure_table(table(), SCORES, FEATURES, CUT_OFFS)
    shuffled = stability_measures.measure_table(table().sample(frac=1, random_state=3), SCORES, FEATURES, CUT_OFFS)
    pd.testing.assert_frame_equal(start, shuffled)


def test_cube_has_each_value_at_its_position():
    rows = table().sample(frac=1, random_state=0)
    cube = stability_measures.feature_array(rows, FEATURES)
    assert cube.shape == (3, 3, 3, 2)
    rois = list(rows["roi"].unique())
    for row in rows.itertuples(index=False):
        value = cube[:, rois.index(row.roi), row.group - 1, row.seed]
        np.testing.assert_array_equal(value, row[-3:])


@pytest.mark.parametrize(
    "change, message",
    [
        (
            lambda t: t.drop(index=7),
            "features: no row for ROI cyst, group 2, seed 1; every group needs all ROIs and seeds",
        ),
        (
            lambda t: pd.concat([t, t.iloc[[7]]]),
            "features: two rows for ROI cyst, group 2, seed 1; give each",
        ),
    ],
)
def test_bad_input_is_one_clear_line(change, message):
    with pytest.raises(InputError) as caught:
        stability_measures.measure_table(change(table()), SCORES, FEATURES, CUT_OFFS)
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_one_region_has_a_spread_and_no_correlation():
    one = table()[lambda t: t["roi"] == "liver"]
    found = stability_measures.measure_table(one, SCORES, FEATURES, CUT_OFFS).set_index(["feature", "measure"])
    assert set(found.loc[(slice(None), ["icc_2_1", "icc_3_1", "ccc"]), "stable"]) == {"undefined"}
    values = one[MEAN]
    assert found.loc[(MEAN, "cv"), "value"] == pytest.approx(values.std() / values.mean())
    assert found.loc[(MEAN, "w_stability_percent"), "value"] == 90


def test_one_group_compares_its_repeats():
    """The same values with the repeats as groups give the same ICC and CCC."""
    one = table()[lambda t: t["group"] == 2]
    found = stability_measures.measure_table(one, None, FEATURES, CUT_OFFS)
    turned = one.rename(columns={"group": "seed", "seed": "group"})
    wanted = stability_measures.measure_table(turned, SCORES, FEATURES, CUT_OFFS)
    for measure in ("icc_2_1", "icc_3_1", "ccc", "cv"):
        values = [rows.loc[rows["measure"] == measure, "value"].to_numpy() for rows in (found, wanted)]
        np.testing.assert_allclose(*values)
    assert found.loc[found["measure"] == "w_stability_percent", "stable"].eq("undefined").all()
