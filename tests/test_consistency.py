"""Relations between features: every pyradiomics table satisfies them, and wrong rows do not."""

from functools import cache
from itertools import combinations

import numpy as np
import pandas as pd
import pytest
import SimpleITK as sitk
from hypothesis import given, settings
from hypothesis import strategies as st
from pyradiomics_batch import CLASSES
from radiomics.featureextractor import RadiomicsFeatureExtractor
from recording_folders import features_folder, features_table, noise_features, refused, write_yaml

from virtual_phantom.base.errors import InputError
from virtual_phantom.features.consistency import check, rounding
from virtual_phantom.features.names import FEATURES, features_of
from virtual_phantom.recordings.reading import load_recording

MEAN, ENERGY = "original_firstorder_Mean", "original_firstorder_Energy"

# Settings, image types and regions at the limits of the relations.
NOISE = np.random.default_rng(3).normal(40, 60, (5, 7, 8))
IMAGES = {
    "noise": NOISE,
    "uniform": np.full(NOISE.shape, -1000.0),
    "two values": np.where(NOISE > 100, 500.0, 40.0),
    "ramp": np.cumsum(NOISE, axis=0) + 1064,
    "nearly uniform": 0.3 + 1e-9 * NOISE,
}
SETTINGS = [
    {},
    {"voxelArrayShift": 300, "weightingNorm": "euclidean", "gldm_a": 1},
    {"symmetricalGLCM": False, "distances": [1, 2], "binCount": 7},
    {"force2D": True, "normalize": True, "binWidth": 0.1},
    {"resampledPixelSpacing": [2, 2, 2], "resegmentRange": [-1500, 1200]},
]


@cache
def extracted(image, number, types=("Original",), least=-2.0):
    """One pyradiomics row of the voxels whose noise is above `least`."""
    extractor = RadiomicsFeatureExtractor(minimumROIDimensions=1, additionalInfo=True, **SETTINGS[number])
    extractor.disableAllImageTypes()
    for name in types:
        extractor.enableImageTypeByName(name)
    extractor.disableAllFeatures()
    for name in CLASSES:
        extractor.enableFeatureClassByName(name)
    mask = (NOISE > 40 + 60 * least).astype(np.uint8)
    pair = [sitk.GetImageFromArray(array) for array in (IMAGES[image], mask)]
    for one in pair:
        one.SetSpacing((1.5, 1.0, 3.0))
    found = extractor.execute(*pair)
    row = {key: str(value) if key.startswith("diagnostics") else float(value) for key, value in found.items()}
    return pd.DataFrame([row])


def rounded(table, how):
    features = features_of(table)
    return table.assign(**table[features].map(how).to_dict("series"))


@pytest.mark.parametrize("image", IMAGES)
@pytest.mark.parametrize("number", range(len(SETTINGS)))
def test_pyradiomics_rows_are_accepted_also_if_rounded(image, number):
    if image == "uniform" and "normalize" in SETTINGS[number]:
        return  # pyradiomics divides by the standard deviation
    table = extracted(image, number)
    check(table, "t")
    check(table.drop(columns="diagnostics_Configuration_Settings"), "t")
    for digits in (1, 3, 5):
        check(rounded(table, lambda value, digits=digits: round(value, digits)), "t")
        check(rounded(table, lambda value, digits=digits: float(f"{value:.{digits + 1}g}")), "t")


def test_filtered_images_and_regions_of_a_few_voxels_are_accepted():
    check(extracted("noise", 1, ("Original", "Wavelet", "Exponential", "Gradient")), "t")
    for least in (2.2, 1.5, 0.0):
        check(extracted("noise", 0, least=least), "t")


def test_rows_with_different_rounding_are_accepted():
    rows = [extracted("noise", 0), rounded(extracted("ramp", 0), lambda value: float(f"{value:.3g}"))]
    check(pd.concat(rows, ignore_index=True), "t")


def test_rounding_error():
    exact = np.random.default_rng(0).normal(0, 1000, (4, 9))
    assert (rounding(exact) < 1e-4).all()
    for written in (exact.round(2), np.vectorize(lambda value: float(f"{value:.4g}"))(exact)):
        assert (rounding(written) >= abs(written - exact)).all()
    exact[:, 3], exact[2] = exact[:, 3].round(1), exact[2].round(0)  # a column and a row with fewer digits
    assert (rounding(exact)[:, 3] >= 0.05).all() and (rounding(exact)[2] >= 0.5).all()


def noisy():
    return pd.concat([noise_features(seed, 40.0) for seed in range(3)], ignore_index=True)[list(FEATURES)]


def caught(values):
    try:
        check(pd.DataFrame(values, columns=FEATURES, index=range(2, len(values) + 2)), "t.csv")
    except InputError as error:
        assert str(error).startswith("t.csv: row ")
        return True
    return False


