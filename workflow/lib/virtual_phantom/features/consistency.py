"""Relations between the features of one region that any correct table satisfies.

They show rows that are shifted by a column, columns that are swapped, and numbers that lost their decimal sign. Each
follows from the definitions of pyradiomics 3.0.1 (radiomics/firstorder.py, glcm.py, gldm.py, glrlm.py, glszm.py,
ngtdm.py, shape.py, shape2D.py). Features of the GLCM and GLRLM are means over directions, so only relations that
survive a mean are used: linear ones, and inequalities by Jensen or Cauchy-Schwarz.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ..base.errors import InputError
from .names import features_of
from .settings import SETTINGS_COLUMN, of_table

DIGITS = 9  # decimals from which on a number counts as unrounded: its error is then at most 5e-10
RELATIVE = 1e-6  # error of programs in single precision: 2^-23 per operation, for a few operations
MOST = 1e12  # largest square of a gray level: a million levels, when 16 bits in bins of 1 have 65,536
BITS = 64.0  # largest entropy: no matrix has more than 2^64 entries
DIRECTIONS = 13  # of neighbors in 3D: of as many positive numbers, none is above 13 times the mean
LARGEST_VOXEL, SMALLEST_VOXEL = 1e4, 1e-9  # mm^3: of 21 mm (PET has 4) and of 1 um
LARGEST = 1e60  # of any feature: the energy of 1e9 voxels and the fourth power of a million levels are below 1e30
CANDIDATES = 50  # rows that propose a shift of grey values


@dataclass(frozen=True)
class Terms:
    """Values of one row per entry, each with the largest error that rounding in the file can have made."""

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
        """A monotonic function of the values."""
        with np.errstate(divide="ignore", invalid="ignore"):
            value = function(self.value)
            ends = [abs(function(self.value + sign * self.error) - value) for sign in (-1, 1)]
        return Terms(value, np.fmax(*ends))


@dataclass(frozen=True)
class Relation:
    """Two sides of which the first is at most, or equal to, the second; `usual`: only if most rows satisfy it."""

    text: str
    low: Terms
    high: Terms
    equal: bool = False
    usual: bool = False

    def broken(self) -> np.ndarray:
        """Rows that break the relation by more than rounding explains."""
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
        Features as numbers, under the names of pyradiomics; its index numbers the rows of the file. Entries that are
        NaN, and features that are missing, are passed over.
    source : str
        Beginning of the message.

    Raises
    ------
    InputError
        Naming the first row that breaks a relation, the relation, and its two sides, or a number beyond LARGEST.
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
    types: dict[str, dict[str, Terms]] = {}
    for place, name in enumerate(names):
        kind, _, feature = name.partition("_")
        types.setdefault(kind, {})[feature] = Terms(values[:, place], errors[:, place])
    first: tuple[int, Relation, str] | None = None
    wrong = np.zeros(len(table), dtype=bool)
    with np.errstate(divide="ignore", invalid="ignore"):  # what is not finite breaks no relation
        for kind, own in types.items():
            for relation in relations(own, _shift(table, own, source), _voxels(table)):
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
    sides = [side.value if side.value.ndim == 0 else side.value[row] for side in (relation.low, relation.high)]
    shown = [f"{side:.6g}" for side, of in zip(sides, (relation.low, relation.high), strict=True) if of.value.ndim]
    found = f"the values are {' and '.join(shown)}" if len(shown) > 1 else f"it is {shown[0]}"
    where = "" if kind == "original" else f" of {kind}"
    advice = "is the row shifted, or are columns mixed up?"
    if 1 < wrong.sum() > len(table) / 2:
        advice = f"{wrong.sum()} of {len(table)} rows are wrong: are columns mixed up, or features standardized "
        advice += "(z-scores, ComBat)?"
    raise InputError(f"{source}: row {table.index[row]} cannot be right: {relation.text}{where}, but {found}; {advice}")


def rounding(values: np.ndarray) -> np.ndarray:
    """Bound on the rounding error of every entry, from the digits that its row and its column have.

    A table may be rounded to decimals or to significant digits, column by column or row by row. So an entry counts as
    rounded as coarsely as the finest entry of its row, or of its column, whichever is coarser.

    Parameters
    ----------
    values : ndarray, shape (rows, features)
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


