import numpy as np
import pandas as pd
import pytest

from virtual_phantom.base.errors import InputError
from virtual_phantom.statistics import noise

BOX = np.ones((2, 3, 4), bool)


def test_variance_of_simple_values():
    left = BOX.copy()
    left[:, :, 2:] = False
    ramp = np.where(left, 1.0, 2.0)
    table = noise.repeat_variance((ramp * k for k in (1, 2, 3)), {"left": left, "right": ~left}).set_index("roi")
    # 1 2 3 has variance 1, 2 4 6 has 4.
    assert table["variance_hu2"].to_dict() == pytest.approx({"left": 1, "right": 4, noise.EVERY_ROI: 2.5})
    assert (table["repeats"] == 3).all()
    # Leaving out one of 1 2 3 gives variances 0.5, 2 and 0.5: mean 1, jackknife variance 2/3 x (0.25 + 1 + 0.25).
    assert table.loc["left", "standard_error"] == pytest.approx(1.0)


def test_overlapping_rois_count_each_voxel_once_in_total():
    inner = BOX.copy()
    inner[0] = False
    image = np.where(inner, 1.0, 2.0)
    table = noise.repeat_variance((image * k for k in (1, 2, 3)), {"outer": BOX, "inner": inner}).set_index("roi")
    assert table.loc[noise.EVERY_ROI, "variance_hu2"] == pytest.approx(table.loc["outer", "variance_hu2"])


@pytest.mark.parametrize("name", ["all", "All", "roi", "variance_hu2", "EVERY_ROI"])
def test_roi_of_any_name_keeps_its_row(name):
    half = BOX.copy()
    half[0] = False
    image = np.where(half, 1.0, 2.0)
    table = noise.repeat_variance((image * k for k in (1, 2, 3)), {name: half, "other": ~half}).set_index("roi")
    assert table["variance_hu2"].to_dict() == pytest.approx({name: 1, "other": 4, noise.EVERY_ROI: 2.5})


def test_known_noise_is_recovered_with_a_correct_error_for_correlated_voxels():
    rng = np.random.default_rng(5)
    errors, claimed = [], []
    for _ in range(150):
        # Blocks of 10 x 10 equal voxels: 16 independent values per image instead of 1600.
        images = np.kron(rng.normal(0, 7, (10, 1, 4, 4)), np.ones((1, 1, 10, 10)))
        row = noise.repeat_variance(images, {"roi": np.ones(images.shape[1:], bool)}).iloc[0]
        errors.append(row["variance_hu2"] - 49)
        claimed.append(row["standard_error"])
    assert abs(np.mean(errors)) < 4 * np.std(errors) / np.sqrt(150)
    assert np.mean(claimed) == pytest.approx(np.std(errors), rel=0.25)
    assert np.std(errors) == pytest.approx(49 * np.sqrt(2 / 9 / 16), rel=0.25)  # chi-square, 9 degrees of freedom


def test_variance_of_two_images_is_split_by_hand():
    # Voxels 0 and 4 in all of three repeats; the second voxel is also 3 higher in the last: means 0 and 5.
    images = [np.array([[[0.0, 4.0]]]), np.array([[[0.0, 4.0]]]), np.array([[[0.0, 7.0]]])]
    row = noise.fixed_pattern(images, {"roi": np.ones((1, 1, 2), bool)}).iloc[0]
    single, mean = (4 + 4 + 12.25) / 3, 6.25
    assert row["spatial_variance_hu2"] == pytest.approx(single)
    assert row["pattern_variance_hu2"] == pytest.approx((3 * mean - single) / 2)
    assert row["noise_variance_hu2"] == pytest.approx(1.5 * (single - mean))
    assert row["pattern_percent"] == pytest.approx(100 * row["pattern_variance_hu2"] / single)


@pytest.mark.parametrize("amplitude, largest", [(3.0, 1.8), (30.0, 1.25)])
def test_fixed_pattern_is_separated_from_correlated_noise_with_a_conservative_error(amplitude, largest):
    rng = np.random.default_rng(6)
    pattern = np.repeat([amplitude, -amplitude], 20) * np.ones((1, 40, 1))  # as correlated as the noise
    found, claimed = [], []
    for _ in range(150):
        # Blocks of 10 x 10 equal voxels: the noise variance within the ROI is 49 (1 - 1 / 16).
        images = pattern + np.kron(rng.normal(0, 7, (10, 1, 4, 4)), np.ones((1, 1, 10, 10)))
        row = noise.fixed_pattern(images, {"roi": np.ones(images.shape[1:], bool)}).iloc[0]
        found.append(row[["pattern_variance_hu2", "noise_variance_hu2"]].to_list())
        claimed.append(row["standard_error"])
    errors = np.mean(found, axis=0) - [amplitude**2, 49 * 15 / 16]
    assert (abs(errors) < 4 * np.std(found, axis=0) / np.sqrt(150)).all()
    assert 0.8 < np.mean(claimed) / np.std(found, axis=0)[0] < largest


@pytest.mark.parametrize("count, offset, percent", [(3, 0.0, 100.0), (3, np.nan, None), (2, 0.0, None)])
def test_repeats_without_noise_are_all_pattern_and_too_few_or_missing_values_an_error(count, offset, percent):
    images = [np.arange(24.0).reshape(BOX.shape) + offset] * count
    if percent is None:
        with pytest.raises(InputError, match="fixed pattern: (2 repeats|repeat 1 has voxels that are not finite)"):
            noise.fixed_pattern(images, {"roi": BOX})
        return
    row = noise.fixed_pattern(images, {"roi": BOX}).iloc[0]
    assert (row["pattern_percent"], row["noise_variance_hu2"], row["standard_error"]) == pytest.approx((percent, 0, 0))


