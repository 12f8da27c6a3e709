"""How features were extracted: the study's settings, those that a table tells of itself, and where they differ.

Apart from `extraction`, so that settings are compared without loading pyradiomics.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version

import pandas as pd

from ..base.errors import InputError
from ..io.yaml_files import read_yaml
from .names import FEATURES, HISTOGRAM_ONLY, unfiltered

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

OWN = "own-"  # begins the hash of settings that are not the study's default

# Columns in which pyradiomics tells how it was set.
SETTINGS_COLUMN = "diagnostics_Configuration_Settings"
TYPES_COLUMN = "diagnostics_Configuration_EnabledImageTypes"
VERSION_COLUMN = "diagnostics_Versions_PyRadiomics"
COLUMNS = (SETTINGS_COLUMN, TYPES_COLUMN, VERSION_COLUMN)
LONGEST = 20_000  # characters of a dictionary in a table; those of pyradiomics have some hundreds

# What pyradiomics takes for a setting that is not stated (3.0.1, "Customizing the Extraction").
UNSTATED = {
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
# Settings that do nothing unless another one is on.
ONLY_WITH = {
    "normalizeScale": "normalize",
    "removeOutliers": "normalize",
    "interpolator": "resampledPixelSpacing",
    "padDistance": "resampledPixelSpacing",
    "resegmentMode": "resegmentRange",
    "force2Ddimension": "force2D",
}
# They choose or refuse regions, or concern shapes, feature maps or filters: no value of the original image changes.
HARMLESS = frozenset(
    "minimumROIDimensions minimumROISize geometryTolerance correctMask additionalInfo label label_channel preCrop "
    "resegmentShape voxelBased kernelRadius maskedKernel initValue voxelBatch sigma start_level level wavelet "
    "gradientUseSpacing lbp2DRadius lbp2DSamples lbp2DMethod lbp3DLevels lbp3DIcosphereRadius "
    "lbp3DIcosphereSubdivision enableCExtensions verbose".split()
)
# SimpleITK's numbers of interpolators, which are allowed in place of names.
INTERPOLATORS = {1: "sitkNearestNeighbor", 2: "sitkLinear", 3: "sitkBSpline", 23: "sitkBSpline"}

TEXTURES = ("glcm", "gldm", "glrlm", "glszm", "ngtdm")
# Classes of features, or single ones, that a setting changes; one that is not here changes all.
CHANGES = {
    "binWidth": (*TEXTURES, "firstorder_Entropy", "firstorder_Uniformity"),
    "binCount": (*TEXTURES, "firstorder_Entropy", "firstorder_Uniformity"),
    "voxelArrayShift": ("firstorder_Energy", "firstorder_TotalEnergy", "firstorder_RootMeanSquared"),
    "distances": ("glcm", "gldm", "ngtdm"),
    # The others are of i + j, |i - j| or i j, which the transposed matrix has alike.
    "symmetricalGLCM": (
        *("glcm_Correlation", "glcm_Imc1", "glcm_Imc2", "glcm_JointAverage", "glcm_JointEnergy", "glcm_JointEntropy"),
        *("glcm_MCC", "glcm_MaximumProbability", "glcm_SumSquares"),
    ),
    "weightingNorm": ("glcm", "glrlm"),
    "gldm_a": ("gldm",),
    "force2D": TEXTURES,
    "force2Ddimension": TEXTURES,
}
OF_NEIGHBOURS = ("distances", "gldm_a", "force2D", "force2Ddimension")


# Image types by how names of their features begin.
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
# Settings of filters alone, which may stand among those of all images too.
FILTER_SETTINGS = frozenset(
    "wavelet gradientUseSpacing lbp2DRadius lbp2DSamples lbp2DMethod lbp3DLevels lbp3DIcosphereRadius "
    "lbp3DIcosphereSubdivision preCrop".split()
)
# Told by the names of features already.
IN_NAMES = ("sigma", "level", "start_level")


def image_type(feature: str) -> str:
    """The image type that a feature is of, as pyradiomics calls it."""
    return next((name for start, name in TYPES.items() if feature.startswith(start)), "Original")


@dataclass(frozen=True)
class Extraction:
    """Settings of pyradiomics.

    Attributes
    ----------
    settings : mapping
        As stated.
    image_types : mapping of str to mapping
        Settings of its own of every image type, such as Original and Wavelet.
    version : str or None
        Of pyradiomics; None where it is not known.
    """

    settings: Mapping
    image_types: Mapping[str, Mapping] = field(default_factory=lambda: {"Original": {}})
    version: str | None = None

    def effective(self) -> dict:
        """What each setting came to for the original image; those that do nothing are left out.

        Returns
        -------
        dict
            {setting: value}, comparable with those of another extraction.
        """
        stated = {**self.settings, **(self.image_types.get("Original") or {})}
        values = {key: value for key, value in {**UNSTATED, **stated}.items() if key not in HARMLESS}
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
        Its values; None also where it has none.
    of : str or None
        The image type that it is of alone; None for all.
    """

    setting: str
    study: object
    table: object
    of: str | None = None

    def __str__(self) -> str:
        where = f"{self.of}: " if self.of else ""
        return f"{where}{self.setting} is {_shown(self.table)}, the study's {_shown(self.study)}"

    def changes(self, feature: str) -> bool:
        """Whether a feature's value depends on the setting."""
        if self.of is not None and image_type(feature) != self.of:
            return False
        if unfiltered(feature) in HISTOGRAM_ONLY and self.setting in OF_NEIGHBOURS:
            return False
        kind = feature.partition("_")[2]
        parts = CHANGES.get(self.setting)
        return parts is None or any(kind == part or kind.startswith(f"{part}_") for part in parts)