def relations(own: Mapping[str, Terms], shift: np.ndarray | float, voxels: Terms | None = None) -> Iterator[Relation]:
    """All relations between the features of one image type.

    Parameters
    ----------
    own : mapping of str to Terms
        By name without image type, such as firstorder_Mean.
    shift : ndarray or float
        The voxelArrayShift of every row, NaN where it is not known.
    voxels : Terms, optional
        Number of voxels of every region.
    """
    for text, low, high, equal, usual in _all(_Features(own, shift, voxels)):
        yield Relation(text, _terms(low), _terms(high), equal, usual)


class _Features:
    """Features by name, and what else is known of every row."""

    def __init__(self, own: Mapping[str, Terms], shift: np.ndarray | float, voxels: Terms | None):
        self.own, self.shift, self.voxels = own, shift, voxels

    def __call__(self, *names: str) -> list[Terms] | None:
        """Return these features, or None if one is missing."""
        return [self.own[name] for name in names] if all(name in self.own for name in names) else None


def _terms(value: Terms | float) -> Terms:
    return value if isinstance(value, Terms) else Terms(np.asarray(value, dtype=np.float64), np.zeros(()))


def _all(features: _Features) -> Iterator[tuple[str, Terms | float, Terms | float, bool, bool]]:
    """The fields of every Relation."""
    yield from _first_order(features)
    yield from _bounds(features)
    yield from _glcm(features)
    for family, names in MATRICES.items():
        yield from _matrix(features, family, *names)
    yield from _numbers_of_voxels(features)
    yield from _shape(features)


# Least and largest value of features by class; None: no limit. A mean over directions has the limits of one direction.
BOUNDS: dict[str, dict[str, tuple[float | None, float | None]]] = {
    "firstorder": {
        "Variance": (0, None),
        "StandardDeviation": (0, None),
        "Energy": (0, None),
        "TotalEnergy": (0, None),
        "RootMeanSquared": (0, None),
        "Entropy": (0, BITS),
        "Uniformity": (0, 1),
        "MeanAbsoluteDeviation": (0, None),
        "RobustMeanAbsoluteDeviation": (0, None),
        "InterquartileRange": (0, None),
    },
    "glcm": {
        "Autocorrelation": (1, MOST),
        "JointAverage": (1, MOST),
        "SumAverage": (2, MOST),
        "ClusterTendency": (0, MOST),
        "ClusterProminence": (0, None),
        "Contrast": (0, MOST),
        "SumSquares": (0, MOST),
        "Correlation": (-1, 1),
        "DifferenceAverage": (0, MOST),
        "DifferenceVariance": (0, MOST),
        "DifferenceEntropy": (0, BITS),
        "JointEntropy": (0, BITS),
        "SumEntropy": (0, BITS),
        "JointEnergy": (0, 1),
        "MaximumProbability": (0, 1),
        "Imc1": (-1, 0),
        "Imc2": (0, 1),
        "MCC": (0, 1),
        "InverseVariance": (0, 1),
        **dict.fromkeys(("Id", "Idm"), (0, 1)),
        # |i - j| / Ng is below 1
        **dict.fromkeys(("Idn", "Idmn"), (0.5, 1)),
    },
    "ngtdm": {
        "Coarseness": (0, 1e6),  # 1e6: what pyradiomics gives of a uniform region
        "Contrast": (0, None),
        "Busyness": (0, None),
        "Complexity": (0, None),
        "Strength": (0, None),
    },
    "shape": {
        **dict.fromkeys(
            ("MeshVolume", "VoxelVolume", "SurfaceArea", "SurfaceVolumeRatio", "LeastAxisLength", "Sphericity"),
            (0, None),
        ),
        "Elongation": (0, 1),
        "Flatness": (0, 1),
    },
    "shape2D": {
        **dict.fromkeys(("MeshSurface", "PixelSurface", "Perimeter", "PerimeterSurfaceRatio"), (0, None)),
        "Sphericity": (0, 1),
        "Elongation": (0, 1),
    },
}
# What follows counts j (dependences, runs, zones of a size) and levels i, both from 1: names of the emphasis of small
# and large j, of low and high i, of the four products, of non-uniformities, variances, entropy and percentage.
MATRICES = {
    "gldm": ("Dependence", "SmallDependence", "LargeDependence", "", "Dependence", None),
    "glrlm": ("Run", "ShortRun", "LongRun", "Run", "RunLength", "RunPercentage"),
    "glszm": ("Zone", "SmallArea", "LargeArea", "Zone", "SizeZone", "ZonePercentage"),
}


