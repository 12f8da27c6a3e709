import warnings
from itertools import permutations
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.features import extraction
from virtual_phantom.features.extraction import FEATURES
from virtual_phantom.io.volumes import Volume
from virtual_phantom.statistics import comparability, comparison, comparison_summary, measured, multiplicity
from virtual_phantom.statistics.measured import TISSUE_CLASSES

MEAN = "original_firstorder_Mean"
REAL = Path(__file__).resolve().parents[2] / "../shared/real"


def table(**repeats):
    """Repeats of MEAN by ROI."""
    return pd.DataFrame(
        [
            {"roi": roi, "tissue_class": TISSUE_CLASSES[roi], MEAN: float(value)}
            for roi, values in repeats.items()
            for value in values
        ]
    )


def drawn(seed=0, n=10, features=FEATURES[:6], rois=tuple(TISSUE_CLASSES), shift=0.0, spread=1.0):
    rng = np.random.default_rng(seed)
    rows = [
        {"roi": roi, "tissue_class": TISSUE_CLASSES[roi]}
        | dict(zip(features, 10 * place + shift + spread * rng.normal(size=len(features)), strict=True))
        for _ in range(n)
        for place, roi in enumerate(rois)
    ]
    return pd.DataFrame(rows)


def only(result):
    assert len(result) == 1
    return result.iloc[0]


def test_shift_and_ratio_of_simple_values():
    """Recorded 1 2 3: mean 2, SD 1; simulated 3 5 7: mean 5, SD 2. Shift (5 - 2)/1, ratio 2."""
    row = only(comparison.compare(table(cyst_1=[3, 5, 7]), table(cyst_1=[1, 2, 3]), [MEAN]))
    assert row[["roi", "tissue_class", "family", "n_simulated", "n_recorded"]].tolist() == [
        "cyst_1",
        "cyst",
        "first order",
        3,
        3,
    ]
    assert row[["mean_simulated", "mean_recorded", "sd_simulated", "sd_recorded"]].tolist() == [5, 2, 2, 1]
    assert row[["shift_sd", "sd_ratio"]].tolist() == [3, 2]
    # F(2, 2) has the quantile p/(1 - p): 39 at 97.5 %
    assert row[["sd_ratio_lower", "sd_ratio_upper"]].tolist() == pytest.approx([2 / 39**0.5, 2 * 39**0.5])


def test_p_values_equal_scipys():
    simulated, recorded = drawn(1, shift=0.7, spread=2.0), drawn(2)
    result = comparison.compare(simulated, recorded, FEATURES[:6])
    for row in result.itertuples():
        a, b = (part.loc[part["roi"] == row.roi, row.feature] for part in (simulated, recorded))
        assert row.p_mean == pytest.approx(stats.ttest_ind(a, b, equal_var=False).pvalue)
        assert row.p_sd == pytest.approx(stats.levene(a, b, center="median").pvalue)
    assert result["q_mean"].to_numpy() == pytest.approx(stats.false_discovery_control(result["p_mean"], method="by"))
    assert list(result["roi"].unique()) == list(TISSUE_CLASSES) and len(result) == 36


def test_holm_correction_of_simple_values():
    """Sorted 0.01 0.02 0.03 0.5 times 4 3 2 1: 0.04 0.06 0.06 0.5, monotonic."""
    assert multiplicity.holm(np.array([0.03, 0.01, 0.5, 0.02])).tolist() == pytest.approx([0.06, 0.04, 0.5, 0.06])


