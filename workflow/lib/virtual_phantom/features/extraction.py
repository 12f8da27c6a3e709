"""Radiomics features, computed by pyradiomics: the paper's 86, or those that a parameter file asks for.

Flouris et al. [1]_, section "Radiomics feature extraction": original image, bin width 25, no resampling, no
normalisation, no resegmentation, distance 1, symmetrical co-occurrence, dependence cut-off 0, voxel array shift 0.
Definitions: [2]_, [3]_.

References
----------
.. [1] Flouris et al., Sci. Rep. 12, 2022.
.. [2] van Griethuysen et al., Cancer Res. 77, e104, 2017.
.. [3] Zwanenburg et al., Radiology 295, 328, 2020.
"""

from __future__ import annotations

import contextlib
import logging
import warnings
from collections.abc import Iterator, Mapping
from functools import cache

import numpy as np
import pandas as pd
import radiomics as pyradiomics
import SimpleITK as sitk
from radiomics.featureextractor import RadiomicsFeatureExtractor
from radiomics.imageoperations import binImage
from scipy import ndimage

from ..base.errors import InputError
from ..base.geometry import Grid
from ..io.volumes import Volume
from .names import FEATURES
from .parameters import DEFAULT, LARGEST, Parameters
from .settings import SETTINGS
from .stored import to_hu

# A block of 4 x 4 x 4 voxels has 8 whose 26 neighbours all lie in the ROI; with fewer, textures rest on the
# ROI's shape.
MINIMUM_VOXELS = 64
# A symmetrical, normalised n x n co-occurrence matrix holds n(n + 1)/2 - 1 free numbers: 2 for two grey
# levels, so that the 22 GLCM features are then functions of two numbers, and 0 for one.
MINIMUM_GREY_LEVELS = 3


class RadiomicsWarning(UserWarning):
    """An ROI whose features were computed but say little, or a message from pyradiomics."""


def settings_hash() -> str:
    """First 16 hexadecimal digits of the SHA-256 of the study's settings and feature names as canonical JSON."""
    return DEFAULT.hash()


def extract(
    volume: Volume, masks: dict[str, np.ndarray], name: str = "image", parameters: Parameters = DEFAULT
) -> pd.DataFrame:
    """The 86 features of every ROI of an image, or those of a parameter file.

    Warns (RadiomicsWarning) of ROIs with fewer than MINIMUM_VOXELS voxels or MINIMUM_GREY_LEVELS occupied bins.

    Parameters
    ----------
    volume : Volume
        HU.
    masks : dict of str to ndarray of bool, shape (z, y, x)
        On the image's grid, by ROI.
    name : str, optional
        What messages call the image.

    Returns
    -------
    DataFrame
        One row per ROI, in the order of `masks`: roi, n_voxels, grey_levels (occupied bins), settings_hash, versions,
        then the features.

    Raises
    ------
    InputError
        For a mask on another grid, an empty mask, an ROI of one voxel, voxels of the image that are not finite, or what
        a parameter file asks for and cannot be had of an ROI.
    TypeError
        For a mask that is not boolean.
    """
    if not np.isfinite(volume.array).all():
        bad = np.count_nonzero(~np.isfinite(volume.array))
        raise InputError(f"{name}: {bad} voxels are NaN or infinite; repair the image before extracting features")
    rows = []
    for roi, mask in masks.items():
        mask = np.asarray(mask)
        if mask.shape != volume.array.shape:
            raise InputError(
                f"{name}: mask of ROI {roi} has shape {mask.shape}, the image {volume.array.shape}; "
                "resample the mask onto the image's grid"
            )
        if mask.dtype != bool:
            raise TypeError(f"mask of ROI {roi} is {mask.dtype}, not bool")
        n_voxels = int(np.count_nonzero(mask[_largest(mask)] if parameters.section == LARGEST else mask))
        if n_voxels < 2:
            raise InputError(f"{name}: ROI {roi} has {n_voxels} voxels; texture needs neighbours, so give a larger ROI")
        image, label = _images(volume, mask, parameters)
        with _pyradiomics_messages(f"{name}, ROI {roi}"):
            values, levels = _values(image, label, parameters, f"{name}: ROI {roi}")
        rows.append(
            {
                "roi": roi,
                "n_voxels": n_voxels,
                "grey_levels": levels,
                "settings_hash": parameters.hash(),
                **_versions(),
                **values,
            }
        )
        _warn_if_poor(name, rows[-1], parameters)
    return to_hu(pd.DataFrame(rows), parameters.stored_offset_hu)


def extract_repeats(
    images: np.ndarray, grid: Grid, masks: dict[str, np.ndarray], name: str, parameters: Parameters = DEFAULT
) -> pd.DataFrame:
    """`extract` of every image of [repeat, z, y, x], one table below the other."""
    volumes = (Volume(image.astype(np.float32), grid) for image in images)
    return pd.concat([extract(volume, masks, f"{name}, repeat {i}", parameters) for i, volume in enumerate(volumes)])