def _bounds(features: _Features) -> Iterator[tuple]:
    for family, names in BOUNDS.items():
        for name, (low, high) in names.items():
            if found := features(f"{family}_{name}"):
                if low is not None:
                    yield f"{family}_{name} is at least {low:g}", low, found[0], False, False
                if high is not None:
                    yield f"{family}_{name} is at most {high:g}", found[0], high, False, False


def _first_order(features: _Features) -> Iterator[tuple]:
    def first(*names: str) -> list[Terms] | None:
        return features(*(f"firstorder_{name}" for name in names))

    order = ("Minimum", "10Percentile", "Median", "90Percentile", "Maximum")
    there = [name for name in order if first(name)]
    for low, high in [*zip(there, there[1:], strict=False), ("Minimum", "Mean"), ("Mean", "Maximum")]:
        if found := first(low, high):
            yield f"{low} is at most {high}", *found, False, False
    if found := first("Range", "Maximum", "Minimum"):
        yield "Range is Maximum - Minimum", found[0], found[1] - found[2], True, False
    for low in ("MeanAbsoluteDeviation", "InterquartileRange"):
        if found := first(low, "Range"):
            yield f"{low} is at most Range", *found, False, False
    if found := first("InterquartileRange", "90Percentile", "10Percentile"):
        yield "InterquartileRange is at most 90Percentile - 10Percentile", found[0], found[1] - found[2], False, False
    if found := first("RobustMeanAbsoluteDeviation", "90Percentile", "10Percentile"):
        # of values within an interval, half at each of its ends
        text = "RobustMeanAbsoluteDeviation is at most half of 90Percentile - 10Percentile"
        yield text, found[0], 0.5 * (found[1] - found[2]), False, False
    if found := first("MeanAbsoluteDeviation", "Variance"):
        text = "MeanAbsoluteDeviation^2 is at most Variance"
        yield text, found[0] * found[0], found[1], False, False
    if found := first("StandardDeviation", "Variance"):
        yield "StandardDeviation^2 is Variance", found[0] * found[0], found[1], True, False
    if found := first("Mean", "Median", "Variance"):
        change = found[0] - found[1]
        yield "(Mean - Median)^2 is at most Variance", change * change, found[2], False, False
    if found := first("Variance", "Maximum", "Mean", "Minimum"):
        variance, most, mean, least = found
        text = "Variance is at most (Maximum - Mean)(Mean - Minimum)"  # Bhatia and Davis, 2000
        yield text, variance, (most - mean) * (mean - least), False, False
    if found := first("Variance", "Range"):
        yield "Variance is at most Range^2 / 4", found[0], 0.25 * (found[1] * found[1]), False, False
    if found := first("Kurtosis", "Skewness", "Variance"):
        kurtosis, skewness, variance = found
        # Pearson, 1916. Both are 0 where all voxels are equal, and rounding errors alone where they nearly are.
        uneven = variance.value > variance.error + RELATIVE * (1 + abs(variance.value))
        if mean := first("Mean"):
            uneven &= variance.value > RELATIVE**2 * mean[0].value ** 2
        low = Terms(np.where(uneven, 1 + skewness.value**2, -np.inf), (skewness * skewness).error)
        yield "Kurtosis is at least 1 + Skewness^2 (3 is not subtracted)", low, kurtosis, False, False
        if ends := first("Maximum", "Mean", "Minimum"):
            far = (ends[0] - ends[1]) + (ends[1] - ends[2])  # from the mean to the farther end, or more
            text = "Kurtosis is at most Range^2 / Variance"
            high = far * far / variance
            yield text, kurtosis, Terms(np.where(uneven, high.value, np.inf), high.error), False, False
    if found := first("TotalEnergy", "Energy"):
        volume = "TotalEnergy / Energy, the volume of a voxel in mm^3,"
        yield f"{volume} is at most {LARGEST_VOXEL:g}", found[0], LARGEST_VOXEL * found[1], False, False
        yield f"{volume} is at least {SMALLEST_VOXEL:g}", SMALLEST_VOXEL * found[1], found[0], False, False
    if found := first("Entropy", "Uniformity"):
        text = "Entropy is at least -log2(Uniformity)"
        yield text, -1.0 * found[1].through(np.log2), found[0], False, False
    if found := first("RootMeanSquared", "Mean", "Variance"):
        square, mean = found[0] * found[0], found[1] + features.shift
        text = "RootMeanSquared^2 is Variance + Mean^2"
        if np.any(np.nan_to_num(features.shift)):
            text = "RootMeanSquared^2 is Variance + (Mean + voxelArrayShift)^2"
        yield text, square, found[2] + mean * mean, True, False
    if (found := first("Energy", "RootMeanSquared")) and features.voxels is not None:
        text = "Energy is the number of voxels times RootMeanSquared^2"
        yield text, found[0], features.voxels * (found[1] * found[1]), True, True