STUDY = Extraction(SETTINGS)


def differences(study: Extraction, table: Extraction) -> list[Difference]:
    """Settings that make other values of features, of all images or of a filtered one that both have.

    Returns
    -------
    list of Difference
        In the order of the settings' names.
    """
    ours, theirs = study.effective(), table.effective()
    found = [
        Difference(key, ours.get(key), theirs.get(key))
        for key in sorted(ours.keys() | theirs.keys())
        if ours.get(key) != theirs.get(key)
    ]
    for name in sorted(study.image_types.keys() & table.image_types.keys() - {"Original"}):
        mine, others = ({**one.settings, **(one.image_types[name] or {})} for one in (study, table))
        own = (study.image_types[name] or {}).keys() | (table.image_types[name] or {}).keys()
        stated = own | (FILTER_SETTINGS & (mine.keys() | others.keys()))
        found += [
            Difference(key, mine.get(key, UNSTATED.get(key)), others.get(key, UNSTATED.get(key)), name)
            for key in sorted(stated - set(IN_NAMES))
            if mine.get(key, UNSTATED.get(key)) != others.get(key, UNSTATED.get(key))
        ]
    return found


def of_table(table: pd.DataFrame, source: str, rows: Iterable[int] | None = None) -> list[Extraction | None]:
    """How the features of every row of a table were extracted, as its own columns tell.

    Parameters
    ----------
    source : str
        What the message begins with.
    rows : iterable of int, optional
        Numbers of the rows in the file; absent: from 2 on, below the header.

    Returns
    -------
    list of Extraction or None
        Of every row; None where the table does not say.

    Raises
    ------
    InputError
        For a column that does not hold what pyradiomics writes.
    """
    if SETTINGS_COLUMN not in table:
        return [None] * len(table)
    empty = pd.Series("", index=table.index)
    cells = zip(*(table.get(name, empty).fillna("").astype(str) for name in COLUMNS), strict=True)
    known: dict[tuple[str, str, str], Extraction | None] = {}
    found = []
    for row, one in zip(range(2, len(table) + 2) if rows is None else rows, cells, strict=True):
        if one not in known:
            known[one] = _extraction(*one, f"{source}: row {row}")
        found.append(known[one])
    return found


def distinct(extractions: Iterable[Extraction | None]) -> list[Extraction]:
    """Those that are known, each once, in the order in which they come; a label alone makes no other."""
    found: list[Extraction] = []
    for one in extractions:
        if one is not None and all(
            one.effective() != other.effective() or one.version != other.version for other in found
        ):
            found.append(one)
    return found


def said(study: Extraction, tables: Sequence[Extraction], features: Sequence[str] = FEATURES) -> list[str]:
    """A line for every setting of tables that differs from the study's.

    Parameters
    ----------
    features : sequence of str, optional
        Of which to count those that the setting changes.
    """
    lines: dict[str, None] = {}
    for table in tables:
        for one in differences(study, table):
            changed = sum(one.changes(feature) for feature in features)
            lines[f"{one} (changes {changed} of {len(features)} features)"] = None
    return list(lines)


def other_settings(
    features: Sequence[str], table: pd.DataFrame, study: Extraction = STUDY, source: str = "features"
) -> dict[str, str]:
    """Features of a table that were extracted with other settings than the study's, and with which.

    Parameters
    ----------
    table : DataFrame
        With pyradiomics' columns about its settings; without them nothing is known and nothing is said.
    source : str, optional
        What messages about those columns begin with.

    Returns
    -------
    dict of str to str
        {feature: the settings, joined by semicolons}.
    """
    found = [one for own in distinct(of_table(table, source)) for one in differences(study, own)]
    texts = {name: "; ".join(dict.fromkeys(str(one) for one in found if one.changes(name))) for name in features}
    return {name: text for name, text in texts.items() if text}


def of_parameters(path: str | None) -> Extraction:
    """What a parameter file of pyradiomics that has been checked asks; the study's default for None."""
    if path is None:
        return STUDY
    content = read_yaml(path, "give a parameter file of pyradiomics", restore="restore it")
    types = {name: own or {} for name, own in (content.get("imageType") or {"Original": {}}).items()}
    return Extraction(content.get("setting") or {}, types, installed())


def installed() -> str:
    """The version of pyradiomics here, as it writes it into tables."""
    return f"v{version('pyradiomics')}"


def _extraction(settings: str, image_types: str, made_by: str, source: str) -> Extraction | None:
    if not settings:
        return None
    types = _dictionary(image_types, TYPES_COLUMN, source) if image_types else {"Original": {}}
    return Extraction(_dictionary(settings, SETTINGS_COLUMN, source), types, made_by or None)


def _dictionary(text: str, column: str, source: str) -> dict:
    try:
        found = ast.literal_eval(text) if len(text) <= LONGEST else None
    except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError):
        found = None
    inner = found.values() if column == TYPES_COLUMN and isinstance(found, dict) else ()
    whole = isinstance(found, dict) and all(isinstance(key, str) for key in found)
    if not whole or not all(isinstance(one, dict) for one in inner):
        raise InputError(
            f"{source}: {column} holds {text[:40]!r}, not a dictionary as pyradiomics writes it; restore it, or take "
            "the column out"
        )
    return found


def _on(value) -> bool:
    return value is not None and value is not False


def _shown(value) -> str:
    return "not set" if value is None else str(value)
