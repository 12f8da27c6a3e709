"""Extract radiomics features with pyradiomics: the 86 features of the study, or the features of a parameter file.

Default settings are those of Flouris et al. [1]_, section "Radiomics feature extraction": original image, bin width
25, no resampling, no normalization, no resegmentation. The distance is 1, the co-occurrence matrix is symmetrical, and
dependence cut-off and voxel array shift are 0. References [2]_ and [3]_ define the features.

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

import numpy as np
import pandas as pd
import radiomics as pyradiomics
import SimpleITK as sitk
from radiomics.imageoperations import binImage
from scipy import ndimage

from ..base.errors import InputError
from ..base.geometry import Grid
from ..io.volumes import Volume
from . import MINIMUM_GREY_LEVELS, MINIMUM_VOXELS
from .hu_offset import convert_to_hu
from .names import FEATURES
from .parameters import DEFAULT, LARGEST, Parameters
from .settings import SETTINGS, STUDY

VERSIONS = {
    "pyradiomics_version": pyradiomics.__version__,
    "numpy_version": np.__version__,
    "simpleitk_version": sitk.Version_VersionString(),
}


class RadiomicsWarning(UserWarning):
    """Features of an ROI carry little information, or pyradiomics logged a message."""


def extract(
    volume: Volume,
    masks: dict[str, np.ndarray],
    name: str = "image",
    parameters: Parameters = DEFAULT,
    boxed: bool = False,
) -> pd.DataFrame:
    """Extract the features of every ROI of an image.

    Issues a RadiomicsWarning about ROIs with fewer than MINIMUM_VOXELS voxels or MINIMUM_GREY_LEVELS occupied bins.

    Parameters
    ----------
    volume : Volume
        HU.
    masks : dict of str to ndarray of bool, shape (z, y, x)
        On the image's grid, by ROI.
    name : str, optional
        Name of the image in messages.
    boxed : bool, optional
        Whether the image was reconstructed only in boxes around the ROIs (reconstruction.boxes). Resampling then
        repeats the outermost voxels of a box, so that its interpolation does not see the air outside.

    Returns
    -------
    DataFrame
        One row per ROI: roi, n_voxels, grey_levels (occupied bins), settings_hash, versions of packages, features.

    Raises
    ------
    InputError
        If a mask is on another grid or has fewer than 2 voxels, if a voxel of the image is not finite, or if
        pyradiomics fails with the parameter file. Also if `boxed` and features need whole images.
    TypeError
        If a mask is not boolean.
    """
    if not np.isfinite(volume.array).all():
        bad = np.count_nonzero(~np.isfinite(volume.array))
        raise InputError(f"{name}: {bad} voxels are NaN or infinite; repair the image before extracting features")
    if boxed and parameters.needs_whole_images:
        raise InputError(f"{name}: {whole_images_needed(parameters)}; remove them, or `voxels` of the protocol")
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
            raise InputError(f"{name}: ROI {roi} has {n_voxels} voxels; textures need neighbors; give a larger ROI")
        image, label = _images(volume, mask, parameters, boxed)
        with _pyradiomics_messages(f"{name}, ROI {roi}"):
            values, levels, resampled = _values(image, label, parameters, f"{name}: ROI {roi}")
        if parameters.variation is not None:
            n_voxels = resampled
        rows.append(
            {
                "roi": roi,
                "n_voxels": n_voxels,
                "grey_levels": levels,
                "settings_hash": parameters.hash(),
                **VERSIONS,
                **values,
            }
        )
        _warn_if_poor(name, rows[-1], parameters)
    return convert_to_hu(pd.DataFrame(rows), parameters.stored_offset_hu)


def whole_images_needed(parameters: Parameters) -> str:
    """Return why features cannot be extracted from boxes around regions."""
    return f"filters and normalization ({parameters.origin}) need whole images, not boxes around ROIs"


def extract_repeats(
    images: np.ndarray, grid: Grid, masks: dict[str, np.ndarray], name: str, parameters: Parameters = DEFAULT
) -> pd.DataFrame:
    """Extract the features of all images [repeat, z, y, x] into one table."""
    volumes = (Volume(image.astype(np.float32), grid) for image in images)
    return pd.concat([extract(volume, masks, f"{name}, repeat {i}", parameters) for i, volume in enumerate(volumes)])


def _values(
    image: sitk.Image, label: sitk.Image, parameters: Parameters, source: str
) -> tuple[dict[str, float], int, int]:
    """Return the features by name, the number of occupied bins, and that of voxels (after resampling)."""
    if parameters.extraction is STUDY:
        found = parameters.extractor.execute(image, label)
        values = {feature: float(found[feature]) for feature in FEATURES}
        return values, _grey_levels(image, label, SETTINGS), _voxels(label)
    extractor = parameters.extractor
    try:
        found = extractor.execute(image, label)
        prepared = extractor.loadImage(image, label, None, **extractor.settings)
    except (ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{source}: pyradiomics fails with {parameters.origin}: {reason[:300]}") from None
    except MemoryError:
        raise InputError(
            f"{source}: the bins set in {parameters.origin} need more memory than is available; set a larger "
            "binWidth or a smaller binCount"
        ) from None
    if missing := [feature for feature in parameters.features if feature not in found]:
        raise InputError(
            f"{source}: pyradiomics gives no {missing[0]}, which {parameters.origin} requests; the image may be too "
            "small for the filter"
        )
    values = {feature: float(found[feature]) for feature in parameters.features}
    return values, _grey_levels(*prepared, extractor.settings), _voxels(prepared[1])


def _voxels(label: sitk.Image) -> int:
    return int(np.count_nonzero(sitk.GetArrayViewFromImage(label)))


def _largest(mask: np.ndarray) -> int:
    """Return the index of the slice with the most voxels, or the lowest such index."""
    return int(np.count_nonzero(mask, axis=(1, 2)).argmax())


def _images(volume: Volume, mask: np.ndarray, parameters: Parameters, boxed: bool) -> tuple[sitk.Image, sitk.Image]:
    """Return image and label, cropped to the ROI if the features depend on nothing else.

    Cropping saves most of the time. A margin of one voxel keeps the background in the label that pyradiomics needs.
    Filters, resampling and normalization need the whole image.
    """
    arrays, spacing = (volume.array, mask.astype(np.uint8)), volume.grid.spacing
    if boxed and parameters.extraction.settings.get("resampledPixelSpacing") is not None:
        from ..reconstruction.boxes import boxes_around  # slow import (numba)

        (box,) = boxes_around([mask], volume.grid)
        outside = [(part.start, count - part.stop) for part, count in zip(box, volume.array.shape, strict=True)]
        arrays = np.pad(volume.array[box], outside, mode="edge"), arrays[1]
    if parameters.section == LARGEST:
        largest = _largest(mask)
        arrays, spacing = tuple(array[largest] for array in arrays), spacing[1:]
        if parameters.in_pixels:
            spacing = (1.0, 1.0)
    if parameters.stored_offset_hu:
        arrays = arrays[0].astype(np.float64) + parameters.stored_offset_hu, arrays[1]
    if parameters.depends_on_roi_only:
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
    texts, voxels, levels = [], row["n_voxels"], row["grey_levels"]
    if voxels < MINIMUM_VOXELS:
        texts.append(f"has {voxels} voxels, fewer than the {MINIMUM_VOXELS} that texture features need")
    if levels < MINIMUM_GREY_LEVELS:
        settings = parameters.extraction.effective()
        width = f" of {settings['binWidth']} HU" if "binWidth" in settings and not settings["normalize"] else ""
        texts.append(
            f"fills {levels} gray-level bins{width}, fewer than the {MINIMUM_GREY_LEVELS} that texture features need"
        )
    if bad := [feature for feature in parameters.features if not np.isfinite(row[feature])]:
        texts.append(f"gives no finite value for {', '.join(bad)}")
    for text in texts:
        warnings.warn(f"{name}: ROI {row['roi']} {text}", RadiomicsWarning, stacklevel=3)


@contextlib.contextmanager
def _pyradiomics_messages(where: str) -> Iterator[None]:
    """Turn warnings and errors in the log of pyradiomics into RadiomicsWarnings; `where` names image and ROI.

    Other log messages are dropped.
    """
    records: list[logging.LogRecord] = []
    handler = logging.Handler(logging.WARNING)
    handler.emit = records.append
    logger = logging.getLogger("radiomics")
    handlers, propagate, level = logger.handlers[:], logger.propagate, logger.level
    logger.handlers, logger.propagate = [handler], False
    logger.setLevel(logging.WARNING)  # the caller may have silenced pyradiomics
    try:
        yield
    finally:
        logger.handlers, logger.propagate = handlers, propagate
        logger.setLevel(level)
    for record in records:
        warnings.warn(
            f"{where}: pyradiomics: {record.getMessage().strip().splitlines()[-1]}",
            RadiomicsWarning,
            stacklevel=4,
        )
