"""How features are extracted: the study's 86, or what a parameter file of pyradiomics asks.

Such a file means here what it means to the command `pyradiomics`: what it leaves out is as pyradiomics has it.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
import SimpleITK as sitk
from pykwalify.core import Core
from pykwalify.errors import PyKwalifyException
from radiomics import getFeatureClasses, getParameterValidationFiles
from radiomics.featureextractor import RadiomicsFeatureExtractor

from ..base.console import note
from ..base.errors import InputError, InputErrors
from ..base.streams import generator
from ..io.yaml_files import read_yaml
from .accepted import idle, refused
from .names import FEATURES, NAMES, is_feature
from .settings import OWN, SETTINGS, STUDY, Extraction, image_type, of_parameters

WHOLE, LARGEST = "whole", "largest"
ADVICE = "give a parameter file of pyradiomics under features.parameters"
SECTIONS = ("imageType", "featureClass", "setting")
# Where the names of features are asked for, on an image of noise: whatever could refuse it or its region is off.
PROBE_VOXELS = 32
PROBE_SPACING_MM = 10.0  # LoG passes over images that are narrow beside its sigma
PROBE = {
    "resampledPixelSpacing": None,
    "normalize": False,
    "resegmentRange": None,
    "minimumROISize": None,
    "minimumROIDimensions": 1,
    "binWidth": 25,
    "binCount": None,
    "distances": [1],
}


@dataclass(frozen=True, eq=False)
class Parameters:
    """Settings, image types and classes of features.

    Attributes
    ----------
    extraction : Extraction
        Settings, and those of every image type.
    classes : dict of str to list of str
        Names by class of features; an empty list for all of a class that are not outdated.
    source : str or None
        The file; None for the study's default.
    section : {"whole", "largest"}
        Of each region: all of it, in 3D, or its slice with the most voxels, in 2D with pixels 1 long.
    stored_offset_hu : float
        What is added to HU before.
    """

    extraction: Extraction
    classes: dict[str, list[str]]
    source: str | None = None
    section: str = WHOLE
    stored_offset_hu: float = 0.0

    @property
    def own(self) -> bool:
        """Whether anything differs from the study's default."""
        return self.source is not None or self.section != WHOLE or self.stored_offset_hu != 0

    @cached_property
    def extractor(self) -> RadiomicsFeatureExtractor:
        """What extracts."""
        return _extractor(self.extraction.settings, self.extraction.image_types, self.classes)

    @cached_property
    def features(self) -> tuple[str, ...]:
        """Names of all features, in the order in which they are extracted."""
        if self.source is None:
            return FEATURES
        # Bins change no name, and noise that a type's own bin width cuts finely would take all memory.
        types = {
            name: {key: value for key, value in (own or {}).items() if key not in PROBE}
            for name, own in self.extraction.image_types.items()
        }
        probe = _extractor({**self.extraction.settings, **PROBE}, types, self.classes)
        noise = generator(0).normal(0, 100, (PROBE_VOXELS,) * 3)
        region = np.zeros(noise.shape, np.uint8)
        region[12:20, 12:20, 12:20] = 1
        if self.section == LARGEST:
            noise, region = noise[16], region[16]
        images = [sitk.GetImageFromArray(array) for array in (noise, region)]
        for image in images:
            image.SetSpacing((PROBE_SPACING_MM,) * noise.ndim)
        with _quiet():
            return tuple(name for name in probe.execute(*images) if is_feature(name))

    @property
    def of_the_region_alone(self) -> bool:
        """Whether nothing outside of a region matters to its features."""
        asked = self.extraction.settings
        return (
            set(self.extraction.image_types) == {"Original"}
            and not asked.get("normalize")
            and asked.get("resampledPixelSpacing") is None
        )

    def hash(self) -> str:
        """First 16 hexadecimal digits of the SHA-256 of settings and feature names as canonical JSON.

        Returns
        -------
        str
            Beginning with OWN where it is not the study's default.
        """
        content: dict = {"features": self.features, "settings": self.extraction.settings}
        if self.source is not None:
            content["image_types"] = self.extraction.image_types
        if self.section != WHOLE or self.stored_offset_hu:
            content |= {"section": self.section, "stored_offset_hu": float(self.stored_offset_hu)}
        text = json.dumps(content, sort_keys=True, separators=(",", ":"))
        digits = hashlib.sha256(text.encode()).hexdigest()[:16]
        return OWN + digits if self.own else digits