@pytest.mark.parametrize("shift, n, m", [(0.0, 10, 10), (0.8, 10, 10), (-3.0, 10, 10), (20.0, 8, 10), (2.0, 5, 4)])
def test_interval_of_the_shift_has_its_coverage(shift, n, m):
    rng = np.random.default_rng(3)
    trials = 4000
    simulated, recorded = 5 + 3 * (shift + 1.5 * rng.normal(size=(n, trials))), 5 + 3 * rng.normal(size=(m, trials))
    test = stats.ttest_ind(simulated, recorded, equal_var=False)
    for level in (0.95, 0.9):
        bounds = test.confidence_interval(level)
        lower, upper = comparison.shift_interval(
            simulated.mean(0) - recorded.mean(0), bounds.low, bounds.high, recorded.std(0, ddof=1), m, level
        )
        covered = ((lower <= shift) & (shift <= upper)).mean()
        assert level - 0.02 < covered < level + 0.04  # conservative for few repeats
        above, below = (upper < shift).mean(), (lower > shift).mean()
        assert max(above, below) < 0.75 * (1 - level)  # errors occur on both sides


def test_known_repeat_sd_leaves_the_interval_of_the_difference():
    lower, upper = comparison.shift_interval(*map(np.array, (3.0, -1.0, 7.0, 2.0)), 10**8, 0.95)
    assert [lower, upper] == pytest.approx([-0.5, 3.5], rel=1e-3)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 1000),
    scale=st.floats(0.01, 100),
    offset=st.floats(-50, 50),
    shift=st.floats(-5, 5),
    n=st.integers(2, 6),
)
def test_units_and_sign_of_a_feature(seed, scale, offset, shift, n):
    """Another unit changes nothing; a change of sign reverses the shift and keeps the ratio."""
    simulated, recorded = drawn(seed, n, FEATURES[:2], shift=shift), drawn(seed + 1, n + 1, FEATURES[:2])
    features = list(FEATURES[:2])
    numbers = ["shift_sd", "shift_lower", "shift_upper", "sd_ratio", "sd_ratio_lower", "sd_ratio_upper", "p_mean"]
    plain = comparison.compare(simulated, recorded, features)
    assert (plain["shift_lower"] <= plain["shift_sd"]).all() and (plain["shift_sd"] <= plain["shift_upper"]).all()
    for factor in (scale, -scale):
        moved = [part.assign(**{f: factor * part[f] + offset for f in features}) for part in (simulated, recorded)]
        changed = comparison.compare(*moved, features)
        expected = plain[numbers].to_numpy(copy=True)
        if factor < 0:
            expected[:, :3] = -expected[:, [0, 2, 1]]
        assert np.allclose(changed[numbers], expected, rtol=1e-5, atol=1e-6)


def test_absence_of_significance_is_not_agreement():
    """The same small shift from few and from many repeats, and a shift that many repeats show to be small."""
    few = comparison.compare(drawn(1, 3), drawn(2, 3), FEATURES[:6])
    assert (few["q_mean"] > 0.05).mean() > 0.9 and (few["mean_agrees"] == "undecided").mean() > 0.9
    assert (few["sd_agrees"] == "undecided").mean() > 0.9
    many = comparison.compare(drawn(1, 400), drawn(2, 400), FEATURES[:6])
    assert (many["mean_agrees"] == "yes").all() and (many["sd_agrees"] == "yes").all()
    small = comparison.compare(drawn(1, 400, shift=0.5), drawn(2, 400), FEATURES[:6])
    assert (small["q_mean"] < 0.05).all() and (small["mean_agrees"] == "yes").all()
    far = comparison.compare(drawn(1, 20, shift=3, spread=6), drawn(2, 20), FEATURES[:6])
    assert (far["sd_agrees"] == "no").all() and (far["mean_agrees"] != "yes").all()
    strict = comparison.compare(drawn(1, 400, shift=0.5), drawn(2, 400), FEATURES[:6], margin_sd=0.2, sd_factor=1.02)
    assert (strict["mean_agrees"] == "no").all() and (strict["sd_agrees"] != "yes").all()