def _glcm(features: _Features) -> Iterator[tuple]:
    def glcm(*names: str) -> list[Terms] | None:
        return features(*(f"glcm_{name}" for name in names))

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
        if found := glcm(low, high):
            yield f"glcm_{low} is at most glcm_{high}", *found, False, False
    if found := glcm("MaximumProbability", "JointEnergy"):
        text = "glcm_MaximumProbability^2 is at most glcm_JointEnergy"
        yield text, found[0] * found[0], found[1], False, False
    if found := glcm("JointEntropy", "JointEnergy"):
        text = "glcm_JointEntropy is at least -log2(glcm_JointEnergy)"
        yield text, -1.0 * found[1].through(np.log2), found[0], False, False
    if found := glcm("JointEntropy", "SumEntropy", "DifferenceEntropy"):
        # i + j, |i - j| and the sign of i - j, one bit, give i and j
        text = "glcm_JointEntropy is at most glcm_SumEntropy + glcm_DifferenceEntropy + 1"
        yield text, found[0], found[1] + found[2] + 1, False, False
    if found := glcm("DifferenceVariance", "Contrast", "DifferenceAverage"):
        text = "glcm_DifferenceVariance is at most glcm_Contrast - glcm_DifferenceAverage^2"
        yield text, found[0], found[1] - found[2] * found[2], False, False
    if found := glcm("ClusterTendency", "ClusterProminence"):
        text = "glcm_ClusterTendency^2 is at most glcm_ClusterProminence"
        yield text, found[0] * found[0], found[1], False, False
    if found := glcm("ClusterShade", "ClusterTendency", "ClusterProminence"):
        text = "glcm_ClusterShade^2 is at most glcm_ClusterTendency glcm_ClusterProminence"
        yield text, found[0] * found[0], found[1] * found[2], False, False
    # The following are of a symmetrical matrix.
    if found := glcm("SumAverage", "JointAverage"):
        yield "glcm_SumAverage is twice glcm_JointAverage", found[0], 2.0 * found[1], True, True
    if found := glcm("ClusterTendency", "Contrast", "SumSquares"):
        text = "glcm_ClusterTendency + glcm_Contrast is 4 glcm_SumSquares"
        yield text, found[0] + found[1], 4.0 * found[2], True, True
    if found := glcm("SumSquares", "Contrast", "JointAverage", "Autocorrelation"):
        square, contrast, mean, product = found
        text = "glcm_Autocorrelation is at least glcm_JointAverage^2 + glcm_SumSquares - glcm_Contrast / 2"
        yield text, mean * mean + square - 0.5 * contrast, product, False, True
        text = f"glcm_Autocorrelation is at most {DIRECTIONS} glcm_JointAverage^2 + glcm_SumSquares"
        yield text, product, DIRECTIONS * (mean * mean) + square, False, True