DEFAULT = Parameters(STUDY, {key: names.split() for key, names in NAMES.items()})


@cache
def read_parameters(path: str | None, section: str = WHOLE, stored_offset_hu: float = 0.0) -> Parameters:
    """A parameter file of pyradiomics, checked by pyradiomics' own schema.

    Parameters
    ----------
    path : str or None
        None for the study's 86 features.
    section, stored_offset_hu : optional
        As Parameters has them.

    Raises
    ------
    InputError
        One line, for a file that is missing, not YAML, refused by the schema, or asks for no feature.
    InputErrors
        A line for each key that pyradiomics accepts and that cannot be done here.
    """
    if path is None:
        changed = section != WHOLE or stored_offset_hu
        return replace(DEFAULT, section=section, stored_offset_hu=stored_offset_hu) if changed else DEFAULT
    if stored_offset_hu:
        return replace(read_parameters(path, section), stored_offset_hu=stored_offset_hu)
    content = read_yaml(path, ADVICE, restore="restore it")
    if not content:
        raise InputError(f"{path}: holds none of {', '.join(SECTIONS)}; {ADVICE}")
    _check(content, path)
    if lines := list(refused(content, section == LARGEST)):
        raise InputErrors(f"{path}: {line}" for line in lines)
    if nothing := list(idle(content)):
        note(f"{path}: these settings change nothing: {', '.join(nothing)}")
    extraction = of_parameters(path)
    settings = {**extraction.settings, **{key: SETTINGS[key] for key in ("label", "additionalInfo")}}
    settings.pop("label_channel", None)
    classes = {name: own or [] for name, own in (content.get("featureClass") or {}).items()}
    found = Parameters(Extraction(settings, extraction.image_types, extraction.version), classes, path, section)
    for name in extraction.image_types:
        if name != "Original" and not any(image_type(feature) == name for feature in found.features):
            raise InputError(
                f"{path}: imageType {name} gives no features; complete its settings (LoG needs sigma), install the "
                "package that it needs (LBP3D), or take it out"
            )
    _check_sigmas(found)
    if not found.features:
        raise InputError(f"{path}: asks for no feature that can be extracted from volumes; name a featureClass")
    return found


def _check_sigmas(found: Parameters) -> None:
    """Each width of LoG gives features: pyradiomics passes over one that no image is large enough for."""
    own = {**found.extraction.settings, **(found.extraction.image_types.get("LoG") or {})}
    for sigma in own.get("sigma") or [] if "LoG" in found.extraction.image_types else []:
        start = f"log-sigma-{sigma}-mm-".replace(".", "-")
        if not any(feature.startswith(start) for feature in found.features):
            raise InputError(
                f"{found.source}: imageType LoG: sigma {sigma:g} mm gives no features, as images are too small for it; "
                "take it out"
            )


def _extractor(settings, image_types, classes) -> RadiomicsFeatureExtractor:
    if not classes:
        # pyradiomics' default, all classes, without the one that it passes over in volumes unless force2D is true, and
        # then stops at.
        classes = {name: [] for name in getFeatureClasses() if name != "shape2D"}
    content = {"imageType": dict(image_types), "featureClass": {name: own or None for name, own in classes.items()}}
    with _quiet():
        extractor = RadiomicsFeatureExtractor(content)
    extractor.settings.update(settings)
    return extractor


def _check(content: dict, path: str) -> None:
    schema, functions = getParameterValidationFiles()
    try:
        with _quiet():
            Core(source_data=content, schema_files=[schema], extensions=[functions]).validate(raise_exception=True)
    except (PyKwalifyException, ValueError, TypeError) as error:
        text = " ".join(str(getattr(error, "msg", None) or error).split())
        reason = text.partition(" - ")[2] or text
        reason = reason.partition(": Path: ")[0][:300].rstrip(" .")
        raise InputError(
            f"{path}: is no parameter file of pyradiomics: {reason}; correct it "
            "(pyradiomics.readthedocs.io, Customizing the Extraction)"
        ) from None


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Nothing that pyradiomics or its schema logs, which is said in one line or is of a probe."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(before)