@given(st.integers(0, 84), st.sampled_from([-3, -2, -1, 1, 2, 3]), st.integers(0, 5))
@settings(max_examples=60, deadline=None)
def test_row_shifted_from_some_column_on_is_rejected(start, by, row):
    values = noisy().to_numpy(copy=True)
    part = values[row, start:].copy()
    moved = part[-by:] if by < 0 else part[: len(part) - by]
    if len(moved) < 3:
        return  # within the last three columns, a swap of two features may remain undetected
    values[row, start:] = np.nan
    values[row, start + max(by, 0) : start + max(by, 0) + len(moved)] = moved
    assert caught(values)


def test_swapped_columns_are_rejected():
    """Except pairs of similar magnitude, which a table without its header cannot reveal."""
    values = noisy().to_numpy(copy=True)
    pairs = list(combinations(range(len(FEATURES)), 2))[::37]
    found = 0
    for one, other in pairs:
        swapped = values.copy()
        swapped[:, [one, other]] = swapped[:, [other, one]]
        found += caught(swapped)
    assert found > 0.85 * len(pairs)
    names = [FEATURES.index(f"original_firstorder_{name}") for name in ("Minimum", "Maximum", "Mean", "Median")]
    swapped = values.copy()
    swapped[:, names[:2]] = swapped[:, names[1::-1]]
    assert caught(swapped)


@pytest.mark.parametrize("feature", FEATURES)
def test_number_without_its_decimal_point_is_rejected(feature):
    values = noisy().to_numpy(copy=True)
    place = FEATURES.index(feature)
    digits = f"{values[1, place]:.12f}".rstrip("0").replace(".", "")
    if float(digits) != values[1, place]:
        values[1, place] = float(digits)
        assert caught(values), feature


@pytest.mark.parametrize(
    "change, message",
    [
        (
            {"original_firstorder_Range": 7.0},
            "t.csv: row 3 cannot be right: Range is Maximum - Minimum, but the values are 7 and ",
        ),
        (
            {"original_glcm_Imc2": 1.5},
            "glcm_Imc2 is at most 1, but it is 1.5; is the row shifted, or are columns mixed",
        ),
        ({"original_firstorder_Kurtosis": 0.1}, "Kurtosis is at least 1 + Skewness^2 (3 is not subtracted), but"),
        ({"original_firstorder_RootMeanSquared": 1064.0}, "RootMeanSquared^2 is Variance + Mean^2, but the values"),
    ],
)
def test_message_names_the_violated_relation(change, message):
    table = noisy().set_axis(range(2, 8))
    table.loc[3, list(change)] = list(change.values())
    with pytest.raises(InputError) as error:
        check(table, "t.csv")
    assert message in str(error.value), str(error.value)


def test_standardized_features_are_rejected_as_such():
    table = noisy()
    with pytest.raises(InputError, match=r"6 of 6 rows are wrong: are columns mixed up, or features standardized"):
        check((table - table.mean()) / table.std() - 9, "t")


def test_unknown_shift_of_gray_values_is_found():
    """A table without settings has one shift, which most rows determine."""
    table = pd.concat([extracted(name, 1) for name in ("noise", "ramp", "two values")], ignore_index=True)
    table = table.drop(columns="diagnostics_Configuration_Settings")
    check(table, "t")
    with pytest.raises(InputError, match=r"\(Mean \+ voxelArrayShift\)\^2"):
        check(pd.concat([table, extracted("noise", 0, least=0.0)[table.columns]], ignore_index=True), "t")


@pytest.fixture
def folder(tmp_path):
    return features_folder(tmp_path / "table")[0]


def test_single_image_in_stored_values_is_rejected(folder):
    other = features_table(1, start=5, mean=1064.0)
    pd.concat([features_table(2, start=3), other]).to_csv(folder / "b.csv", index=False)
    refused(folder, "b.csv: the means of the ROIs of image i5 are 10")
    refused(folder, "above the same ROIs in other images; convert all rows to HU, or all to HU + 1024")


def test_duplicate_image_is_rejected(folder):
    copy = features_table(1, start=1).assign(image="i9")
    pd.concat([features_table(2, start=3), copy]).to_csv(folder / "b.csv", index=False)
    refused(folder, "b.csv: row 6 (image i9) repeats all 86 features of row 4 (image i1) for ROI cyst_1")
    content = {"name": "table", "kind": "features", "repeats": ["a.csv", "b.csv"]}
    copy = copy.assign(dose_mgy=3)  # of another condition, as for a setting that changes no image
    pd.concat([features_table(2, start=3), copy]).to_csv(folder / "b.csv", index=False)
    assert len(load_recording(write_yaml(folder, content | {"features": {"conditions": ["dose_mgy"]}})).repeats) == 12


@pytest.mark.parametrize("value", [1e61, -1e200])
def test_impossible_number_is_named(value):
    table = pd.DataFrame(
        {"original_firstorder_Mean": [1.0, value], "original_firstorder_Energy": [2.0, 3.0]}, index=[2, 3]
    )
    with pytest.raises(InputError, match=r"t.csv: row 3: original_firstorder_Mean is .*, which no image has"):
        check(table, "t.csv")