def _matrix(
    features: _Features, family: str, kind: str, small: str, large: str, of_levels: str, length: str, share: str | None
) -> Iterator[tuple]:
    """Relations of a matrix of levels i and counts j: moments of its normalized entries p(i, j)."""
    low, high = f"LowGrayLevel{of_levels}Emphasis", f"HighGrayLevel{of_levels}Emphasis"
    few, many = f"{small}Emphasis", f"{large}Emphasis"

    def own(*names: str) -> list[Terms] | None:
        return features(*(f"{family}_{name}" for name in names))

    def named(name: str) -> str:
        return f"{family}_{name}"

    within = {
        **dict.fromkeys((few, low, f"{small}LowGrayLevelEmphasis"), (0, 1)),
        **dict.fromkeys((many, high, f"{large}HighGrayLevelEmphasis"), (1, None)),
        **dict.fromkeys(("GrayLevelNonUniformityNormalized", f"{length}NonUniformityNormalized"), (0, 1)),
        **dict.fromkeys(("GrayLevelNonUniformity", f"{length}NonUniformity"), (0, None)),
        **dict.fromkeys(("GrayLevelVariance", f"{kind}Variance"), (0, None)),
        **dict.fromkeys((f"{small}HighGrayLevelEmphasis", f"{large}LowGrayLevelEmphasis"), (0, None)),
        f"{kind}Entropy": (0, BITS),
        **({share: (0, 1)} if share else {}),
    }
    for name, (least, most) in within.items():
        if found := own(name):
            if least is not None:
                yield f"{named(name)} is at least {least:g}", least, found[0], False, False
            if most is not None:
                yield f"{named(name)} is at most {most:g}", found[0], most, False, False
    for one, other in (
        (f"{small}LowGrayLevelEmphasis", few),
        (f"{small}LowGrayLevelEmphasis", low),
        (few, f"{small}HighGrayLevelEmphasis"),
        (f"{small}HighGrayLevelEmphasis", high),
        (low, f"{large}LowGrayLevelEmphasis"),
        (f"{large}LowGrayLevelEmphasis", many),
        (many, f"{large}HighGrayLevelEmphasis"),
        (high, f"{large}HighGrayLevelEmphasis"),
        ("GrayLevelNonUniformityNormalized", "GrayLevelNonUniformity"),
        (f"{length}NonUniformityNormalized", f"{length}NonUniformity"),
    ):
        if found := own(one, other):
            yield f"{named(one)} is at most {named(other)}", *found, False, False
    for one, other in ((few, many), (low, high)):
        if found := own(one, other):  # Cauchy-Schwarz
            yield f"{named(one)} {named(other)} is at least 1", 1.0, found[0] * found[1], False, False
    for one, other in (("GrayLevelVariance", high), (f"{kind}Variance", many)):
        if found := own(one, other):  # the mean is at least 1
            yield f"{named(one)} is at most {named(other)} - 1", found[0], found[1] - 1.0, False, False
    for name in ("GrayLevelNonUniformityNormalized", f"{length}NonUniformityNormalized"):
        if found := own(f"{kind}Entropy", name):  # Shannon entropy is at least Renyi's of order 2
            text = f"{named(kind)}Entropy is at least -log2({named(name)})"
            yield text, -1.0 * found[1].through(np.log2), found[0], False, False
    # The highest level occurs at least once, so its square is at most that emphasis times the number of entries.
    counted = f"{length}NonUniformity" if family == "gldm" else "GrayLevelNonUniformity"
    if found := own(f"{large}HighGrayLevelEmphasis", many, high, counted, f"{counted}Normalized"):
        text = f"{named(large)}HighGrayLevelEmphasis is at most {named(many)} {named(high)} times the entries counted"
        most = found[1] * found[2] * (found[3] / found[4])
        yield text, found[0], (DIRECTIONS if family == "glrlm" else 1.0) * most, False, False
    if share and (found := own(f"{kind}Variance", many, share)):
        # The mean of j is the number of voxels over that of runs or zones.
        equal = family == "glszm"
        text = f"{named(kind)}Variance is {'' if equal else 'at most '}{named(many)} - 1 / {named(share)}^2"
        inverse = _terms(1.0) / found[2]
        yield text, found[0], found[1] - inverse * inverse, equal, False
    number = own("GrayLevelNonUniformity", "GrayLevelNonUniformityNormalized")
    if family == "glszm" and number and (found := own(f"{length}NonUniformity", f"{length}NonUniformityNormalized")):
        text = "glszm_GrayLevelNonUniformity glszm_SizeZoneNonUniformityNormalized is glszm_SizeZoneNonUniformity "
        text += "glszm_GrayLevelNonUniformityNormalized"  # both ratios are the number of zones
        yield text, number[0] * found[1], found[0] * number[1], True, False
        if entropy := own("ZoneEntropy"):
            text = "glszm_ZoneEntropy is at most log2 of the number of zones"
            yield text, entropy[0], (found[0] / found[1]).through(np.log2), False, False


