import logging
import warnings

import numpy as np
import pytest
import SimpleITK as sitk
from radiomics.featureextractor import RadiomicsFeatureExtractor
from scipy import ndimage

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.features import extraction
from virtual_phantom.features.extraction import RadiomicsWarning
from virtual_phantom.features.names import FEATURES, family
from virtual_phantom.io.volumes import Volume

# IBSI, digital phantom (reference manual, arXiv:1612.07003v11, section 5.1, CC BY
# 4.0): 5 x 4 x 4 voxels of 2 mm, here [z, y, x]; 0 marks voxels outside the ROI.
IBSI_PHANTOM = np.array(
    [
        [[1, 4, 4, 1, 1], [1, 4, 6, 1, 1], [4, 1, 6, 4, 1], [4, 4, 6, 4, 1]],
        [[1, 4, 4, 1, 1], [1, 1, 6, 1, 1], [0, 1, 3, 1, 1], [4, 4, 6, 1, 1]],
        [[1, 4, 4, 0, 0], [1, 1, 1, 1, 1], [1, 1, 0, 1, 1], [1, 1, 6, 1, 1]],
        [[1, 4, 4, 0, 0], [1, 1, 1, 1, 1], [1, 1, 1, 1, 1], [1, 1, 6, 1, 1]],
    ]
)
# Published reference values, three significant digits: GLCM and GLRLM averaged over 3D directions, GLSZM and NGLDM
# (GLDM in pyradiomics) in 3D. Intensities here are 25 times the phantom's, so that 25 HU bins give its gray levels.
# Dimensionless and texture features do not change, the others scale by 25 or 25^2. Kurtosis is without the -3 of the
# manual.
IBSI_VALUES = {
    "firstorder_Mean": 25 * 2.15,
    "firstorder_Variance": 25**2 * 3.05,
    "firstorder_Skewness": 1.08,
    "firstorder_Kurtosis": -0.355 + 3,
    "firstorder_Median": 25,
    "firstorder_Minimum": 25,
    "firstorder_10Percentile": 25,
    "firstorder_90Percentile": 100,
    "firstorder_Maximum": 150,
    "firstorder_InterquartileRange": 75,
    "firstorder_Range": 125,
    "firstorder_MeanAbsoluteDeviation": 25 * 1.55,
    "firstorder_RobustMeanAbsoluteDeviation": 25 * 1.11,
    "firstorder_Energy": 25**2 * 567,
    "firstorder_TotalEnergy": 8 * 25**2 * 567,
    "firstorder_RootMeanSquared": 25 * 2.77,
    "firstorder_Entropy": 1.27,
    "firstorder_Uniformity": 0.512,
    "glcm_Autocorrelation": 5.06,
    "glcm_ClusterProminence": 145,
    "glcm_ClusterShade": 16.6,
    "glcm_ClusterTendency": 7.07,
    "glcm_Contrast": 5.32,
    "glcm_Correlation": 0.157,
    "glcm_DifferenceAverage": 1.43,
    "glcm_DifferenceEntropy": 1.56,
    "glcm_DifferenceVariance": 3.06,
    "glcm_Id": 0.677,
    "glcm_Idn": 0.851,
    "glcm_Idm": 0.618,
    "glcm_Idmn": 0.898,
    "glcm_Imc1": -0.157,
    "glcm_Imc2": 0.520,
    "glcm_InverseVariance": 0.0604,
    "glcm_JointAverage": 2.14,
    "glcm_JointEnergy": 0.303,
    "glcm_JointEntropy": 2.40,
    "glcm_MaximumProbability": 0.503,
    "glcm_SumEntropy": 1.92,
    "glcm_SumSquares": 3.10,
    "glrlm_GrayLevelNonUniformity": 21.8,
    "glrlm_GrayLevelNonUniformityNormalized": 0.430,
    "glrlm_GrayLevelVariance": 3.46,
    "glrlm_HighGrayLevelRunEmphasis": 9.70,
    "glrlm_LongRunEmphasis": 3.06,
    "glrlm_LongRunHighGrayLevelEmphasis": 17.6,
    "glrlm_LongRunLowGrayLevelEmphasis": 2.39,
    "glrlm_LowGrayLevelRunEmphasis": 0.603,
    "glrlm_RunEntropy": 2.43,
    "glrlm_RunLengthNonUniformity": 26.9,
    "glrlm_RunLengthNonUniformityNormalized": 0.513,
    "glrlm_RunPercentage": 0.680,
    "glrlm_RunVariance": 0.574,
    "glrlm_ShortRunEmphasis": 0.705,
    "glrlm_ShortRunHighGrayLevelEmphasis": 8.54,
    "glrlm_ShortRunLowGrayLevelEmphasis": 0.352,
    "glszm_SmallAreaEmphasis": 0.255,
    "glszm_LargeAreaEmphasis": 550,
    "glszm_LowGrayLevelZoneEmphasis": 0.253,
    "glszm_HighGrayLevelZoneEmphasis": 15.6,
    "glszm_SmallAreaLowGrayLevelEmphasis": 0.0256,
    "glszm_SmallAreaHighGrayLevelEmphasis": 2.76,
    "glszm_LargeAreaLowGrayLevelEmphasis": 503,
    "glszm_LargeAreaHighGrayLevelEmphasis": 1490,
    "glszm_GrayLevelNonUniformity": 1.4,
    "glszm_GrayLevelNonUniformityNormalized": 0.28,
    "glszm_SizeZoneNonUniformity": 1,
    "glszm_SizeZoneNonUniformityNormalized": 0.2,
    "glszm_ZonePercentage": 0.0676,
    "glszm_GrayLevelVariance": 2.64,
    "glszm_ZoneVariance": 331,
    "glszm_ZoneEntropy": 2.32,
    "gldm_SmallDependenceEmphasis": 0.045,
    "gldm_LargeDependenceEmphasis": 109,
    "gldm_LowGrayLevelEmphasis": 0.693,
    "gldm_HighGrayLevelEmphasis": 7.66,
    "gldm_SmallDependenceLowGrayLevelEmphasis": 0.00963,
    "gldm_SmallDependenceHighGrayLevelEmphasis": 0.736,
    "gldm_LargeDependenceLowGrayLevelEmphasis": 102,
    "gldm_LargeDependenceHighGrayLevelEmphasis": 235,
    "gldm_GrayLevelNonUniformity": 37.9,
    "gldm_DependenceNonUniformity": 4.86,
    "gldm_DependenceNonUniformityNormalized": 0.0657,
    "gldm_GrayLevelVariance": 3.05,
    "gldm_DependenceVariance": 22.1,
    "gldm_DependenceEntropy": 4.40,
}