def test_images_are_processed_one_at_a_time():
    alive = []

    def images():
        for k in range(4):
            alive.append(k)
            yield np.full(BOX.shape, float(k))

    assert noise.repeat_variance(images(), {"roi": BOX})["repeats"].tolist() == [4, 4]
    assert alive == [0, 1, 2, 3]


def test_line_is_fitted_and_inverted():
    level = np.array([1e-4, 2e-4, 4e-4])
    fit = noise.linear_fit(level, 3 + 5e5 * level)
    assert (fit.slope, fit.intercept, fit.r_squared) == pytest.approx((5e5, 3, 1))
    assert fit.noise_level_for(228) == pytest.approx(4.5e-4)
    # Points (0, 0), (1, 2), (2, 1) have slope 1/2, intercept 1/2 and R2 1/4.
    fit = noise.linear_fit([0, 1, 2], [0, 2, 1])
    assert (fit.slope, fit.intercept, fit.r_squared) == pytest.approx((0.5, 0.5, 0.25))


def calibration(variance):
    """Three levels of one protocol, and two ROIs whose mean variance is `mean`."""
    rows = [
        {"protocol": "p", "noise_level": level, "roi": roi, "spatial_variance_hu2": value + sign}
        for level, value in zip((1e-4, 2e-4, 4e-4), variance, strict=True)
        for roi, sign in (("a", 1), ("b", -1))
    ]
    return pd.DataFrame(rows)


def test_noise_level_is_matched_to_a_recording():
    """Exactly variance = 3 + 5e5 A, so 103 needs A = 2e-4; the only error is that of the recorded mean, 2 / sqrt 2."""
    measured = pd.DataFrame({"a": [100.0, 104.0, np.nan], "b": [102.0, 106.0, 99.0]})
    match = noise.match_noise_level(calibration([53, 103, 203]), "p", ["a", "b"], measured)
    assert (match.A, match.variance_hu2, match.extrapolated) == (pytest.approx(2e-4), pytest.approx(103), False)
    assert match.A_standard_error == pytest.approx(2 / 5e5)
    assert noise.match_noise_level(calibration([53, 103, 203]), "p", ["a"], measured * 3).extrapolated


def test_error_of_a_matched_level_has_its_coverage():
    """Lines with known scatter: the true level lies within 1.96 standard errors in about 95 %."""
    random = np.random.default_rng(5)
    levels = np.linspace(1e-4, 4e-4, 12)
    inside = 0
    for _ in range(300):
        table = pd.DataFrame(
            {
                "protocol": "p",
                "noise_level": levels,
                "roi": "a",
                "spatial_variance_hu2": (3 + 5e5 * levels) * random.normal(1, 0.04, 12),
            }
        )
        match = noise.match_noise_level(table, "p", ["a"], pd.DataFrame({"a": 103 + random.normal(0, 6, 10)}))
        inside += abs(match.A - 2e-4) < 1.96 * match.A_standard_error
    assert 0.88 < inside / 300 < 0.98


@pytest.mark.parametrize(
    "call, message",
    [
        (
            lambda: noise.match_noise_level(calibration([1, 2, 3]), "q", ["a"], pd.DataFrame({"a": [1.0]})),
            "no rows of protocol q",
        ),
        (
            lambda: noise.match_noise_level(calibration([1, 2, 3]), "p", ["c"], pd.DataFrame({"c": [1.0]})),
            "has no ROI c",
        ),
        (
            lambda: noise.match_noise_level(calibration([1, 2, 3]), "p", ["a"], pd.DataFrame({"b": [1.0]})),
            "no ROI a",
        ),
        (
            lambda: noise.match_noise_level(calibration([9, 2, 1]), "p", ["a"], pd.DataFrame({"a": [50.0]})),
            "no positive noise level",
        ),
        (
            lambda: noise.repeat_variance([np.zeros(BOX.shape)] * 2, {"roi": BOX}),
            "2 repeats; a variance and its error need at least 3",
        ),
        (
            lambda: noise.repeat_variance([np.zeros((1, 3, 4))] * 3, {"roi": BOX}),
            "repeat 1 has shape (1, 3, 4)",
        ),
        (
            lambda: noise.repeat_variance([np.full(BOX.shape, np.nan)] * 3, {"roi": BOX}),
            "not finite inside an ROI",
        ),
        (
            lambda: noise.repeat_variance([np.zeros(BOX.shape)] * 3, {"roi": BOX, "none": ~BOX}),
            "ROI none is empty",
        ),
        (lambda: noise.linear_fit([1, 1], [2, 3]), "two different noise levels"),
        (lambda: noise.LinearFit(2.0, 5.0, 1.0).noise_level_for(4), "no positive noise level"),
        (lambda: noise.LinearFit(-2.0, 5.0, 1.0).noise_level_for(4), "no positive noise level"),
    ],
)
def test_bad_input_is_one_clear_line(call, message):
    with pytest.raises(InputError) as caught:
        call()
    assert message in str(caught.value) and "\n" not in str(caught.value)
