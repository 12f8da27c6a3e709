"""Comparison of measures of trust (benchmarks/trust_measures.py), on tables of known answers."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmarks import trust_measures as trust
from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.base.streams import generator, root
from virtual_phantom.io.volumes import Volume

FEATURES, REGIONS, REPEATS = 40, 6, 8
KINDS = {"dose, FBP": [("fbp 1", "fbp 3", "fbp 10")], trust.REPEATS: [("fbp 1",), ("fbp 3",), ("fbp 10",)]}
SETTINGS = ("fbp 1", "fbp 10", "fbp 3")


def scans(seed, spread=None, shift=0.0, settings=SETTINGS):
    """Regions at 10, 20, ..., 60 with an SD of `spread` by feature; `shift` is added per setting."""
    spread = np.geomspace(0.1, 100, FEATURES) if spread is None else spread
    x = generator(seed).normal(size=(FEATURES, REGIONS, len(settings), REPEATS)) * spread[:, None, None, None]
    x += 10 * np.arange(1, REGIONS + 1)[:, None, None] + 1000
    return trust.Scans(x + shift * np.arange(len(settings))[:, None], settings)


def test_icc_of_random_repeats_is_that_of_shrout_and_fleiss():
    """Example of Shrout and Fleiss (1979), table 4: ICC(1,1) 0.17 and ICC(2,1) 0.29."""
    ratings = np.array([[9, 2, 5, 8], [6, 1, 3, 2], [8, 4, 6, 8], [7, 1, 2, 6], [10, 5, 6, 9], [6, 2, 4, 7]], float)
    found = trust.measures(ratings[None, :, None])  # four repeats of one setting
    assert found[trust.ICC_REPEATS] == pytest.approx([0.17], abs=0.005)
    assert found[trust.ICC_SETTINGS] == pytest.approx([0.29], abs=0.005)
    assert trust.W_SHARE not in found
    assert trust.measures(ratings[None, :, :, None])[trust.ICC_REPEATS] == found[trust.ICC_REPEATS]


def test_repeatability_coefficient_is_1_96_sqrt_2_of_the_sd_within_regions():
    spread = np.full(FEATURES, 5.0)
    found = trust.mean_measures(scans(1, spread), KINDS[trust.REPEATS])[trust.RC]
    assert found.mean() == pytest.approx(1.96 * np.sqrt(2) * 5 / np.std(10 * np.arange(6), ddof=1), rel=0.05)


def test_shifted_settings_lower_the_agreement_of_settings_but_not_that_of_repeats():
    still, moved = (trust.measures(scans(2, np.full(FEATURES, 1.0), shift).values) for shift in (0, 30))
    assert still[trust.ICC_SETTINGS].min() > 0.95 > 0.5 > moved[trust.ICC_SETTINGS].max()
    assert (moved[trust.W_SHARE] == 0).all() and moved[trust.W_MEAN].min() > still[trust.W_MEAN].max()
    shifted = scans(2, np.full(FEATURES, 1.0), 30)
    repeats = trust.mean_measures(shifted, KINDS[trust.REPEATS])
    assert repeats[trust.ICC_SETTINGS].min() > 0.95
    # robust without a shift; only within one protocol with it
    bounds = [trust.robust_bounds(one, KINDS["dose, FBP"], 8, root(1), 40) for one in (scans(2, np.ones(40)), shifted)]
    within = trust.robust_bounds(shifted, KINDS[trust.REPEATS], 8, root(1), 40)
    for change, expected in zip(bounds, (0, 1), strict=True):
        assert (trust.classes(change, within)[trust.ICC_SETTINGS, 0.75] == expected).all()
    noisy = trust.robust_bounds(scans(3, np.full(FEATURES, 100.0)), KINDS["dose, FBP"], 8, root(1), 40)
    assert (trust.classes(noisy, noisy)[trust.ICC_SETTINGS, 0.75] == 2).all()


def test_regions_are_identified_by_the_nearest_mean_of_the_other_setting():
    kinds = [KINDS["dose, FBP"], KINDS[trust.REPEATS]]
    assert all((trust.identification(scans(4, np.full(FEATURES, 0.1)), sets) == 1).all() for sets in kinds)
    for sets in kinds:
        noise = trust.identification(scans(5, np.full(FEATURES, 1e6)), sets)
        assert noise.mean() == pytest.approx(1 / REGIONS, abs=0.03)
    # Shifted by one region, each region is where its neighbor was; the outermost one has no neighbor on that side.
    shifted = scans(6, np.full(FEATURES, 0.1), 10)
    assert trust.identification(shifted, [("fbp 1", "fbp 10")]) == pytest.approx(1 / REGIONS)


def test_a_prediction_with_the_same_spread_has_the_same_order_and_classes():
    scanner, spread = scans(7), np.geomspace(0.1, 100, FEATURES)
    predictions = {
        "simulated": [scans(8), scans(9)],
        "reversed": [scans(10, spread[::-1])],
        "chance": [scans(11, np.full(FEATURES, 5.0))],
    }
    found = trust.correlations(scanner, predictions, KINDS, root(1), 20)
    for name in (trust.ICC_SETTINGS, trust.ICC_REPEATS, trust.CCC, trust.RC, trust.CV):
        for kind in KINDS:
            one = found[kind, name, "simulated"]
            assert one.value > 0.95 and len(one.draws) == 20 and np.percentile(one.draws, 2.5) > 0.8
            assert found[kind, name, "reversed"].value < -0.95
            assert abs(found[kind, name, "chance"].value) < 0.5
    assert (trust.REPEATS, trust.W_MEAN, "simulated") not in found
    agreement = trust.class_agreement(scanner, predictions, KINDS, root(2), 40).set_index(["measure", "source"])
    assert agreement.loc[(f"{trust.ICC_SETTINGS}, 0.9", "simulated"), "percent"] > 80
    assert agreement.loc[(f"{trust.ICC_SETTINGS}, 0.9", "reversed"), "kappa"] < 0.1
    useful = trust.usefulness(scanner, predictions, KINDS, root(3)).set_index(["measure", "source", "kind"])["order"]
    assert useful[trust.ICC_SETTINGS, "simulated", "dose, FBP"] > 0.9
    assert useful[trust.RC, "simulated", "dose, FBP"] > 0.9  # small is robust
    halves = trust.reliability(scanner, KINDS, root(4), 5).set_index(["measure", "halves", "kind"])["order"]
    assert halves[trust.ICC_SETTINGS, "repeats", "dose, FBP"] > 0.95


def test_interval_holds_95_percent_of_the_draws():
    one = trust.Coefficient(0.5, np.linspace(0, 1, 201))
    assert str(one) == "0.50 (0.03 to 0.97)" and str(one - one) == "0.00 (0.00 to 0.00)"
    assert str(trust.mean_coefficient([one, trust.Coefficient(0.1, np.zeros(201))])) == "0.30 (0.01 to 0.49)"


def test_at_least_three_regions_or_repeats_of_a_draw_differ():
    random = generator(21)
    assert min(len(set(trust.draw_again(3, 5, random))) for _ in range(200)) == 3
    assert min(len(set(chosen)) for chosen in trust.region_draws(6, 200)) >= 3
    assert len(trust.draw_again(1, 4, random)) == 4


def test_one_image_predicts_every_change_without_w():
    one = trust.Scans(scans(12).values[:, :, :1], ())
    found = trust.correlations(scans(13), {"perturbation": [one]}, KINDS, root(5), 5)
    assert found["dose, FBP", trust.ICC_REPEATS, "perturbation"].value > 0.9
    assert ("dose, FBP", trust.W_SHARE, "perturbation") not in found


def test_prediction_that_lacks_a_setting_is_skipped():
    few = scans(14, settings=("fbp 10",))
    found = trust.correlations(scans(15), {"simulated": [few]}, KINDS, root(6), 5)
    assert not found


def test_subsets_of_repeats_give_the_same_number_of_repeats_and_icc():
    scanner = scans(16, np.full(FEATURES, 5.0))
    sets = KINDS["dose, FBP"]
    subset, whole = trust.with_repeats(scanner, 4, root(7), sets), trust.mean_measures(scanner, sets)
    assert subset[trust.ICC_SETTINGS] == pytest.approx(whole[trust.ICC_SETTINGS], abs=0.02)
    assert (scanner.take(repeats=np.arange(4)).repeats) == 4


def test_table_becomes_scans_with_the_repeats_that_all_settings_have():
    rows = [
        {"setting": setting, "roi": roi, "repeat": repeat, "feature": 100 * index + 10 * number + repeat}
        for index, setting in enumerate(("a", "b"))
        for number, roi in enumerate(("x", "y", "z"))
        for repeat in range(4 if setting == "a" else 3)
    ]
    table = pd.DataFrame(rows[::-1])
    found = trust.Scans.of_table(table, "setting", "repeat", ["feature"], "t.csv")
    assert found.settings == ("a", "b") and found.values.shape == (1, 3, 2, 3)
    assert found.values[0, 1, 1].tolist() == [110, 111, 112]


def test_report_prints_every_table(capsys):
    predictions = {
        "simulated": [scans(17)],
        "white noise": [scans(18)],
        "perturbation": [trust.Scans(scans(19).values[:, :, :1], ())],
    }
    trust.report("3D", scans(20), predictions, KINDS, trust.FEATURES[:FEATURES], root(8), 5)
    text = capsys.readouterr().out
    assert "3D: 8 measured repeats of 6 regions" in text
    for line in (
        "simulated",
        "simulated scans less control",
        "halves",
        "grow with the region",
        "identification",
        "kappa",
        "classes: robust",
    ):
        assert line in text


def test_control_features_belong_to_each_region_and_realization():
    image = Volume(np.full((20, 30, 30), 40, np.float32), Grid((20, 30, 30), trust.dose_prediction.SPACING))
    mask = np.zeros(image.array.shape, bool)
    mask[8:12, 10:20, 10:20] = True
    regions = trust.whole_regions(image, {"cyst_1": mask, "cyst_2": mask})
    assert regions["cyst_1"][0].shape == (20, 26, 26) and regions["cyst_1"][1].sum() == mask.sum()
    found = trust.realizations(regions, trust.dose_noise("fbp", 10, None), root(9), 2)
    assert len(found) == 4 and sorted(found["roi"].unique()) == ["cyst_1", "cyst_2"]
    variance = trust.dose_prediction.series()["cyst_1", "fbp", 10].mean[trust.VARIANCE]
    assert found[trust.VARIANCE].mean() == pytest.approx(variance, rel=0.2)
    moved = trust.realizations(regions, trust.perturbation, root(10), 2)
    assert moved["n_voxels"].nunique() > 1 and (moved[trust.VARIANCE] == 0).all()
    assert trust.one_image(found, trust.FEATURES, "t").values.shape == (86, 2, 1, 2)


def test_results_without_the_scan_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"no such scan; give the results folder"):
        trust.scan_masks(Path(tmp_path))