def volume(array, spacing=(1.0, 1.0, 1.0)):
    return Volume(np.asarray(array), Grid(shape=np.shape(array), spacing=spacing))


def one_row(array, mask=None, **kwargs):
    mask = np.ones(np.shape(array), bool) if mask is None else mask
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RadiomicsWarning)
        return extraction.extract(volume(array, **kwargs), {"roi": mask}).iloc[0]


def test_features_are_the_86_of_the_paper():
    counts = {
        name: sum(family(feature) == name for feature in FEATURES)
        for name in ("first order", "GLCM", "GLDM", "GLRLM", "GLSZM")
    }
    assert counts == {"first order": 18, "GLCM": 22, "GLDM": 14, "GLRLM": 16, "GLSZM": 16}
    assert len(set(FEATURES)) == 86
    assert not {"original_glcm_SumAverage", "original_glcm_MCC"} & set(FEATURES)


def test_values_published_for_the_ibsi_digital_phantom():
    row = one_row(25.0 * IBSI_PHANTOM, IBSI_PHANTOM > 0, spacing=(2.0, 2.0, 2.0))
    assert row["n_voxels"] == 74
    assert row["grey_levels"] == 4  # 1, 3, 4 and 6
    assert {f"original_{name}" for name in IBSI_VALUES} == set(FEATURES)
    for name, value in IBSI_VALUES.items():
        assert row[f"original_{name}"] == pytest.approx(value, rel=6e-3), name  # half a unit of the third digit


