"""What of a parameter file that pyradiomics accepts cannot be done here, and what in it changes nothing."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from .settings import CHANGES, ONLY_WITH, UNSTATED

# Values that are text; all others are numbers, truth values or lists of numbers. pyradiomics' schema takes "5" for 5.
TEXT = frozenset({"interpolator", "resegmentMode", "wavelet", "lbp2DMethod", "weightingNorm"})
# Read once, before filters: pyradiomics passes over them in the section of an image type.
OF_ALL_IMAGES = frozenset(
    "minimumROIDimensions minimumROISize geometryTolerance correctMask additionalInfo normalize normalizeScale "
    "removeOutliers resampledPixelSpacing interpolator padDistance resegmentRange resegmentMode resegmentShape "
    "preCrop label label_channel".split()
)
# Regions are masks on the image's own voxels, and one at a time: these choose or repair nothing, and no value changes.
OF_FILES = frozenset("geometryTolerance correctMask additionalInfo label label_channel preCrop".split())
USUAL = {**UNSTATED, "correctMask": False, "additionalInfo": False, "label": 1, "label_channel": 0}  # not worth a line
# Settings of one filter.
FILTER = {
    **dict.fromkeys(("sigma",), "LoG"),
    **dict.fromkeys(("start_level", "level", "wavelet"), "Wavelet"),
    "gradientUseSpacing": "Gradient",
    **dict.fromkeys(("lbp2DRadius", "lbp2DSamples", "lbp2DMethod"), "LBP2D"),
    **dict.fromkeys(("lbp3DLevels", "lbp3DIcosphereRadius", "lbp3DIcosphereSubdivision"), "LBP3D"),
}
# Co-occurrence matrices of 13 directions have bins^2 numbers of 8 bytes each: 2,000 bins take 0.4 GB.
MOST_BINS = 2000


def refused(content: Mapping, flat: bool) -> Iterator[str]:
    """A line for each key that pyradiomics accepts and that cannot be done.

    Parameters
    ----------
    content : mapping
        As pyradiomics' schema accepts it.
    flat : bool
        Whether regions are slices, in 2D.

    Yields
    ------
    str
        The key, why, and what to do.
    """
    settings, types = content.get("setting") or {}, content.get("imageType") or {}
    for where, section in (("setting", settings), *((f"imageType.{name}", own or {}) for name, own in types.items())):
        for key, value in section.items():
            yield from _number(f"{where}.{key}", key, value)
            if where != "setting" and key in OF_ALL_IMAGES:
                yield f"{where}.{key} is passed over by pyradiomics, which reads it under setting only; move it there"
        if (section.get("binCount") or 0) > MOST_BINS:
            yield f"{where}.binCount is {section['binCount']}, which needs too much memory; give {MOST_BINS} at most"
        if section.get("distances") == []:
            yield f"{where}.distances is empty; give distances in voxels, such as [1], or take it out"
    dimensions, spacing = 2 if flat else 3, settings.get("resampledPixelSpacing")
    if isinstance(spacing, list) and len(spacing) != dimensions:
        of = "slices (features.section: largest)" if flat else "volumes"
        yield f"setting.resampledPixelSpacing has {len(spacing)} entries; give {dimensions}, as regions are {of}"
    span = settings.get("resegmentRange")
    if isinstance(span, list) and len(span) not in (1, 2):
        yield f"setting.resegmentRange has {len(span)} entries; give the lower threshold, or lower and upper"
    if settings.get("resegmentMode") == "relative" and any(one > 1 for one in span or []):
        yield "setting.resegmentRange holds shares of the maximum where resegmentMode is relative; give 0 to 1"
    classes = content.get("featureClass") or {}
    if "shape2D" in classes and not flat:
        yield "featureClass.shape2D needs regions of one slice; use shape, or features.section: largest"
    if "shape" in classes and flat:
        yield "featureClass.shape needs volumes; use shape2D, or features.section: whole"
    if content.get("voxelSetting"):
        yield "voxelSetting is of feature maps, which are not made here; take it out"


def idle(content: Mapping) -> Iterator[str]:
    """Each setting that a file states though it changes no value, with the reason.

    Parameters
    ----------
    content : mapping
        As pyradiomics' schema accepts it.
    """
    settings, types = content.get("setting") or {}, content.get("imageType") or {"Original": {}}
    stated = dict(settings) | {key: value for own in types.values() for key, value in (own or {}).items()}
    classes = content.get("featureClass") or {}
    features = [f"{name}_{one}" for name, own in classes.items() for one in own or ()]
    whole = [name for name, own in classes.items() if not own]
    for key, value in settings.items():
        if value == USUAL.get(key, math.nan):
            continue
        if key in OF_FILES:
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
        elif classes and key in CHANGES and not _changes(key, features, whole):
            yield f"{key} (no feature of the file depends on it)"


def _changes(key: str, features: list[str], whole: list[str]) -> bool:
    return any(
        part in whole
        or part.partition("_")[0] in whole
        or any(one == part or one.startswith(f"{part}_") for one in features)
        for part in CHANGES[key]
    )


def _number(where: str, key: str, value: object) -> Iterator[str]:
    """What pyradiomics' schema takes for a number and its code does not."""
    if key in TEXT:
        return
    for one in value if isinstance(value, list) else [value]:
        if isinstance(one, str):
            yield f"{where}: {one!r} is text to YAML; write a number, such as 10 or 1.0e+1"
        elif isinstance(one, float) and not math.isfinite(one):
            yield f"{where} is {one}; give a finite number"
