"""Names and families of radiomics features, as in pyradiomics.

This module is separate from `extraction`, so that code that handles tables does not load pyradiomics.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # slow to import, and every job imports this module
    import pandas as pd

WHOLE, LARGEST = "whole", "largest"  # sections of a region

FAMILIES = {"firstorder": "first order", "glcm": "GLCM", "gldm": "GLDM", "glrlm": "GLRLM", "glszm": "GLSZM"}

NAMES = {
    "firstorder": """10Percentile 90Percentile Energy Entropy InterquartileRange Kurtosis Maximum Mean
        MeanAbsoluteDeviation Median Minimum Range RobustMeanAbsoluteDeviation RootMeanSquared Skewness
        TotalEnergy Uniformity Variance""",
    "glcm": """Autocorrelation ClusterProminence ClusterShade ClusterTendency Contrast Correlation
        DifferenceAverage DifferenceEntropy DifferenceVariance Id Idm Idmn Idn Imc1 Imc2 InverseVariance
        JointAverage JointEnergy JointEntropy MaximumProbability SumEntropy SumSquares""",
    "gldm": """DependenceEntropy DependenceNonUniformity DependenceNonUniformityNormalized DependenceVariance
        GrayLevelNonUniformity GrayLevelVariance HighGrayLevelEmphasis LargeDependenceEmphasis
        LargeDependenceHighGrayLevelEmphasis LargeDependenceLowGrayLevelEmphasis LowGrayLevelEmphasis
        SmallDependenceEmphasis SmallDependenceHighGrayLevelEmphasis SmallDependenceLowGrayLevelEmphasis""",
    "glrlm": """GrayLevelNonUniformity GrayLevelNonUniformityNormalized GrayLevelVariance
        HighGrayLevelRunEmphasis LongRunEmphasis LongRunHighGrayLevelEmphasis LongRunLowGrayLevelEmphasis
        LowGrayLevelRunEmphasis RunEntropy RunLengthNonUniformity RunLengthNonUniformityNormalized
        RunPercentage RunVariance ShortRunEmphasis ShortRunHighGrayLevelEmphasis
        ShortRunLowGrayLevelEmphasis""",
    "glszm": """GrayLevelNonUniformity GrayLevelNonUniformityNormalized GrayLevelVariance
        HighGrayLevelZoneEmphasis LargeAreaEmphasis LargeAreaHighGrayLevelEmphasis
        LargeAreaLowGrayLevelEmphasis LowGrayLevelZoneEmphasis SizeZoneNonUniformity
        SizeZoneNonUniformityNormalized SmallAreaEmphasis SmallAreaHighGrayLevelEmphasis
        SmallAreaLowGrayLevelEmphasis ZoneEntropy ZonePercentage ZoneVariance""",
}
MEAN, VARIANCE = "original_firstorder_Mean", "original_firstorder_Variance"
FEATURES = tuple(f"original_{family}_{name}" for family, names in NAMES.items() for name in names.split())


# Every voxel has one dependence, so the GLDM summed over dependences is the histogram of gray levels.
HISTOGRAM_ONLY = tuple(
    f"original_gldm_{name}"
    for name in ("GrayLevelNonUniformity", "GrayLevelVariance", "HighGrayLevelEmphasis", "LowGrayLevelEmphasis")
)
# Feature classes of pyradiomics that are not among the 86 features.
OTHER_FAMILIES = {"ngtdm": "NGTDM", "shape": "shape", "shape2D": "shape in 2D"}
EVERY_FAMILY = FAMILIES | OTHER_FAMILIES
# Image type (original, wavelet-LLH, log-sigma-1-0-mm-3D, ...), class, name: as pyradiomics joins them.
PATTERN = re.compile(rf"[^_\s]+_({'|'.join(EVERY_FAMILY)})_[^_\s]+")


def is_feature(name: str) -> bool:
    """Return whether a name has the form that pyradiomics gives to features."""
    return PATTERN.fullmatch(str(name)) is not None


def features_of(table: pd.DataFrame) -> list[str]:
    """List the columns of a table that are features."""
    return [name for name in table.columns if is_feature(name)]


def family(feature: str) -> str:
    """Return the display name of the family of a feature, such as GLCM."""
    return EVERY_FAMILY[feature.split("_")[1]]


def unfiltered(feature: str) -> str:
    """Return the name of the same feature of the original image."""
    return f"original_{feature.partition('_')[2]}"
