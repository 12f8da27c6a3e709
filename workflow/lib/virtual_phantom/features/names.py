"""Names of the paper's 86 radiomics features, as pyradiomics has them, and of their families.

Apart from `extraction`, so that tables of features are handled without loading pyradiomics.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # heavy, and the workflow reads this in every job
    import pandas as pd

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


# Every voxel has one dependence, so that summed over dependences the matrix is the histogram of grey levels.
HISTOGRAM_ONLY = tuple(
    f"original_gldm_{name}"
    for name in ("GrayLevelNonUniformity", "GrayLevelVariance", "HighGrayLevelEmphasis", "LowGrayLevelEmphasis")
)
# Classes of pyradiomics that the study's 86 features are not of.
OTHER_FAMILIES = {"ngtdm": "NGTDM", "shape": "shape", "shape2D": "shape in 2D"}
EVERY_FAMILY = FAMILIES | OTHER_FAMILIES
# Image type (original, wavelet-LLH, log-sigma-1-0-mm-3D, ...), class, name: as pyradiomics joins them.
PATTERN = re.compile(rf"[^_\s]+_({'|'.join(EVERY_FAMILY)})_[^_\s]+")


def is_feature(name: str) -> bool:
    """Whether pyradiomics calls features so, of an original or of a filtered image."""
    return PATTERN.fullmatch(str(name)) is not None


def features_of(table: pd.DataFrame) -> list[str]:
    """The columns of a table that are features, in its order."""
    return [name for name in table.columns if is_feature(name)]


def family(feature: str) -> str:
    """Display name of a feature's family: first order, GLCM, GLDM, GLRLM, GLSZM, NGTDM or shape, filtered or not."""
    return EVERY_FAMILY[feature.split("_")[1]]


def unfiltered(feature: str) -> str:
    """The feature of the original image that a feature of a filtered one is alike."""
    return f"original_{feature.partition('_')[2]}"