def test_constant_features():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = comparison.compare(
            table(cyst_1=[4, 4, 4], cyst_2=[4, 4, 4], normal_1=[4, 5, 6], normal_2=[5, 5, 5], metastasis=[-1, 0, 1]),
            table(cyst_1=[4, 4, 4], cyst_2=[3, 3, 3], normal_1=[4, 4, 4], normal_2=[4, 5, 7], metastasis=[0, 0, 0]),
            [MEAN],
        ).set_index("roi")
    assert result["shift_sd"].tolist()[:3] == [0, np.inf, np.inf] and result["shift_sd"]["metastasis"] == 0
    assert result["shift_sd"]["normal_2"] == pytest.approx(-(1 / 3) / np.sqrt(7 / 3))
    assert result["mean_agrees"].tolist() == ["yes", "no", "undecided", "undecided", "undecided"]
    assert result["sd_agrees"]["cyst_1"] == "yes" and np.isnan(result["sd_ratio"]["cyst_1"])
    assert result["sd_ratio"]["normal_1"] == np.inf and result["sd_ratio"]["normal_2"] == 0
    assert result.loc[["cyst_1", "cyst_2", "normal_1"], "shift_lower"].isna().all()
    assert np.isfinite(result[["p_mean", "p_sd", "q_mean", "q_sd"]]).all().all()


def test_rounding_error_is_no_spread():
    noise = 1e-13 * np.random.default_rng(0).normal(size=(2, 5))
    row = only(comparison.compare(table(cyst_1=7 + noise[0]), table(cyst_1=7 + noise[1]), [MEAN]))
    assert row[["sd_simulated", "sd_recorded", "shift_sd", "p_mean", "mean_agrees"]].tolist() == [0, 0, 0, 1, "yes"]


def test_two_repeats_do_not_test_the_sd():
    result = comparison.compare(table(cyst_1=[0, 1]), table(cyst_1=[0, 9]), [MEAN])
    assert (
        np.isnan(only(result)["p_sd"]) and np.isnan(only(result)["q_sd"]) and only(result)["sd_agrees"] == "undecided"
    )


@pytest.mark.parametrize(
    "change, options, message",
    [
        (lambda a, b: (a, b[b["roi"] != "cyst_2"]), {}, "recorded features lack the ROI cyst_2; give the ROIs"),
        (
            lambda a, b: (a[~a["roi"].isin(["cyst_1", "cyst_2"])], b),
            {},
            "simulated features lack the ROI cyst_1, cyst_2; give the ROIs",
        ),
        (lambda a, b: (a, b), {"rois": ["liver"]}, "simulated features lack the ROI liver"),
        (lambda a, b: (a, b), {"rois": []}, "there is no ROI to compare"),
        (lambda a, b: (a, b.drop(columns=FEATURES[1])), {}, f"recorded features: lack {FEATURES[1]}; compare only"),
        (lambda a, b: (a, b.drop_duplicates("roi")), {}, "recorded features: 1 image of ROI normal_1"),
        (lambda a, b: (a.assign(**{FEATURES[0]: np.nan}), b), {}, f"simulated features: {FEATURES[0]} is nan"),
        (lambda a, b: (a.assign(tissue_class="x"), b), {}, "normal_1 has tissue class normal_liver and x"),
        (lambda a, b: (a, b), {"margin_sd": 0}, "margin_sd 0 must be positive"),
        (lambda a, b: (a, b), {"sd_factor": 1}, "sd_factor 1 larger than one"),
    ],
)
def test_bad_input_is_one_clear_line(change, options, message):
    with pytest.raises(InputError) as caught:
        comparison.compare(*change(drawn(0, 3), drawn(1, 3)), FEATURES[:2], **options)
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_subset_of_rois_is_accepted_on_request():
    result = comparison.compare(drawn(0, 3), drawn(1, 3, rois=["cyst_2", "cyst_1"]), FEATURES[:2], rois=["cyst_1"])
    assert list(result["roi"].unique()) == ["cyst_1"]
    with pytest.raises(InputError, match="1 ROIs; an order"):
        comparison_summary.ranks(result)
    assert comparison_summary.summary(result)["kendall_tau"].isna().all()


