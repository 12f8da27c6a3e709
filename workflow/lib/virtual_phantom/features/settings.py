"""Settings of the extraction: defaults, settings recorded in a table, and their differences.

This module is separate from `extraction`, so that code that compares settings does not load pyradiomics.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import metadata

import pandas as pd

from ..base.errors import InputError
from ..io.yaml_files import read_yaml
from .names import FEATURES, HISTOGRAM_ONLY, LARGEST, WHOLE, unfiltered

# Settings of the default extraction.
SETTINGS = {
    "binWidth": 25,
    "normalize": False,
    "resampledPixelSpacing": None,
    "resegmentRange": None,
    "removeOutliers": None,
    "distances": [1],
    "force2D": False,
    "symmetricalGLCM": True,
    "weightingNorm": None,
    "gldm_a": 0,
    "voxelArrayShift": 0,
    "minimumROIDimensions": 1,
    "minimumROISize": None,
    "label": 1,
    "preCrop": False,
    "additionalInfo": False,
}

CUSTOM_PREFIX = "own-"  # prefix of the hash of settings that are not the default

# Columns in which pyradiomics records its settings.
SETTINGS_COLUMN = "diagnostics_Configuration_Settings"
TYPES_COLUMN = "diagnostics_Configuration_EnabledImageTypes"
VERSION_COLUMN = "diagnostics_Versions_PyRadiomics"
COLUMNS = (SETTINGS_COLUMN, TYPES_COLUMN, VERSION_COLUMN)
LONGEST = 20_000  # characters of a dictionary in a table; pyradiomics writes some hundreds

# Default values of pyradiomics 3.0.1 ("Customizing the Extraction").
DEFAULT_VALUES = {
    "wavelet": "coif1",
    "gradientUseSpacing": True,
    "preCrop": False,
    "binWidth": 25,
    "binCount": None,
    "normalize": False,
    "normalizeScale": 1,
    "removeOutliers": None,
    "resampledPixelSpacing": None,
    "interpolator": "sitkBSpline",
    "padDistance": 5,
    "resegmentRange": None,
    "resegmentMode": "absolute",
    "distances": [1],
    "force2D": False,
    "force2Ddimension": 0,
    "symmetricalGLCM": True,
    "weightingNorm": None,
    "gldm_a": 0,
    "voxelArrayShift": 0,
}
# Settings that have no effect unless another setting is on.
ONLY_WITH = {
    "normalizeScale": "normalize",
    "removeOutliers": "normalize",
    "interpolator": "resampledPixelSpacing",
    "padDistance": "resampledPixelSpacing",
    "resegmentMode": "resegmentRange",
    "force2Ddimension": "force2D",
}
# Settings that select or reject regions, or concern shapes, feature maps or filters. They do not change feature values
# of the original image.
HARMLESS = frozenset(
    "minimumROIDimensions minimumROISize geometryTolerance correctMask additionalInfo label label_channel preCrop "
    "resegmentShape voxelBased kernelRadius maskedKernel initValue voxelBatch sigma start_level level wavelet "
    "gradientUseSpacing lbp2DRadius lbp2DSamples lbp2DMethod lbp3DLevels lbp3DIcosphereRadius "
    "lbp3DIcosphereSubdivision enableCExtensions verbose".split()
)
# SimpleITK's numbers of interpolators, which pyradiomics accepts instead of names.
INTERPOLATORS = {1: "sitkNearestNeighbor", 2: "sitkLinear", 3: "sitkBSpline", 23: "sitkBSpline"}

TEXTURES = ("glcm", "gldm", "glrlm", "glszm", "ngtdm")
# Feature classes or features that a setting changes. Settings that are not listed change all.
CHANGES = {
    "binWidth": (*TEXTURES, "firstorder_Entropy", "firstorder_Uniformity"),
    "binCount": (*TEXTURES, "firstorder_Entropy", "firstorder_Uniformity"),
    "voxelArrayShift": ("firstorder_Energy", "firstorder_TotalEnergy", "firstorder_RootMeanSquared"),
    "distances": ("glcm", "gldm", "ngtdm"),
    # The other features depend on i + j, |i - j| or i j, which are the same for the transposed matrix.
    "symmetricalGLCM": (
        *("glcm_Correlation", "glcm_Imc1", "glcm_Imc2", "glcm_JointAverage", "glcm_JointEnergy", "glcm_JointEntropy"),
        *("glcm_MCC", "glcm_MaximumProbability", "glcm_SumSquares"),
    ),
    "weightingNorm": ("glcm", "glrlm"),
    "gldm_a": ("gldm",),
    "force2D": TEXTURES,
    "force2Ddimension": TEXTURES,
}
NEIGHBOR_SETTINGS = ("distances", "gldm_a", "force2D", "force2Ddimension")

# Image types by prefix of feature names.
TYPES = {
    "wavelet": "Wavelet",
    "log-sigma": "LoG",
    "squareroot": "SquareRoot",
    "square": "Square",
    "logarithm": "Logarithm",
    "exponential": "Exponential",
    "gradient": "Gradient",
    "lbp-2D": "LBP2D",
    "lbp-3D": "LBP3D",
}
# Settings of filters, which may also be given among the settings of all images.
FILTER_SETTINGS = frozenset(
    "wavelet gradientUseSpacing lbp2DRadius lbp2DSamples lbp2DMethod lbp3DLevels lbp3DIcosphereRadius "
    "lbp3DIcosphereSubdivision preCrop".split()
)
# Settings that feature names already contain.
IN_NAMES = ("sigma", "level", "start_level")


def image_type(feature: str) -> str:
    """Return the image type of a feature, as pyradiomics names it."""
    return next((name for start, name in TYPES.items() if feature.startswith(start)), "Original")


@dataclass(frozen=True)
class Extraction:
    """Settings of pyradiomics.

    Attributes
    ----------
    settings : mapping
        As given, without default values.
    image_types : mapping of str to mapping
        Settings of each image type, such as Original and Wavelet.
    version : str or None
        Version of pyradiomics; None if unknown.
    """

    settings: Mapping
    image_types: Mapping[str, Mapping] = field(default_factory=lambda: {"Original": {}})
    version: str | None = None

    def effective(self) -> dict:
        """Return {setting: value} of the settings that have an effect on the original image, with default values."""
        stated = {**self.settings, **(self.image_types.get("Original") or {})}
        values = {key: value for key, value in {**DEFAULT_VALUES, **stated}.items() if key not in HARMLESS}
        if isinstance(values["interpolator"], int):
            values["interpolator"] = INTERPOLATORS.get(values["interpolator"], values["interpolator"])
        spacing = values["resampledPixelSpacing"]
        if isinstance(spacing, list | tuple) and not any(spacing):  # 0 keeps an axis as it is
            values["resampledPixelSpacing"] = None
        if values["binCount"] is not None:
            del values["binWidth"]
        return {key: value for key, value in values.items() if key not in ONLY_WITH or _on(values[ONLY_WITH[key]])}


@dataclass(frozen=True)
class Difference:
    """A setting that differs between the study and a table.

    Attributes
    ----------
    study, table : object
        Values; None also if not set.
    image_type : str or None
        Image type that the setting applies to; None for all.
    """

    setting: str
    study: object
    table: object
    image_type: str | None = None

    def __str__(self) -> str:
        where = f"{self.image_type}: " if self.image_type else ""
        return f"{where}{self.setting} is {_shown(self.table)}, the study's {_shown(self.study)}"

    def changes(self, feature: str) -> bool:
        """Return whether the value of a feature depends on the setting."""
        if self.image_type is not None and image_type(feature) != self.image_type:
            return False
        if unfiltered(feature) in HISTOGRAM_ONLY and self.setting in NEIGHBOR_SETTINGS:
            return False
        kind = feature.partition("_")[2]
        parts = CHANGES.get(self.setting)
        return parts is None or any(kind == part or kind.startswith(f"{part}_") for part in parts)


STUDY = Extraction(SETTINGS)


def differences(study: Extraction, table: Extraction) -> list[Difference]:
    """List the settings that differ and can change feature values: of the original image, or of a filter of both."""
    first, second = study.effective(), table.effective()
    found = [Difference(key, first.get(key), second.get(key)) for key in sorted(first.keys() | second.keys())]
    for name in sorted(study.image_types.keys() & table.image_types.keys() - {"Original"}):
        filters = [extraction.image_types[name] or {} for extraction in (study, table)]
        first, second = ({**e.settings, **filter_} for e, filter_ in zip((study, table), filters, strict=True))
        keys = filters[0].keys() | filters[1].keys() | (FILTER_SETTINGS & (first.keys() | second.keys()))
        first, second = {**DEFAULT_VALUES, **first}, {**DEFAULT_VALUES, **second}
        found += [Difference(key, first.get(key), second.get(key), name) for key in sorted(keys - set(IN_NAMES))]
    return [difference for difference in found if difference.study != difference.table]


def read_extractions(table: pd.DataFrame, source: str, rows: Iterable[int] | None = None) -> list[Extraction | None]:
    """Read the settings of every row from the columns that pyradiomics writes; None if there are none.

    Parameters
    ----------
    source : str
        Start of messages.
    rows : iterable of int, optional
        Row numbers in the file; by default from 2 on, below the header.

    Raises
    ------
    InputError
        If a column does not hold what pyradiomics writes.
    """
    if SETTINGS_COLUMN not in table:
        return [None] * len(table)
    empty = pd.Series("", index=table.index)
    cells = zip(*(table.get(name, empty).fillna("").astype(str) for name in COLUMNS), strict=True)
    known: dict[tuple[str, str, str], Extraction | None] = {}
    found = []
    for row, texts in zip(range(2, len(table) + 2) if rows is None else rows, cells, strict=True):
        if texts not in known:
            known[texts] = _extraction(*texts, f"{source}: row {row}")
        found.append(known[texts])
    return found


def distinct_extractions(extractions: Iterable[Extraction | None]) -> list[Extraction]:
    """Return the extractions that differ in effective settings or version, without None."""
    found: list[Extraction] = []
    for extraction in extractions:
        if extraction is not None and all(
            extraction.effective() != other.effective() or extraction.version != other.version for other in found
        ):
            found.append(extraction)
    return found


def section_differences(section: str, dimensions: int, tables: Sequence[Extraction]) -> list[Difference]:
    """Return the difference between the sections of the regions: the study's, and those of a table.

    Parameters
    ----------
    section : {WHOLE, LARGEST}
        Section of the regions in the study.
    dimensions : {2, 3}
        Dimensions of the table. With 2, its regions are single slices, unless pyradiomics divided them (force2D).
    tables : sequence of Extraction
        Settings of the table; may be empty.
    """
    whole = dimensions == 3 or any(table.effective()["force2D"] for table in tables)
    other = WHOLE if whole else LARGEST
    return [] if section == other else [Difference("section", section, other)]


def describe_differences(
    study: Extraction,
    tables: Sequence[Extraction],
    features: Sequence[str] = FEATURES,
    sections: Sequence[Difference] = (),
) -> list[str]:
    """Describe every setting of tables that differs from the study's, with the number of features that it changes."""
    found = [*sections, *(difference for table in tables for difference in differences(study, table))]
    counts = {str(one): sum(one.changes(feature) for feature in features) for one in found}
    return [f"{line} (changes {changed} of {len(features)} features)" for line, changed in counts.items()]


