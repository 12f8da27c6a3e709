"""Check relations between the features of one region that every correct table satisfies.

They detect rows that are shifted by a column, swapped columns, and numbers without their decimal separator. Each
relation follows from the definitions of pyradiomics 3.0.1 (radiomics/firstorder.py, glcm.py, gldm.py, glrlm.py,
glszm.py, ngtdm.py, shape.py, shape2D.py). GLCM and GLRLM features are means over directions, so only relations that
also hold for means are used: linear ones, and inequalities by Jensen or Cauchy-Schwarz.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ..base.errors import InputError
from .names import features_of
from .settings import SETTINGS_COLUMN, read_extractions

DIGITS = 9  # numbers with at least this many decimals count as unrounded: the error is at most 5e-10
RELATIVE = 1e-6  # relative error in single precision: 2^-23 per operation, for a few operations
MOST = 1e12  # largest square of a gray level: a million levels; 16 bits in bins of width 1 give 65,536
BITS = 64.0  # largest entropy: no matrix has more than 2^64 entries
DIRECTIONS = 13  # directions to neighbors in 3D: none of 13 positive numbers is above 13 times their mean
LARGEST_VOXEL, SMALLEST_VOXEL = 1e4, 1e-9  # volumes, mm^3: sides of 21 mm (PET has 4 mm) and of 1 um
LARGEST = 1e60  # largest feature: the energy of 1e9 voxels and the fourth power of a million levels are below 1e30
CANDIDATES = 50  # rows from which shifts of gray values are proposed


@dataclass(frozen=True)
class Terms:
    """A value per row of a table, with the largest error that rounding in the file can have caused."""

    value: np.ndarray
    error: np.ndarray

    def __add__(self, other: Terms | float) -> Terms:
        other = _terms(other)
        return Terms(self.value + other.value, self.error + other.error)

    def __sub__(self, other: Terms | float) -> Terms:
        other = _terms(other)
        return Terms(self.value - other.value, self.error + other.error)

    def __rsub__(self, other: float) -> Terms:
        return _terms(other) - self

    def __mul__(self, other: Terms | float) -> Terms:
        other = _terms(other)
        error = abs(self.value) * other.error + abs(other.value) * self.error + self.error * other.error
        return Terms(self.value * other.value, error)

    def __rmul__(self, other: float) -> Terms:
        return self * other

    def __truediv__(self, other: Terms) -> Terms:
        with np.errstate(divide="ignore", invalid="ignore"):
            least = np.where(abs(other.value) > other.error, abs(other.value) - other.error, 0)
            value = self.value / other.value
            return Terms(value, (self.error + abs(value) * other.error) / least)

    def through(self, function: Callable[[np.ndarray], np.ndarray]) -> Terms:
        """Apply a monotonic function."""
        with np.errstate(divide="ignore", invalid="ignore"):
            value = function(self.value)
            ends = [abs(function(self.value + sign * self.error) - value) for sign in (-1, 1)]
        return Terms(value, np.fmax(*ends))


@dataclass(frozen=True)
class Relation:
    """Relation low <= high, or low = high if `equal`. If `usual`, it is only checked if most rows satisfy it."""

    text: str
    low: Terms
    high: Terms
    equal: bool = False
    usual: bool = False

    def broken(self) -> np.ndarray:
        """Mark the rows that break the relation by more than rounding explains."""
        with np.errstate(invalid="ignore"):
            size = np.maximum(abs(self.low.value), abs(self.high.value))
            tolerance = self.low.error + self.high.error + RELATIVE * size + 10.0**-DIGITS
            difference = self.low.value - self.high.value
            return (abs(difference) if self.equal else difference) > tolerance


def check(table: pd.DataFrame, source: str) -> None:
    """Check that the features of every row can belong to one region.

    Parameters
    ----------
    table : DataFrame
        Numeric features under the names of pyradiomics, indexed by row number in the file. NaN entries and missing
        features are ignored.
    source : str
        Start of messages.

    Raises
    ------
    InputError
        If a row breaks a relation or a number is beyond LARGEST.
    """
    names = features_of(table)
    if not names or table.empty:
        return
    values = table[names].to_numpy(dtype=np.float64)
    if (huge := np.isfinite(values) & (np.abs(values) > LARGEST)).any():
        row, column = np.argwhere(huge)[0]
        raise InputError(
            f"{source}: row {table.index[row]}: {names[column]} is {values[row, column]:g}, which no image has"
        )
    values = np.where(np.abs(values) < 1 / LARGEST, 0.0, values)
    errors = rounding(values)
    types: dict[str, Features] = defaultdict(Features)
    for column, name in enumerate(names):
        kind, _, feature = name.partition("_")
        types[kind][feature] = Terms(values[:, column], errors[:, column])
    first: tuple[int, Relation, str] | None = None
    wrong = np.zeros(len(table), dtype=bool)
    with np.errstate(divide="ignore", invalid="ignore"):  # values that are not finite break no relation
        for kind, terms in types.items():
            for relation in relations(terms, _shift(table, terms, source), _voxels(table)):
                broken = relation.broken()
                known = np.isfinite(relation.low.value - relation.high.value)
                if not broken.any() or relation.usual and broken.sum() > known.sum() / 2:
                    continue
                row = int(broken.argmax())
                if first is None or row < first[0]:
                    first = row, relation, kind
                wrong |= broken
    if first is None:
        return
    row, relation, kind = first
    shown = [f"{side.value[row]:.6g}" for side in (relation.low, relation.high) if side.value.ndim]
    found = f"the values are {' and '.join(shown)}" if len(shown) > 1 else f"it is {shown[0]}"
    where = "" if kind == "original" else f" of {kind}"
    advice = "is the row shifted, or are columns mixed up?"
    if 1 < wrong.sum() > len(table) / 2:
        advice = f"{wrong.sum()} of {len(table)} rows are wrong: are columns mixed up, or features standardized "
        advice += "(z-scores, ComBat)?"
    raise InputError(f"{source}: row {table.index[row]} cannot be right: {relation.text}{where}, but {found}; {advice}")


def rounding(values: np.ndarray) -> np.ndarray:
    """Return a bound of the rounding error of every entry [row, feature], from the digits of its row and column.

    A table may be rounded to decimals or to significant digits, by column or by row. The precision of an entry is
    taken from the finest entry of its row or from the finest entry of its column, whichever is coarser.
    """
    finite = np.isfinite(values)
    size = np.where(finite & (values != 0), abs(values), 1.0)
    decimals = np.full(values.shape, DIGITS)
    for places in range(DIGITS - 1, -9, -1):
        decimals[np.round(values, places) == values] = places
    digits = np.where(finite & (values != 0), decimals + np.floor(np.log10(size)) + 1, 1)
    decimals = np.where(finite, decimals, -9)
    unit = np.minimum(decimals.max(axis=0), decimals.max(axis=1, keepdims=True))
    share = np.minimum(digits.max(axis=0), digits.max(axis=1, keepdims=True))
    with np.errstate(invalid="ignore"):
        return np.where(finite, np.maximum(0.5 * 10.0**-unit, 5.0 * 10.0**-share * abs(values)), 0.0)


class Features(dict[str, Terms]):
    """Features by name. Missing features are NaN, which breaks no relation."""

    def __missing__(self, name: str) -> Terms:
        return UNKNOWN

    def of(self, family: str) -> Features:
        """Return the features of one class, by their names without the class."""
        start = f"{family}_"
        return Features({name.removeprefix(start): term for name, term in self.items() if name.startswith(start)})


def _terms(value: Terms | float) -> Terms:
    return value if isinstance(value, Terms) else Terms(np.asarray(value, dtype=np.float64), np.zeros(()))


UNKNOWN = _terms(np.nan)


def relations(features: Features, shift: np.ndarray | float, voxels: Terms) -> Iterator[Relation]:
    """Yield all relations between the features of one image type.

    Parameters
    ----------
    features : Features
        By feature name without image type, such as firstorder_Mean.
    shift : ndarray or float
        voxelArrayShift of every row; NaN if unknown.
    voxels : Terms
        Number of voxels of every region; UNKNOWN if it is not stated.
    """
    for text, low, high, *flags in (
        *_first_order(features.of("firstorder"), shift, voxels),
        *_bounds(features),
        *_glcm(features.of("glcm")),
        *(relation for family, names in MATRICES.items() for relation in _matrix(features.of(family), family, *names)),
        *_numbers_of_voxels(features, voxels),
        *_shape(features),
    ):
        yield Relation(text, _terms(low), _terms(high), *flags)


# Smallest and largest value of features by class; None: no limit. Limits also hold for means over directions.
BOUNDS = (
    ("firstorder", 0, None, "Variance StandardDeviation Energy TotalEnergy RootMeanSquared"),
    ("firstorder", 0, BITS, "Entropy"),
    ("firstorder", 0, 1, "Uniformity"),
    ("firstorder", 0, None, "MeanAbsoluteDeviation RobustMeanAbsoluteDeviation InterquartileRange"),
    ("glcm", 1, MOST, "Autocorrelation JointAverage"),
    ("glcm", 2, MOST, "SumAverage"),
    ("glcm", 0, MOST, "ClusterTendency"),
    ("glcm", 0, None, "ClusterProminence"),
    ("glcm", 0, MOST, "Contrast SumSquares"),
    ("glcm", -1, 1, "Correlation"),
    ("glcm", 0, MOST, "DifferenceAverage DifferenceVariance"),
    ("glcm", 0, BITS, "DifferenceEntropy JointEntropy SumEntropy"),
    ("glcm", 0, 1, "JointEnergy MaximumProbability"),
    ("glcm", -1, 0, "Imc1"),
    ("glcm", 0, 1, "Imc2 MCC InverseVariance Id Idm"),
    ("glcm", 0.5, 1, "Idn Idmn"),  # |i - j| / Ng is below 1
    ("ngtdm", 0, 1e6, "Coarseness"),  # 1e6: value that pyradiomics gives for a uniform region
    ("ngtdm", 0, None, "Contrast Busyness Complexity Strength"),
    ("shape", 0, None, "MeshVolume VoxelVolume SurfaceArea SurfaceVolumeRatio LeastAxisLength Sphericity"),
    ("shape", 0, 1, "Elongation Flatness"),
    ("shape2D", 0, None, "MeshSurface PixelSurface Perimeter PerimeterSurfaceRatio"),
    ("shape2D", 0, 1, "Sphericity Elongation"),
)
# Parts of feature names of matrices of gray levels i >= 1 and counts j >= 1 (dependences, run lengths, zone sizes).
# They are the kind of count, prefixes for small and large j, infix of level emphases, prefix of non-uniformities, and
# the percentage.
MATRICES = {
    "gldm": ("Dependence", "SmallDependence", "LargeDependence", "", "Dependence", None),
    "glrlm": ("Run", "ShortRun", "LongRun", "Run", "RunLength", "RunPercentage"),
    "glszm": ("Zone", "SmallArea", "LargeArea", "Zone", "SizeZone", "ZonePercentage"),
}


def _within(name: str, value: Terms, low: float | None, high: float | None) -> Iterator[tuple]:
    if low is not None:
        yield f"{name} is at least {low:g}", low, value
    if high is not None:
        yield f"{name} is at most {high:g}", value, high


def _bounds(features: Features) -> Iterator[tuple]:
    for family, low, high, names in BOUNDS:
        for name in names.split():
            yield from _within(f"{family}_{name}", features[f"{family}_{name}"], low, high)


def _first_order(first: Features, shift: np.ndarray | float, voxels: Terms) -> Iterator[tuple]:
    order = ("Minimum", "10Percentile", "Median", "90Percentile", "Maximum")
    present = [name for name in order if name in first]
    for low, high in [*zip(present, present[1:], strict=False), ("Minimum", "Mean"), ("Mean", "Maximum")]:
        yield f"{low} is at most {high}", first[low], first[high]
    least, mean, median, most = (first[name] for name in ("Minimum", "Mean", "Median", "Maximum"))
    spread, variance = first["Range"], first["Variance"]
    between = first["90Percentile"] - first["10Percentile"]
    yield "Range is Maximum - Minimum", spread, most - least, True
    for name in ("MeanAbsoluteDeviation", "InterquartileRange"):
        yield f"{name} is at most Range", first[name], spread
    yield "InterquartileRange is at most 90Percentile - 10Percentile", first["InterquartileRange"], between
    # extreme case: half of the values at each end of the interval
    text = "RobustMeanAbsoluteDeviation is at most half of 90Percentile - 10Percentile"
    yield text, first["RobustMeanAbsoluteDeviation"], 0.5 * between
    deviation = first["MeanAbsoluteDeviation"]
    yield "MeanAbsoluteDeviation^2 is at most Variance", deviation * deviation, variance
    sd = first["StandardDeviation"]
    yield "StandardDeviation^2 is Variance", sd * sd, variance, True
    yield "(Mean - Median)^2 is at most Variance", (mean - median) * (mean - median), variance
    text = "Variance is at most (Maximum - Mean)(Mean - Minimum)"  # Bhatia and Davis, 2000
    yield text, variance, (most - mean) * (mean - least)
    yield "Variance is at most Range^2 / 4", variance, 0.25 * (spread * spread)
    kurtosis, skewness = first["Kurtosis"], first["Skewness"]
    # Pearson, 1916. Both are 0 if all voxels are equal, and only rounding errors if they nearly are.
    uneven = variance.value > variance.error + RELATIVE * (1 + abs(variance.value))
    if "Mean" in first:
        uneven &= variance.value > RELATIVE**2 * mean.value**2
    low = Terms(np.where(uneven, 1 + skewness.value**2, -np.inf), (skewness * skewness).error)
    yield "Kurtosis is at least 1 + Skewness^2 (3 is not subtracted)", low, kurtosis
    if "Skewness" in first:
        far = (most - mean) + (mean - least)  # at least the distance from the mean to the farther end
        high = far * far / variance
        high = Terms(np.where(uneven, high.value, np.inf), high.error)
        yield "Kurtosis is at most Range^2 / Variance", kurtosis, high
    energy, total, root = first["Energy"], first["TotalEnergy"], first["RootMeanSquared"]
    volume = "TotalEnergy / Energy, the volume of a voxel in mm^3,"
    yield f"{volume} is at most {LARGEST_VOXEL:g}", total, LARGEST_VOXEL * energy
    yield f"{volume} is at least {SMALLEST_VOXEL:g}", SMALLEST_VOXEL * energy, total
    yield "Entropy is at least -log2(Uniformity)", -1.0 * first["Uniformity"].through(np.log2), first["Entropy"]
    moved = mean + shift
    offset = "(Mean + voxelArrayShift)" if np.any(np.nan_to_num(shift)) else "Mean"
    yield f"RootMeanSquared^2 is Variance + {offset}^2", root * root, variance + moved * moved, True
    yield "Energy is the number of voxels times RootMeanSquared^2", energy, voxels * (root * root), True, True


def _glcm(glcm: Features) -> Iterator[tuple]:
    for low, high in (
        ("Idm", "Id"),
        ("Id", "Idn"),
        ("Idm", "Idmn"),
        ("Idn", "Idmn"),
        ("JointEnergy", "MaximumProbability"),
        ("SumEntropy", "JointEntropy"),
        ("DifferenceEntropy", "JointEntropy"),
        ("InverseVariance", "DifferenceAverage"),
        ("DifferenceAverage", "Contrast"),  # |i - j| is a whole number
    ):
        yield f"glcm_{low} is at most glcm_{high}", glcm[low], glcm[high]
    most, energy, entropy = glcm["MaximumProbability"], glcm["JointEnergy"], glcm["JointEntropy"]
    contrast, difference, square = glcm["Contrast"], glcm["DifferenceAverage"], glcm["SumSquares"]
    tendency, shade, prominence = glcm["ClusterTendency"], glcm["ClusterShade"], glcm["ClusterProminence"]
    mean, product = glcm["JointAverage"], glcm["Autocorrelation"]
    yield "glcm_MaximumProbability^2 is at most glcm_JointEnergy", most * most, energy
    yield "glcm_JointEntropy is at least -log2(glcm_JointEnergy)", -1.0 * energy.through(np.log2), entropy
    # i + j, |i - j| and the sign of i - j (one bit) determine i and j
    text = "glcm_JointEntropy is at most glcm_SumEntropy + glcm_DifferenceEntropy + 1"
    yield text, entropy, glcm["SumEntropy"] + glcm["DifferenceEntropy"] + 1
    text = "glcm_DifferenceVariance is at most glcm_Contrast - glcm_DifferenceAverage^2"
    yield text, glcm["DifferenceVariance"], contrast - difference * difference
    yield "glcm_ClusterTendency^2 is at most glcm_ClusterProminence", tendency * tendency, prominence
    text = "glcm_ClusterShade^2 is at most glcm_ClusterTendency glcm_ClusterProminence"
    yield text, shade * shade, tendency * prominence
    # The following relations hold for a symmetrical matrix.
    yield "glcm_SumAverage is twice glcm_JointAverage", glcm["SumAverage"], 2.0 * mean, True, True
    yield "glcm_ClusterTendency + glcm_Contrast is 4 glcm_SumSquares", tendency + contrast, 4.0 * square, True, True
    text = "glcm_Autocorrelation is at least glcm_JointAverage^2 + glcm_SumSquares - glcm_Contrast / 2"
    yield text, mean * mean + square - 0.5 * contrast, product, False, True
    if "Contrast" in glcm:
        text = f"glcm_Autocorrelation is at most {DIRECTIONS} glcm_JointAverage^2 + glcm_SumSquares"
        yield text, product, DIRECTIONS * (mean * mean) + square, False, True


def _matrix(
    matrix: Features, family: str, kind: str, small: str, large: str, of_levels: str, length: str, share: str | None
) -> Iterator[tuple]:
    """Yield relations between moments of the normalized entries p(i, j) of a matrix of levels i and counts j."""
    low, high = f"LowGrayLevel{of_levels}Emphasis", f"HighGrayLevel{of_levels}Emphasis"
    few, many = f"{small}Emphasis", f"{large}Emphasis"
    levels, lengths = "GrayLevelNonUniformity", f"{length}NonUniformity"

    def named(name: str) -> str:
        return f"{family}_{name}"

    for least, most, *names in (
        (0, 1, few, low, f"{small}LowGrayLevelEmphasis"),
        (1, None, many, high, f"{large}HighGrayLevelEmphasis"),
        (0, 1, f"{levels}Normalized", f"{lengths}Normalized"),
        (0, None, levels, lengths, "GrayLevelVariance", f"{kind}Variance"),
        (0, None, f"{small}HighGrayLevelEmphasis", f"{large}LowGrayLevelEmphasis"),
        (0, BITS, f"{kind}Entropy"),
        *([(0, 1, share)] if share else []),
    ):
        for name in names:
            yield from _within(named(name), matrix[name], least, most)
    for lower, upper in (
        (f"{small}LowGrayLevelEmphasis", few),
        (f"{small}LowGrayLevelEmphasis", low),
        (few, f"{small}HighGrayLevelEmphasis"),
        (f"{small}HighGrayLevelEmphasis", high),
        (low, f"{large}LowGrayLevelEmphasis"),
        (f"{large}LowGrayLevelEmphasis", many),
        (many, f"{large}HighGrayLevelEmphasis"),
        (high, f"{large}HighGrayLevelEmphasis"),
        (f"{levels}Normalized", levels),
        (f"{lengths}Normalized", lengths),
    ):
        yield f"{named(lower)} is at most {named(upper)}", matrix[lower], matrix[upper]
    for lower, upper in ((few, many), (low, high)):  # Cauchy-Schwarz
        yield f"{named(lower)} {named(upper)} is at least 1", 1.0, matrix[lower] * matrix[upper]
    for lower, upper in (("GrayLevelVariance", high), (f"{kind}Variance", many)):  # the mean is at least 1
        yield f"{named(lower)} is at most {named(upper)} - 1", matrix[lower], matrix[upper] - 1.0
    for name in (f"{levels}Normalized", f"{lengths}Normalized"):  # Shannon entropy is at least Renyi's of order 2
        text = f"{named(kind)}Entropy is at least -log2({named(name)})"
        yield text, -1.0 * matrix[name].through(np.log2), matrix[f"{kind}Entropy"]
    # The highest level occurs at least once, so its square is at most its emphasis times the number of entries.
    counted = lengths if family == "gldm" else levels
    text = f"{named(large)}HighGrayLevelEmphasis is at most {named(many)} {named(high)} times the entries counted"
    product = matrix[many] * matrix[high] * (matrix[counted] / matrix[f"{counted}Normalized"])
    yield text, matrix[f"{large}HighGrayLevelEmphasis"], (DIRECTIONS if family == "glrlm" else 1.0) * product
    if share:
        # The mean of j is the number of voxels divided by the number of runs or zones.
        equal = family == "glszm"
        text = f"{named(kind)}Variance is {'' if equal else 'at most '}{named(many)} - 1 / {named(share)}^2"
        inverse = _terms(1.0) / matrix[share]
        yield text, matrix[f"{kind}Variance"], matrix[many] - inverse * inverse, equal
    if family == "glszm":
        text = "glszm_GrayLevelNonUniformity glszm_SizeZoneNonUniformityNormalized is glszm_SizeZoneNonUniformity "
        text += "glszm_GrayLevelNonUniformityNormalized"  # both ratios are the number of zones
        first, second = (
            (matrix[levels], matrix[f"{levels}Normalized"]),
            (matrix[lengths], matrix[f"{lengths}Normalized"]),
        )
        yield text, first[0] * second[1], second[0] * first[1], True
        if levels in matrix and f"{levels}Normalized" in matrix:
            text = "glszm_ZoneEntropy is at most log2 of the number of zones"
            yield text, matrix["ZoneEntropy"], (second[0] / second[1]).through(np.log2)


def _numbers_of_voxels(features: Features, voxels: Terms) -> Iterator[tuple]:
    """Yield relations between families. A table that combines several extractions may break them in every row."""
    count = features["gldm_DependenceNonUniformity"] / features["gldm_DependenceNonUniformityNormalized"]
    root = features["firstorder_RootMeanSquared"]
    text = "Energy is RootMeanSquared^2 gldm_DependenceNonUniformity / gldm_DependenceNonUniformityNormalized"
    yield text, features["firstorder_Energy"], root * root * count, True, True
    text = "gldm_DependenceNonUniformity / gldm_DependenceNonUniformityNormalized is the number of voxels"
    yield text, count, voxels, True, True
    text = "gldm_GrayLevelNonUniformity is Uniformity times the number of voxels"
    yield text, features["gldm_GrayLevelNonUniformity"], features["firstorder_Uniformity"] * count, True, True
    text = "gldm_DependenceEntropy is at most log2 of the number of voxels"
    yield text, features["gldm_DependenceEntropy"], count.through(np.log2), False, True
    text = "glcm_ClusterProminence is at most 4 glcm_ClusterTendency times the square of the highest level"
    most = 4.0 * (features["glcm_ClusterTendency"] * features["gldm_HighGrayLevelEmphasis"] * count)
    yield text, features["glcm_ClusterProminence"], most, False, True
    text = "glszm_ZonePercentage is the number of zones divided by the number of voxels"
    zones = features["glszm_SizeZoneNonUniformity"] / features["glszm_SizeZoneNonUniformityNormalized"]
    yield text, zones, features["glszm_ZonePercentage"] * count, True, True
    for name in ("glrlm_GrayLevelNonUniformity", "glrlm_RunLengthNonUniformity"):
        text = f"{name} / {name}Normalized is at most the number of voxels"
        yield text, features[name], features[f"{name}Normalized"] * count, False, True


def _shape(features: Features) -> Iterator[tuple]:
    for family in ("shape", "shape2D"):
        shape = features.of(family)
        for low, high in (
            ("LeastAxisLength", "MinorAxisLength"),
            ("MinorAxisLength", "MajorAxisLength"),
            *((f"Maximum2DDiameter{plane}", "Maximum3DDiameter") for plane in ("Slice", "Column", "Row")),
            ("Flatness", "Elongation"),
        ):
            yield f"{family}_{low} is at most {family}_{high}", shape[low], shape[high]
        for ratio, part, whole in (
            ("Elongation", "MinorAxisLength", "MajorAxisLength"),
            ("Flatness", "LeastAxisLength", "MajorAxisLength"),
            ("SurfaceVolumeRatio", "SurfaceArea", "MeshVolume"),
            ("PerimeterSurfaceRatio", "Perimeter", "MeshSurface"),
        ):
            text = f"{family}_{ratio} is {family}_{part} / {family}_{whole}"
            yield text, shape[ratio] * shape[whole], shape[part], True
    sphericity, area, volume = (features[f"shape_{name}"] for name in ("Sphericity", "SurfaceArea", "MeshVolume"))
    text = "shape_Sphericity is (36 pi shape_MeshVolume^2)^(1/3) / shape_SurfaceArea"
    yield text, sphericity * area, (36 * np.pi * (volume * volume)).through(np.cbrt), True
    if "shape_SurfaceArea" in features and "shape_MeshVolume" in features:
        yield "shape_Sphericity is at most 1", sphericity, 1.0


def _voxels(table: pd.DataFrame) -> Terms:
    """Return the numbers of voxels that pyradiomics recorded, after any resampling and resegmentation."""
    for stage in ("resegmented", "interpolated", "original"):
        name = f"diagnostics_Mask-{stage}_VoxelNum"
        if name in table:
            values = pd.to_numeric(table[name], errors="coerce").to_numpy(dtype=np.float64)
            return Terms(values, np.zeros(len(values)))
    return UNKNOWN


def _shift(table: pd.DataFrame, terms: Mapping[str, Terms], source: str) -> np.ndarray:
    """Return voxelArrayShift of every row: as recorded in the table, or else one value that most rows agree with."""
    needed = [f"firstorder_{name}" for name in ("RootMeanSquared", "Mean", "Variance")]
    if any(name not in terms for name in needed):
        return np.full(len(table), np.nan)
    if SETTINGS_COLUMN in table:
        stated = read_extractions(table, source, table.index)
        shifts = [extraction and extraction.settings.get("voxelArrayShift") for extraction in stated]
        return np.array(
            [np.nan if found is None else _number(shift) for found, shift in zip(stated, shifts, strict=True)]
        )
    root, mean, variance = (terms[name] for name in needed)
    square = root * root
    with np.errstate(invalid="ignore"):
        size = np.sqrt(np.maximum(square.value - variance.value, 0))
    some = np.unique(np.linspace(0, len(table) - 1, CANDIDATES).astype(int))
    proposed = np.concatenate([[0.0], *(sign * size[some] - mean.value[some] for sign in (1, -1))])
    proposed = np.unique(np.round(proposed[np.isfinite(proposed)], 3))
    best, explained = 0.0, -1
    for shift in sorted(proposed, key=abs):  # the smallest of equally good shifts
        moved = mean + float(shift)
        number = int((~Relation("", square, variance + moved * moved, equal=True).broken()).sum())
        if number > explained:
            best, explained = float(shift), number
    return np.full(len(table), best)


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else 0.0