def test_order_of_rois_of_simple_values():
    """One swap of neighbors among four: 1 of 6 pairs, tau 4/6; Spearman 1 - 6 x 2/(4 x 15)."""
    places = {"cyst_1": 0, "cyst_2": 10, "normal_1": 20, "normal_2": 30}
    swapped = places | {"cyst_1": 10, "cyst_2": 0}
    simulated, recorded = (table(**{roi: [v, v + 1, v + 2] for roi, v in p.items()}) for p in (swapped, places))
    row = only(comparison_summary.ranks(comparison.compare(simulated, recorded, [MEAN])))
    assert row[["kendall_tau", "spearman", "rois"]].tolist() == pytest.approx([4 / 6, 0.8, 4])
    same = comparison.compare(recorded.assign(**{MEAN: recorded.groupby("roi").cumcount() * 1.0}), recorded, [MEAN])
    assert only(comparison_summary.ranks(same))[["kendall_tau", "spearman"]].isna().all()


def test_two_swaps_of_six_count_as_in_order_with_a_chance_of_3_percent():
    taus = [stats.kendalltau(range(6), order).statistic for order in permutations(range(6))]
    assert np.mean(np.array(taus) >= comparison_summary.RANK_RIGHT) == pytest.approx(20 / 720)


def test_summary_of_simple_values():
    """Six ROIs: correct in all but one; then the SD three times too large; then in reverse order."""
    features = list(FEATURES[:3])
    recorded = drawn(2, 12, features)
    simulated = recorded.copy()
    rois = list(TISSUE_CLASSES)
    last = simulated["roi"] == rois[-1]
    simulated.loc[last, features[0]] += 3 * recorded.loc[last, features[0]].std()
    centre = recorded.groupby("roi")[features].transform("mean")
    simulated[features[1]] = centre[features[1]] + 3 * (recorded[features[1]] - centre[features[1]])
    simulated[features[2]] = -recorded[features[2]]
    result = comparison.compare(simulated, recorded, features)
    summary = comparison_summary.summary(result).set_index("feature")
    assert summary["verdict"].tolist() == ["mean, SD and rank right", "mean and rank right", "SD right"]
    first, second, third = (summary.loc[feature] for feature in features)
    assert first[["rois", "share_within_margin", "median_sd_ratio"]].tolist() == pytest.approx([6, 5 / 6, 1])
    assert first["median_abs_shift_sd"] == pytest.approx(0, abs=1e-9) and first["share_mean_differs"] == 1 / 6
    assert second[["median_sd_ratio", "share_sd_within"]].tolist() == pytest.approx([3, 0])
    assert third[["kendall_tau", "spearman"]].tolist() == pytest.approx([-1, -1])
    families = comparison_summary.family_summary(result)
    assert families["family"].tolist() == ["first order", "all"] and families["features"].tolist() == [3, 3]
    assert families.loc[1, ["share_all_right", "share_mean_right", "share_sd_right"]].tolist() == pytest.approx(
        [1 / 3, 2 / 3, 2 / 3]
    )
    assert families.loc[1, "share_within_margin"] == pytest.approx(
        (5 + 6 + (summary["share_within_margin"].iloc[2] * 6)) / 18
    )


def test_verdicts_are_english_text():
    verdicts = [comparison_summary._verdict(right) for right in ((1, 1, 1), (1, 0, 1), (0, 0, 1), (0, 0, 0))]
    assert verdicts == ["mean, SD and rank right", "mean and rank right", "rank right", "none right"]


# Comparable features


def features_of(array, spacing=1.0):
    grid = Grid(array.shape, (spacing,) * 3, (0.0, 0.0, 0.0))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        row = extraction.extract(Volume(array.astype(np.float32), grid), {"roi": np.ones(array.shape, bool)}).iloc[0]
    return row[list(FEATURES)].astype(float)


def white_noise(rng, edge):
    """HU of a skewed distribution, mean 60 and SD 30, so that skewness and cluster shade are clearly not 0."""
    return rng.gamma(4.0, 15.0, size=(edge,) * 3)


