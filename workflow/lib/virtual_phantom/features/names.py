"""Names of the paper's 86 radiomics features, as pyradiomics has them, and of their families.

Apart from `extraction`, so that tables of features are handled without loading pyradiomics.
"""

import re

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
OTHER_CLASSES = ("ngtdm", "shape", "shape2D")
# Image type (original, wavelet-LLH, log-sigma-1-0-mm-3D, ...), class, name: as pyradiomics joins them.
PATTERN = re.compile(rf"[^_\s]+_({'|'.join((*FAMILIES, *OTHER_CLASSES))})_[^_\s]+")


def is_feature(name: str) -> bool:
    """Whether pyradiomics calls features so, of an original or of a filtered image."""
    return PATTERN.fullmatch(str(name)) is not None


def family(feature: str) -> str:
    """Display name of a feature's family: first order, GLCM, GLDM, GLRLM or GLSZM."""
    return FAMILIES[feature.split("_")[1]]