def _numbers_of_voxels(features: _Features) -> Iterator[tuple]:
    """Relations between families, which tables put together from several extractions may break in every row."""
    every = features("gldm_DependenceNonUniformity", "gldm_DependenceNonUniformityNormalized")
    if every is None:
        return
    count = every[0] / every[1]
    energy = features("firstorder_Energy", "firstorder_RootMeanSquared")
    if energy:
        text = "Energy is RootMeanSquared^2 gldm_DependenceNonUniformity / gldm_DependenceNonUniformityNormalized"
        yield text, energy[0], energy[1] * energy[1] * count, True, True
    if features.voxels is not None:
        text = "gldm_DependenceNonUniformity / gldm_DependenceNonUniformityNormalized is the number of voxels"
        yield text, count, features.voxels, True, True
    if found := features("gldm_GrayLevelNonUniformity", "firstorder_Uniformity"):
        text = "gldm_GrayLevelNonUniformity is Uniformity times the number of voxels"
        yield text, found[0], found[1] * count, True, True
    if found := features("gldm_DependenceEntropy"):
        text = "gldm_DependenceEntropy is at most log2 of the number of voxels"
        yield text, found[0], count.through(np.log2), False, True
    levels = features("gldm_HighGrayLevelEmphasis", "glcm_ClusterTendency", "glcm_ClusterProminence")
    if levels:
        text = "glcm_ClusterProminence is at most 4 glcm_ClusterTendency times the square of the highest level"
        yield text, levels[2], 4.0 * (levels[1] * levels[0] * count), False, True
    zones = features("glszm_SizeZoneNonUniformity", "glszm_SizeZoneNonUniformityNormalized", "glszm_ZonePercentage")
    if zones:
        text = "glszm_ZonePercentage is the number of zones over that of voxels"
        yield text, zones[0] / zones[1], zones[2] * count, True, True
    for name in ("GrayLevel", "RunLength"):
        if found := features(f"glrlm_{name}NonUniformity", f"glrlm_{name}NonUniformityNormalized"):
            text = f"glrlm_{name}NonUniformity / glrlm_{name}NonUniformityNormalized is at most the number of voxels"
            yield text, found[0], found[1] * count, False, True