@cache
def _extractor() -> RadiomicsFeatureExtractor:
    return DEFAULT.extractor


def _values(image: sitk.Image, label: sitk.Image, parameters: Parameters, source: str) -> tuple[dict[str, float], int]:
    """Features by name, and the number of occupied bins."""
    if parameters.source is None:
        found = _extractor().execute(image, label)
        return {feature: float(found[feature]) for feature in FEATURES}, _grey_levels(image, label, SETTINGS)
    extractor = parameters.extractor
    try:
        found = extractor.execute(image, label)
        prepared = extractor.loadImage(image, label, None, **extractor.settings)
    except (ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{source}: pyradiomics, as {parameters.source} sets it: {reason[:300]}") from None
    except MemoryError:
        raise InputError(
            f"{source}: the bins that {parameters.source} asks for need more memory than there is; set a larger "
            "binWidth or a smaller binCount"
        ) from None
    if missing := [feature for feature in parameters.features if feature not in found]:
        raise InputError(
            f"{source}: gives no {missing[0]} as {parameters.source} asks; the image may be too small for the filter"
        )
    return {one: float(found[one]) for one in parameters.features}, _grey_levels(*prepared, extractor.settings)


@cache
def _versions() -> dict[str, str]:
    return {
        "pyradiomics_version": pyradiomics.__version__,
        "numpy_version": np.__version__,
        "simpleitk_version": sitk.Version_VersionString(),
    }


def _largest(mask: np.ndarray) -> int:
    """The slice with the most voxels of a region, the lowest of several."""
    return int(np.count_nonzero(mask, axis=(1, 2)).argmax())


def _images(volume: Volume, mask: np.ndarray, parameters: Parameters) -> tuple[sitk.Image, sitk.Image]:
    """Image and label; cropped to the ROI's bounding box and one voxel around it, or whole.

    Features of the original image depend on nothing outside the ROI. Looking at the box alone saves most of the time.
    The rim keeps a background in the label, which pyradiomics asks for. Filters, resampling and normalisation look
    beyond it.
    """
    arrays, spacing = (volume.array, mask.astype(np.uint8)), volume.grid.spacing
    if parameters.section == LARGEST:
        largest = _largest(mask)
        arrays, spacing = tuple(array[largest] for array in arrays), (1.0, 1.0)
    if parameters.stored_offset_hu:
        arrays = arrays[0].astype(np.float64) + parameters.stored_offset_hu, arrays[1]
    if parameters.of_the_region_alone:
        (box,) = ndimage.find_objects(arrays[1])
        arrays = tuple(np.pad(array[box], 1) for array in arrays)
    images = []
    for array in arrays:
        image = sitk.GetImageFromArray(array)
        image.SetSpacing(spacing[::-1])
        images.append(image)
    return images[0], images[1]


def _grey_levels(image: sitk.Image, label: sitk.Image, settings: Mapping) -> int:
    inside = sitk.GetArrayViewFromImage(label) > 0
    bins, _ = binImage(sitk.GetArrayFromImage(image), inside, **settings)
    return len(np.unique(bins[inside]))


def _warn_if_poor(name: str, row: dict, parameters: Parameters) -> None:
    if row["n_voxels"] < MINIMUM_VOXELS:
        warnings.warn(
            f"{name}: ROI {row['roi']} has {row['n_voxels']} voxels, fewer than the {MINIMUM_VOXELS} that "
            "texture features need to mean anything",
            RadiomicsWarning,
            stacklevel=3,
        )
    if row["grey_levels"] < MINIMUM_GREY_LEVELS:
        warnings.warn(
            f"{name}: ROI {row['roi']} fills {row['grey_levels']} grey-level bins{_width(parameters)}, "
            f"fewer than the {MINIMUM_GREY_LEVELS} that texture features need to mean anything",
            RadiomicsWarning,
            stacklevel=3,
        )
    if bad := [feature for feature in parameters.features if not np.isfinite(row[feature])]:
        warnings.warn(
            f"{name}: ROI {row['roi']} gives no finite value for {', '.join(bad)}",
            RadiomicsWarning,
            stacklevel=3,
        )


def _width(parameters: Parameters) -> str:
    asked = parameters.extraction.effective()
    return f" of {asked['binWidth']} HU" if "binWidth" in asked and not asked["normalize"] else ""


@contextlib.contextmanager
def _pyradiomics_messages(where: str) -> Iterator[None]:
    """Turn what pyradiomics logs as a warning or an error into a RadiomicsWarning that says where; drop the rest."""
    records: list[logging.LogRecord] = []
    handler = logging.Handler(logging.WARNING)
    handler.emit = records.append
    logger = logging.getLogger("radiomics")
    handlers, propagate = logger.handlers[:], logger.propagate
    logger.handlers, logger.propagate = [handler], False
    try:
        yield
    finally:
        logger.handlers, logger.propagate = handlers, propagate
    for record in records:
        warnings.warn(
            f"{where}: pyradiomics: {record.getMessage().strip().splitlines()[-1]}",
            RadiomicsWarning,
            stacklevel=4,
        )
