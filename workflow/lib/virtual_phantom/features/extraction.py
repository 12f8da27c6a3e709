"""The paper's 86 radiomics features, computed by pyradiomics.

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
import hashlib
import json
import logging
import warnings
from collections.abc import Iterator
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
from .names import FEATURES, NAMES
from .settings import SETTINGS

# A block of 4 x 4 x 4 voxels has 8 whose 26 neighbours all lie in the ROI; with fewer, textures rest on the
# ROI's shape.
MINIMUM_VOXELS = 64
# A symmetrical, normalised n x n co-occurrence matrix holds n(n + 1)/2 - 1 free numbers: 2 for two grey
# levels, so that the 22 GLCM features are then functions of two numbers, and 0 for one.
MINIMUM_GREY_LEVELS = 3


class RadiomicsWarning(UserWarning):
    """An ROI whose features were computed but say little, or a message from pyradiomics."""


def settings_hash() -> str:
    """First 16 hexadecimal digits of the SHA-256 of settings and feature names as canonical JSON."""
    text = json.dumps({"features": FEATURES, "settings": SETTINGS}, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def extract(volume: Volume, masks: dict[str, np.ndarray], name: str = "image") -> pd.DataFrame:
    """The 86 features of every ROI of an image.

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
        then FEATURES.

    Raises
    ------
    InputError
        For a mask on another grid, an empty mask, an ROI of one voxel, or voxels of the image that are not finite.
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
        n_voxels = int(np.count_nonzero(mask))
        if n_voxels < 2:
            raise InputError(f"{name}: ROI {roi} has {n_voxels} voxels; texture needs neighbours, so give a larger ROI")
        image, label = _crop(volume, mask)
        with _pyradiomics_messages(f"{name}, ROI {roi}"):
            values = _extractor().execute(image, label)
        rows.append(
            {
                "roi": roi,
                "n_voxels": n_voxels,
                "grey_levels": _grey_levels(image, label),
                "settings_hash": settings_hash(),
                **_versions(),
                **{feature: float(values[feature]) for feature in FEATURES},
            }
        )
        _warn_if_poor(name, rows[-1])
    return pd.DataFrame(rows)


def extract_repeats(images: np.ndarray, grid: Grid, masks: dict[str, np.ndarray], name: str) -> pd.DataFrame:
    """`extract` of every image of [repeat, z, y, x], one table below the other."""
    volumes = (Volume(image.astype(np.float32), grid) for image in images)
    return pd.concat([extract(volume, masks, f"{name}, repeat {i}") for i, volume in enumerate(volumes)])


@cache
def _extractor() -> RadiomicsFeatureExtractor:
    extractor = RadiomicsFeatureExtractor(**SETTINGS)
    extractor.disableAllFeatures()
    extractor.enableFeaturesByName(**{key: names.split() for key, names in NAMES.items()})
    return extractor


@cache
def _versions() -> dict[str, str]:
    return {
        "pyradiomics_version": pyradiomics.__version__,
        "numpy_version": np.__version__,
        "simpleitk_version": sitk.Version_VersionString(),
    }


def _crop(volume: Volume, mask: np.ndarray) -> tuple[sitk.Image, sitk.Image]:
    """Image and label cut to the ROI's bounding box and one voxel around it.

    Features of the original image depend on nothing outside the ROI. Looking at the box alone saves most of the time.
    The rim keeps a background in the label, which pyradiomics asks for.

    Returns
    -------
    image, label : SimpleITK.Image
    """
    (box,) = ndimage.find_objects(mask.astype(np.uint8))
    images = []
    for array in (volume.array[box], mask[box].astype(np.uint8)):
        image = sitk.GetImageFromArray(np.pad(array, 1))
        image.SetSpacing(volume.grid.spacing[::-1])
        images.append(image)
    return images[0], images[1]


def _grey_levels(image: sitk.Image, label: sitk.Image) -> int:
    inside = sitk.GetArrayViewFromImage(label) > 0
    bins, _ = binImage(sitk.GetArrayFromImage(image), inside, **SETTINGS)
    return len(np.unique(bins[inside]))


def _warn_if_poor(name: str, row: dict) -> None:
    if row["n_voxels"] < MINIMUM_VOXELS:
        warnings.warn(
            f"{name}: ROI {row['roi']} has {row['n_voxels']} voxels, fewer than the {MINIMUM_VOXELS} that "
            "texture features need to mean anything",
            RadiomicsWarning,
            stacklevel=3,
        )
    if row["grey_levels"] < MINIMUM_GREY_LEVELS:
        warnings.warn(
            f"{name}: ROI {row['roi']} fills {row['grey_levels']} grey-level bins of {SETTINGS['binWidth']} "
            f"HU, fewer than the {MINIMUM_GREY_LEVELS} that texture features need to mean anything",
            RadiomicsWarning,
            stacklevel=3,
        )
    if bad := [feature for feature in FEATURES if not np.isfinite(row[feature])]:
        warnings.warn(
            f"{name}: ROI {row['roi']} gives no finite value for {', '.join(bad)}",
            RadiomicsWarning,
            stacklevel=3,
        )


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
