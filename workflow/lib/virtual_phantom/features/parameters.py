"""Parameters of the extraction: the default 86 features, or a parameter file of pyradiomics.

A parameter file means the same as for the command `pyradiomics`, including the default values of missing settings.
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
from .names import FEATURES, LARGEST, NAMES, WHOLE, is_feature
from .parameter_checks import unsupported, without_effect
from .settings import CUSTOM_PREFIX, SETTINGS, STUDY, Extraction, image_type, read_extraction
from .variations import Variation

ADVICE = "give a parameter file of pyradiomics under features.parameters"
SECTIONS = ("imageType", "featureClass", "setting")
# Feature names are found by extraction from a noise image. These settings ensure that pyradiomics accepts it.
PROBE_VOXELS = 32
PROBE_SPACING_MM = 10.0  # LoG skips images that are narrow relative to its sigma
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
    """Settings, image types and feature classes of an extraction.

    Attributes
    ----------
    classes : dict of str to list of str
        Feature names by class; an empty list selects all features of the class that are not deprecated.
    source : str or None
        Parameter file; None for the default.
    section : {"whole", "largest"}
        Part of each region: all of it, in 3D, or the slice with the most voxels, in 2D with pixels of side 1.
    stored_offset_hu : float
        Offset that is added to HU before the extraction.
    variation : Variation or None
        The setting that differs from those of the study.
    """

    extraction: Extraction
    classes: dict[str, list[str]]
    source: str | None = None
    section: str = WHOLE
    stored_offset_hu: float = 0.0
    variation: Variation | None = None

    @property
    def is_custom(self) -> bool:
        """Whether anything differs from the default."""
        changed = self.variation is not None or self.section != WHOLE or self.stored_offset_hu != 0
        return self.source is not None or changed

    @property
    def origin(self) -> str:
        """Where the settings come from, for messages."""
        if self.variation is not None:
            return f"analyses.extraction ({self.variation.factor}: {self.variation.value})"
        return self.source or "the default settings"

    @property
    def in_pixels(self) -> bool:
        """Whether the pixels of a single slice count as having side 1, whatever their size in mm."""
        return self.section == LARGEST and not (self.variation and self.variation.factor == "resampled_mm")

    @cached_property
    def extractor(self) -> RadiomicsFeatureExtractor:
        """The feature extractor of pyradiomics."""
        return _extractor(self.extraction.settings, self.extraction.image_types, self.classes)

    @cached_property
    def features(self) -> tuple[str, ...]:
        """Names of all features, in the order of extraction."""
        if self.source is None:
            return FEATURES
        # Bins do not change names, but a small bin width of an image type could exhaust the memory.
        types = {
            name: {key: value for key, value in (section or {}).items() if key not in PROBE}
            for name, section in self.extraction.image_types.items()
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
    def depends_on_roi_only(self) -> bool:
        """Whether the features of a region do not depend on voxels outside of it."""
        return not self.needs_whole_images and self.extraction.settings.get("resampledPixelSpacing") is None

    @property
    def needs_whole_images(self) -> bool:
        """Whether features depend on voxels far from the region: by filters, or by normalization of the image."""
        return set(self.extraction.image_types) != {"Original"} or bool(self.extraction.settings.get("normalize"))

    def hash(self) -> str:
        """Return the first 16 hexadecimal digits of the SHA-256 of settings and feature names as canonical JSON.

        The hash of custom settings starts with CUSTOM_PREFIX.
        """
        content: dict = {"features": self.features, "settings": self.extraction.settings}
        if self.source is not None:
            content["image_types"] = self.extraction.image_types
        if self.section != WHOLE or self.stored_offset_hu:
            content |= {"section": self.section, "stored_offset_hu": float(self.stored_offset_hu)}
        if self.variation is not None:
            content["variation"] = self.variation.name
        text = json.dumps(content, sort_keys=True, separators=(",", ":"))
        digits = hashlib.sha256(text.encode()).hexdigest()[:16]
        return CUSTOM_PREFIX + digits if self.is_custom else digits


DEFAULT = Parameters(STUDY, {key: names.split() for key, names in NAMES.items()})


@cache
def read_parameters(path: str | None, section: str = WHOLE, stored_offset_hu: float = 0.0) -> Parameters:
    """Read a parameter file of pyradiomics and check it with the schema of pyradiomics.

    Parameters
    ----------
    path : str or None
        None for the default 86 features.

    Raises
    ------
    InputError
        If the file is missing, not YAML, invalid by the schema, or selects no feature.
    InputErrors
        A line for each valid key that is not supported.
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
    if lines := list(unsupported(content, section == LARGEST)):
        raise InputErrors(f"{path}: {line}" for line in lines)
    if unused := list(without_effect(content)):
        note(f"{path}: these settings have no effect: {', '.join(unused)}")
    extraction = read_extraction(path)
    settings = {**extraction.settings, **{key: SETTINGS[key] for key in ("label", "additionalInfo")}}
    settings.pop("label_channel", None)
    classes = {name: names or [] for name, names in (content.get("featureClass") or {}).items()}
    found = Parameters(Extraction(settings, extraction.image_types, extraction.version), classes, path, section)
    for name in extraction.image_types:
        if name != "Original" and not any(image_type(feature) == name for feature in found.features):
            raise InputError(
                f"{path}: imageType {name} gives no features; complete its settings (LoG needs sigma), install the "
                "package that it needs (LBP3D), or remove it"
            )
    _check_sigmas(found)
    if not found.features:
        raise InputError(f"{path}: selects no feature that can be extracted from volumes; name a featureClass")
    return found


def vary(parameters: Parameters, variation: Variation) -> Parameters:
    """Return parameters with one setting changed.

    Raises
    ------
    InputError
        As `Variation.apply`.
    """
    extraction, section = variation.apply(parameters.extraction, parameters.section)
    return replace(parameters, extraction=extraction, section=section, variation=variation)


def _check_sigmas(found: Parameters) -> None:
    """Check that every sigma of LoG gives features: pyradiomics skips a sigma that is too large for the image."""
    settings = {**found.extraction.settings, **(found.extraction.image_types.get("LoG") or {})}
    for sigma in settings.get("sigma") or [] if "LoG" in found.extraction.image_types else []:
        start = f"log-sigma-{sigma}-mm-".replace(".", "-")
        if not any(feature.startswith(start) for feature in found.features):
            raise InputError(
                f"{found.source}: imageType LoG: sigma {sigma:g} mm gives no features, as images are too small for it; "
                "remove it"
            )


def _extractor(settings, image_types, classes) -> RadiomicsFeatureExtractor:
    if not classes:
        # The default of pyradiomics is all classes. shape2D is excluded: pyradiomics skips it in volumes, or fails if
        # force2D is true.
        classes = {name: [] for name in getFeatureClasses() if name != "shape2D"}
    content = {"imageType": dict(image_types), "featureClass": {name: names or None for name, names in classes.items()}}
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
    """Suppress log messages of pyradiomics and of its schema."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(before)