def test_values_of_a_row_of_six_voxels():
    # Gray levels 1 1 1 2 3 3, one direction. Co-occurrence, symmetric, of 10: (1,1) 4, (1,2) and (2,1) 1 each, (2,3)
    # and (3,2) 1 each, (3,3) 2. Runs and zones (level x length): 1 x 3, 2 x 1, 3 x 2. Dependence, including the voxel
    # itself: 2 3 2 | 1 | 2 2.
    row = one_row([[[25.0, 30, 49, 50, 75, 99]]], spacing=(3.0, 2.0, 1.0))
    expected = {
        "firstorder_Energy": 25**2 + 30**2 + 49**2 + 50**2 + 75**2 + 99**2,
        "firstorder_TotalEnergy": 6 * (25**2 + 30**2 + 49**2 + 50**2 + 75**2 + 99**2),
        "firstorder_Uniformity": 1 / 4 + 1 / 36 + 1 / 9,
        "glcm_JointEnergy": (16 + 4 * 1 + 4) / 100,
        "glcm_Contrast": 4 / 10,
        "glcm_MaximumProbability": 0.4,
        "glcm_Autocorrelation": (4 * 1 + 2 * 2 + 2 * 6 + 2 * 9) / 10,
        "glrlm_ShortRunEmphasis": (1 / 9 + 1 + 1 / 4) / 3,
        "glrlm_RunPercentage": 3 / 6,
        "glrlm_LongRunHighGrayLevelEmphasis": (9 * 1 + 1 * 4 + 4 * 9) / 3,
        "glszm_LargeAreaEmphasis": (9 + 1 + 4) / 3,
        "glszm_ZonePercentage": 3 / 6,
        "gldm_LargeDependenceEmphasis": (4 + 9 + 4 + 1 + 4 + 4) / 6,
        "gldm_SmallDependenceEmphasis": (4 / 4 + 1 / 9 + 1) / 6,
    }
    for name, value in expected.items():
        assert row[f"original_{name}"] == pytest.approx(value, rel=1e-12), name


def blobs(rng):
    texture = ndimage.gaussian_filter(rng.normal(size=(20, 40, 44)), 1)
    z, y, x = np.ogrid[:20, :40, :44]
    masks = {
        "ball": (z - 10) ** 2 + (y - 12) ** 2 + (x - 20) ** 2 < 30,
        "at_the_corner": (z < 3) & (y < 5) & (x > 38),
        "two_parts": ((z == 4) & (y > 30) & (x < 9)) | ((z > 16) & (y > 35) & (x > 40)),
        "one_slice": (z == 7) & ((y - 20) ** 2 + (x - 25) ** 2 < 50),
    }
    return texture * 200 + 40, {name: np.broadcast_to(mask, texture.shape) for name, mask in masks.items()}


@pytest.mark.parametrize("dtype", [np.float32, np.int16])
def test_equal_to_the_plain_extractor_on_the_full_image_bit_for_bit(dtype):
    image, masks = blobs(np.random.default_rng(1))
    spacing = (1.5, 0.7, 0.7)
    image = image.astype(dtype)
    table = extraction.extract(volume(image, spacing), masks).set_index("roi")
    plain = RadiomicsFeatureExtractor(binWidth=25, voxelArrayShift=0, gldm_a=0, symmetricalGLCM=True)
    plain.disableAllFeatures()
    for name in ("firstorder", "glcm", "gldm", "glrlm", "glszm"):
        plain.enableFeatureClassByName(name)
    for roi, mask in masks.items():
        images = [sitk.GetImageFromArray(array) for array in (image, mask.astype(np.uint8))]
        for each in images:
            each.SetSpacing(spacing[::-1])
        values = plain.execute(*images)
        assert {feature for feature in FEATURES if table.loc[roi, feature] != float(values[feature])} == set()
        assert table.loc[roi, "n_voxels"] == mask.sum()