def _shape(features: _Features) -> Iterator[tuple]:
    for family in ("shape", "shape2D"):

        def shape(*names: str, family: str = family) -> list[Terms] | None:
            return features(*(f"{family}_{name}" for name in names))

        for low, high in (
            ("LeastAxisLength", "MinorAxisLength"),
            ("MinorAxisLength", "MajorAxisLength"),
            *((f"Maximum2DDiameter{plane}", "Maximum3DDiameter") for plane in ("Slice", "Column", "Row")),
            ("Flatness", "Elongation"),
        ):
            if found := shape(low, high):
                yield f"{family}_{low} is at most {family}_{high}", *found, False, False
        for ratio, part, whole in (
            ("Elongation", "MinorAxisLength", "MajorAxisLength"),
            ("Flatness", "LeastAxisLength", "MajorAxisLength"),
            ("SurfaceVolumeRatio", "SurfaceArea", "MeshVolume"),
            ("PerimeterSurfaceRatio", "Perimeter", "MeshSurface"),
        ):
            if found := shape(ratio, part, whole):
                text = f"{family}_{ratio} is {family}_{part} / {family}_{whole}"
                yield text, found[0] * found[2], found[1], True, False
    if found := features("shape_Sphericity", "shape_SurfaceArea", "shape_MeshVolume"):
        sphericity, area, volume = found
        text = "shape_Sphericity is (36 pi shape_MeshVolume^2)^(1/3) / shape_SurfaceArea"
        yield text, sphericity * area, (36 * np.pi * (volume * volume)).through(np.cbrt), True, False
        yield "shape_Sphericity is at most 1", sphericity, 1.0, False, False


def _voxels(table: pd.DataFrame) -> Terms | None:
    """Numbers of voxels that pyradiomics wrote, after resampling and resegmentation."""
    for stage in ("resegmented", "interpolated", "original"):
        name = f"diagnostics_Mask-{stage}_VoxelNum"
        if name in table:
            values = pd.to_numeric(table[name], errors="coerce").to_numpy(dtype=np.float64)
            return Terms(values, np.zeros(len(values)))
    return None


def _shift(table: pd.DataFrame, own: Mapping[str, Terms], source: str) -> np.ndarray:
    """The voxelArrayShift of every row: as the table states it, else the one that explains most rows."""
    needed = [f"firstorder_{name}" for name in ("RootMeanSquared", "Mean", "Variance")]
    if any(name not in own for name in needed):
        return np.full(len(table), np.nan)
    if SETTINGS_COLUMN in table:
        stated = of_table(table, source, table.index)
        return np.array([np.nan if one is None else _number(one.settings.get("voxelArrayShift")) for one in stated])
    square, mean, variance = own[needed[0]] * own[needed[0]], own[needed[1]], own[needed[2]]
    with np.errstate(invalid="ignore"):
        size = np.sqrt(np.maximum(square.value - variance.value, 0))
    some = np.unique(np.linspace(0, len(table) - 1, CANDIDATES).astype(int))
    proposed = np.concatenate([[0.0], *(sign * size[some] - mean.value[some] for sign in (1, -1))])
    proposed = np.unique(np.round(proposed[np.isfinite(proposed)], 3))
    best, explained = 0.0, -1
    for shift in sorted(proposed, key=abs):  # of equally good ones, the smallest
        moved = mean + float(shift)
        number = int((~Relation("", square, variance + moved * moved, equal=True).broken()).sum())
        if number > explained:
            best, explained = float(shift), number
    return np.full(len(table), best)


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else 0.0