def other_settings(
    features: Sequence[str],
    table: pd.DataFrame,
    study: Extraction = STUDY,
    source: str = "features",
    section: str = WHOLE,
    dimensions: int | None = None,
) -> dict[str, str]:
    """Return {feature: settings that differ from the study's, joined by semicolons} of a table.

    Parameters
    ----------
    table : DataFrame
        With the columns in which pyradiomics records its settings; without them, no settings are compared.
    source : str, optional
        Start of messages about those columns.
    section, dimensions : optional
        See `section_differences`; None for features of the study's own sections.
    """
    extractions = distinct_extractions(read_extractions(table, source))
    found = [difference for extraction in extractions for difference in differences(study, extraction)]
    if dimensions is not None:
        found += section_differences(section, dimensions, extractions)
    texts = {name: "; ".join(dict.fromkeys(str(item) for item in found if item.changes(name))) for name in features}
    return {name: text for name, text in texts.items() if text}


def read_extraction(path: str | None) -> Extraction:
    """Read the settings of a checked parameter file of pyradiomics; the default if None."""
    if path is None:
        return STUDY
    content = read_yaml(path, "give a parameter file of pyradiomics", restore="restore it")
    types = {name: section or {} for name, section in (content.get("imageType") or {"Original": {}}).items()}
    return Extraction(content.get("setting") or {}, types, installed_version())


def installed_version() -> str:
    """Return the installed version of pyradiomics, as it writes it into tables."""
    return f"v{metadata.version('pyradiomics')}"


def _extraction(settings: str, image_types: str, version: str, source: str) -> Extraction | None:
    if not settings:
        return None
    types = _dictionary(image_types, TYPES_COLUMN, source) if image_types else {"Original": {}}
    return Extraction(_dictionary(settings, SETTINGS_COLUMN, source), types, version or None)


def _dictionary(text: str, column: str, source: str) -> dict:
    try:
        found = ast.literal_eval(text) if len(text) <= LONGEST else None
    except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError):
        found = None
    inner = found.values() if column == TYPES_COLUMN and isinstance(found, dict) else ()
    named = isinstance(found, dict) and all(isinstance(key, str) for key in found)
    if not named or not all(isinstance(section, dict) for section in inner):
        raise InputError(
            f"{source}: {column} holds {text[:40]!r}, not a dictionary as pyradiomics writes it; restore it, or remove "
            "the column"
        )
    return found


def _on(value) -> bool:
    return value is not None and value is not False


def _shown(value) -> str:
    return "not set" if value is None else str(value)