def test_flags_mark_features_that_change_with_roi_size_and_grid():
    """Eight times as many voxels of the same distribution; and the same voxels, each split into eight."""
    rng = np.random.default_rng(5)
    small = np.mean([features_of(white_noise(rng, 8)) for _ in range(4)], axis=0)
    large = np.mean([features_of(white_noise(rng, 16)) for _ in range(2)], axis=0)
    flags = comparability.comparable(FEATURES, 3, 0).set_index("feature")
    # In white noise these are 0 except for chance, which decreases with more voxels.
    chance = {f"original_glcm_{name}" for name in ("Correlation", "Imc1", "Imc2")}
    grown = pd.Series(large / small, index=FEATURES).drop(list(chance))
    strongly = (grown > 3) | (grown < 1 / 3)
    assert set(grown.index[strongly]) == set(flags.index[flags["depends_on_size"]])

    coarse = white_noise(rng, 8)
    fine = coarse.repeat(2, 0).repeat(2, 1).repeat(2, 2)
    change = features_of(fine, 0.5) / features_of(coarse)
    unflagged = change[~flags["depends_on_voxel_size"]]
    assert np.allclose(unflagged, 1, atol=0.02)  # quantiles interpolate between other voxels
    energy = change["original_firstorder_Energy"], change["original_gldm_GrayLevelNonUniformity"]
    assert energy == pytest.approx((8, 8))
    assert ((change[flags["depends_on_voxel_size"]] - 1).abs() > 0.02).mean() > 0.7


def test_offsets_move_values_or_bin_edges():
    rng = np.random.default_rng(6)
    hu = rng.normal(60, 30, (10, 10, 10)).round()
    plain = features_of(hu)
    for offset in (1000, 1024):
        flags = comparability.comparable(FEATURES, 3, offset).set_index("feature")
        change = (features_of(hu + offset) / plain - 1).abs()
        assert (change[flags["needs_hu"]] > 0.5).all()
        still = ~flags["needs_hu"] & ~flags["depends_on_bin_edges"]
        assert np.allclose(change[still], 0, atol=1e-5)
        assert flags["depends_on_bin_edges"].any() == (offset == 1024)
    assert not comparability.comparable(FEATURES, 3, 0)[["needs_hu", "depends_on_bin_edges"]].any().any()


def test_features_that_must_not_be_compared():
    verdict = {
        (dimensions, same): comparability.comparable(FEATURES, dimensions, 1024, same_voxels=same).set_index("feature")
        for dimensions in (2, 3)
        for same in (False, True)
    }
    solid = verdict[3, True]["comparable"]
    assert "no" not in set(solid) and solid["original_glcm_Idn"] == "with care" and solid[MEAN] == "yes"
    assert verdict[3, True].loc[MEAN, "reason"] == "after conversion to HU"
    other = verdict[3, False]["comparable"]
    assert set(other.index[other == "no"]) == set(comparability.SIZED)
    for same in (False, True):  # a slice never has the voxels of a volume
        flat = verdict[2, same]["comparable"]
        assert set(comparability.SIZED) < set(flat.index[flat == "no"])
        assert flat["original_gldm_DependenceVariance"] == flat["original_glszm_ZoneEntropy"] == "no"
        assert flat["original_gldm_GrayLevelVariance"] == flat["original_glcm_Contrast"] == "with care"
    assert set(solid) | set(flat) == {"yes", "with care", "no"}
    for arguments, message in (((FEATURES, 4, 0), "dimensions is 4"), ((["x"], 3, 0), "unknown feature x")):
        with pytest.raises(InputError, match=message):
            comparability.comparable(*arguments)


