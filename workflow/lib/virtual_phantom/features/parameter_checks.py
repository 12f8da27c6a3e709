"""Checks of a pyradiomics parameter file: keys that are not supported, and settings that have no effect."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from .settings import CHANGES, DEFAULT_VALUES, ONLY_WITH

# Settings with text values. All others are numbers, booleans or lists of numbers; the schema of pyradiomics accepts
# "5" for 5.
TEXT = frozenset({"interpolator", "resegmentMode", "wavelet", "lbp2DMethod", "weightingNorm"})
# Settings that apply before filters. pyradiomics ignores them in the section of an image type.
BEFORE_FILTERS = frozenset(
    "minimumROIDimensions minimumROISize geometryTolerance correctMask additionalInfo normalize normalizeScale "
    "removeOutliers resampledPixelSpacing interpolator padDistance resegmentRange resegmentMode resegmentShape "
    "preCrop label label_channel".split()
)
# Settings about mask files. Here each region is one mask on the voxels of the image, so they have no effect.
FOR_MASK_FILES = frozenset("geometryTolerance correctMask additionalInfo label label_channel preCrop".split())
# Default values. No note if a file states them.
DEFAULTS = DEFAULT_VALUES | {"correctMask": False, "additionalInfo": False, "label": 1, "label_channel": 0}
# Image type that each setting of a filter needs.
FILTER = {
    "sigma": "LoG",
    **dict.fromkeys(("start_level", "level", "wavelet"), "Wavelet"),
    "gradientUseSpacing": "Gradient",
    **dict.fromkeys(("lbp2DRadius", "lbp2DSamples", "lbp2DMethod"), "LBP2D"),
    **dict.fromkeys(("lbp3DLevels", "lbp3DIcosphereRadius", "lbp3DIcosphereSubdivision"), "LBP3D"),
}
# Co-occurrence matrices in 13 directions hold bins^2 numbers of 8 bytes each: 2,000 bins take 0.4 GB.
MOST_BINS = 2000


def unsupported(content: Mapping, flat: bool) -> Iterator[str]:
    """Yield a message for each key that pyradiomics accepts and Virtual Phantom does not support.

    Parameters
    ----------
    content : mapping
        Valid by the schema of pyradiomics.
    flat : bool
        Regions are single slices, in 2D.
    """
    settings, types = content.get("setting") or {}, content.get("imageType") or {}
    for where, section in (
        ("setting", settings),
        *((f"imageType.{name}", section or {}) for name, section in types.items()),
    ):
        for key, value in section.items():
            yield from _number(f"{where}.{key}", key, value)
            if where != "setting" and key in BEFORE_FILTERS:
                yield f"{where}.{key} is ignored by pyradiomics, which reads it under setting only; move it there"
        if (section.get("binCount") or 0) > MOST_BINS:
            yield f"{where}.binCount is {section['binCount']}, which needs too much memory; give {MOST_BINS} at most"
        if section.get("distances") == []:
            yield f"{where}.distances is empty; give distances in voxels, such as [1], or remove it"
    dimensions, spacing = 2 if flat else 3, settings.get("resampledPixelSpacing")
    if isinstance(spacing, list) and len(spacing) != dimensions:
        kind = "slices (features.section: largest)" if flat else "volumes"
        yield f"setting.resampledPixelSpacing has {len(spacing)} entries; give {dimensions}, as regions are {kind}"
    limits = settings.get("resegmentRange")
    if isinstance(limits, list) and len(limits) not in (1, 2):
        yield f"setting.resegmentRange has {len(limits)} entries; give the lower threshold, or lower and upper"
    if settings.get("resegmentMode") == "relative" and any(limit > 1 for limit in limits or []):
        yield "setting.resegmentRange holds fractions of the maximum if resegmentMode is relative; give 0 to 1"
    classes = content.get("featureClass") or {}
    if "shape2D" in classes and not flat:
        yield "featureClass.shape2D needs regions of one slice; use shape, or features.section: largest"
    if "shape" in classes and flat:
        yield "featureClass.shape needs volumes; use shape2D, or features.section: whole"
    if content.get("voxelSetting"):
        yield "voxelSetting is for feature maps, which are not supported; remove it"


def without_effect(content: Mapping) -> Iterator[str]:
    """Yield each setting of a valid parameter file that changes no feature value, with the reason."""
    settings, types = content.get("setting") or {}, content.get("imageType") or {"Original": {}}
    stated = dict(settings) | {key: value for section in types.values() for key, value in (section or {}).items()}
    classes = content.get("featureClass") or {}
    features = [f"{family}_{name}" for family, names in classes.items() for name in names or ()]
    complete = [family for family, names in classes.items() if not names]  # classes with all their features
    for key, value in settings.items():
        if value == DEFAULTS.get(key, math.nan):
            continue
        if key in FOR_MASK_FILES:
            yield f"{key} (regions are masks on the image's own voxels)"
        elif (needs := ONLY_WITH.get(key)) and not stated.get(needs):
            yield f"{key} (without {needs})"
        elif key == "resegmentShape" and stated.get("resegmentRange") is None:
            yield f"{key} (without resegmentRange)"
        elif key == "resampledPixelSpacing" and "interpolator" in settings and settings["interpolator"] is None:
            yield f"{key} (without an interpolator)"
        elif key == "binWidth" and settings.get("binCount") is not None:
            yield f"{key} (with binCount)"
        elif key in FILTER and FILTER[key] not in types:
            yield f"{key} (without imageType {FILTER[key]})"
        elif classes and key in CHANGES and not _changes(key, features, complete):
            yield f"{key} (no feature of the file depends on it)"


def _changes(key: str, features: list[str], complete: list[str]) -> bool:
    """Return whether a setting changes any of the features or of the classes with all features."""
    return any(
        part in complete
        or part.partition("_")[0] in complete
        or any(feature == part or feature.startswith(f"{part}_") for feature in features)
        for part in CHANGES[key]
    )


def _number(where: str, key: str, value: object) -> Iterator[str]:
    """Yield a message for each value that the schema of pyradiomics accepts as a number and its code does not."""
    if key in TEXT:
        return
    for entry in value if isinstance(value, list) else [value]:
        if isinstance(entry, str):
            yield f"{where}: {entry!r} is text to YAML; write a number, such as 10 or 1.0e+1"
        elif isinstance(entry, float) and not math.isfinite(entry):
            yield f"{where} is {entry}; give a finite number"