def test_gray_levels_are_the_occupied_bins_whose_edges_are_multiples_of_25():
    assert one_row([[[-0.1, 0, 24.9, 25, 130.0]]])["grey_levels"] == 4
    assert one_row([[[-25.0, -0.1, -24, -1]]])["grey_levels"] == 1


def test_voxels_outside_the_roi_have_no_effect():
    image, masks = blobs(np.random.default_rng(2))
    other = np.where(masks["ball"], image, -1000.0)
    first, second = (extraction.extract(volume(array), {"ball": masks["ball"]}) for array in (image, other))
    assert first.equals(second)


def test_rows_state_their_settings():
    row = one_row(25.0 * IBSI_PHANTOM, IBSI_PHANTOM > 0)
    assert row["pyradiomics_version"].startswith("v3.0.1") or row["pyradiomics_version"].startswith("3.0.1")
    assert row["numpy_version"] == np.__version__
    assert len(row["settings_hash"]) == 16 and int(row["settings_hash"], 16) >= 0


def test_settings_hash_depends_on_the_settings(monkeypatch):
    before = extraction.DEFAULT.hash()
    assert extraction.DEFAULT.hash() == before
    monkeypatch.setitem(extraction.SETTINGS, "binWidth", 26)
    assert extraction.DEFAULT.hash() != before


def test_warns_with_numbers_of_small_and_of_constant_regions():
    noise = np.random.default_rng(0).normal(0, 60, (6, 6, 6))
    small = np.zeros(noise.shape, bool)
    small[:3, :3, :3] = True
    with pytest.warns(RadiomicsWarning, match=r"scan 7: ROI spot has 27 voxels, fewer than the 64") as caught:
        extraction.extract(volume(noise), {"spot": small}, name="scan 7")
    assert len(caught) == 1
    flat = np.full((6, 6, 6), 12.0)
    with pytest.warns(RadiomicsWarning, match=r"ROI flat fills 1 gray-level bins of 25 HU, fewer than the 3"):
        extraction.extract(volume(flat), {"flat": np.ones(flat.shape, bool)})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        extraction.extract(volume(noise), {"good": np.ones(noise.shape, bool)})


def test_pyradiomics_log_becomes_a_warning_and_its_logger_is_unchanged(monkeypatch, capfd):
    logger = logging.getLogger("radiomics")
    monkeypatch.setattr(logger, "level", logging.ERROR)  # as a caller may set it
    before = logger.handlers[:], logger.propagate, logger.level
    real = extraction.DEFAULT.extractor

    class NoisyExtractor:
        def execute(self, image, label):
            logging.getLogger("radiomics.glcm").warning("something is odd")
            logging.getLogger("radiomics.glcm").info("small talk")
            return real.execute(image, label)

    monkeypatch.setitem(vars(extraction.DEFAULT), "extractor", NoisyExtractor())
    noise = np.random.default_rng(0).normal(0, 60, (6, 6, 6))
    with pytest.warns(RadiomicsWarning, match="image, ROI roi: pyradiomics: something is odd") as caught:
        extraction.extract(volume(noise), {"roi": np.ones(noise.shape, bool)})
    assert len(caught) == 1
    assert (logger.handlers, logger.propagate, logger.level) == before
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    "spoil, message",
    [
        (lambda image, mask: (np.where(mask, np.nan, image), mask), "27 voxels are NaN or infinite"),
        (lambda image, mask: (image, mask & False), "ROI spot has 0 voxels"),
        (
            lambda image, mask: (image, mask[1:]),
            r"mask of ROI spot has shape \(5, 6, 6\), the image \(6, 6, 6\)",
        ),
    ],
)
def test_bad_input_is_one_clear_line(spoil, message):
    mask = np.zeros((6, 6, 6), bool)
    mask[:3, :3, :3] = True
    image, mask = spoil(np.zeros((6, 6, 6)), mask)
    with pytest.raises(InputError, match=message) as caught:
        extraction.extract(volume(image), {"spot": mask})
    assert "\n" not in str(caught.value)