def test_size_of_an_roi_from_its_features():
    rng = np.random.default_rng(7)
    rows = pd.DataFrame([features_of(rng.normal(50, 20, (6, 6, 6)), 2.0) for _ in range(2)]).assign(roi="cyst_1")
    assert comparability.roi_sizes(rows).iloc[0].tolist() == ["cyst_1", pytest.approx(216), pytest.approx(8)]
    assert np.isnan(comparability.roi_sizes(rows.drop(columns="original_firstorder_TotalEnergy"))["voxel_mm3"][0])
    with pytest.raises(InputError, match="Energy is missing"):
        comparability.roi_sizes(rows.drop(columns="original_firstorder_Energy"))


def test_features_that_grow_with_the_roi_are_named_if_voxels_differ():
    """Noise in cubes of 6 and 8 voxels per edge, of 1 mm and 2 mm: counts of voxels and volumes are known."""
    rng = np.random.default_rng(11)

    def rows(edge, spacing=1.0):
        return pd.DataFrame([features_of(rng.normal(50, 20, (edge,) * 3), spacing) for _ in range(2)]).assign(roi="a")

    simulated = rows(6)
    assert comparability.other_sizes(simulated, rows(6), FEATURES, ["a"]) == {}
    larger = comparability.other_sizes(simulated, rows(8), FEATURES, ["a"])
    assert set(larger) == set(comparability.SIZED)
    assert set(larger.values()) == {"512 voxels of 1 mm³, the study's 216 voxels of 1 mm³"}
    coarser = comparability.other_sizes(simulated, rows(6, 2.0), FEATURES, ["a"])
    assert set(coarser.values()) == {"216 voxels of 8 mm³, the study's 216 voxels of 1 mm³"}
    # An ROI that is not compared gives no information. In a table without Energy, pyradiomics' own column is used.
    both_rois = pd.concat([rows(6), rows(8).assign(roi="b")])
    assert comparability.other_sizes(simulated, both_rois, FEATURES, ["a"]) == {}
    some = rows(8).drop(columns="original_firstorder_Energy")
    assert comparability.other_sizes(simulated, some, FEATURES, ["a"]) == {}
    counted = comparability.other_sizes(simulated, some.assign(**{comparability.COUNTS[2]: 512}), FEATURES, ["a"])
    assert set(counted.values()) == {"512 voxels, the study's 216 voxels of 1 mm³"}


real = pytest.mark.skipif(not REAL.exists(), reason="the real measurements are not beside this checkout")


@pytest.mark.real
@real
def test_two_halves_of_one_real_scan_series_do_not_differ():
    """Ten scans compared with ten others of the same setting, as an ideal simulation would be."""
    study = measured.load_full_table(REAL / "ct_phantom4radiomics" / "features_2d.csv")
    for group in (1, 5):
        scans = study[(study["group"] == group) & (study["acquisition"] <= 20)]
        odd = scans["acquisition"] % 2 == 1
        result = comparison.compare(scans[odd], scans[~odd], measured.PHANTOM4RADIOMICS_FEATURES)
        assert not (result[["q_mean", "q_sd", "holm_mean", "holm_sd"]] < 0.05).any().any()
        assert "no" not in set(result["mean_agrees"]) | set(result["sd_agrees"])
        overall = comparison_summary.family_summary(result).iloc[-1]
        assert overall["share_within_margin"] > 0.9 and overall["median_abs_shift_sd"] < 0.4
        assert 0.2 < overall["share_equivalent"] < 0.5  # ten scans prove less than half of the true agreement


@pytest.mark.real
@real
def test_two_reconstructions_of_the_same_real_scans_differ_but_order_the_rois_equally():
    series = measured.load_full_dose_series(REAL / "edge_dose_series" / "features_3d.csv").query("dose_mgy == 10")
    sides = (series[series["reconstruction"] == name] for name in ("iterative", "fbp"))
    overall = comparison_summary.family_summary(comparison.compare(*sides, FEATURES)).iloc[-1]
    assert overall["median_abs_shift_sd"] == pytest.approx(5.1, abs=0.1) and overall["share_mean_differs"] > 0.8
    assert overall["share_rank_right"] > 0.9 and overall["median_sd_ratio"] == pytest.approx(1.02, abs=0.02)
