"""Extract features of simulated images in which one image property at a time is changed.

The feature diagnosis interpolates between these strengths to find the property that explains feature differences.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from ...base.errors import InputError
from ...base.geometry import Grid
from ...base.units import HU_AIR
from ...features import variants
from ...features.extraction import extract_repeats
from ...features.names import MEAN
from ...features.parameters import DEFAULT, Parameters
from ...io.volumes import Volume
from ...phantom import HALF_COVERED
from ...phantom.ct import resample
from ...physics.effect import checked
from ...simulation.reconstruct import apply_image_effects
from .properties import BASELINE, EVERY_FOLD, FOLDS, calibration

SIGMAS_VOXELS = (0.4, 0.7, 1.0)  # SDs of simulated blurs; smaller blurs hardly mix neighboring voxels
FLUX_FACTORS = (0.25, 0.5, 2.0, 4.0)  # relative numbers of simulated photons; features are interpolated in between
TEXTURE_SIGMAS_VOXELS = (*SIGMAS_VOXELS, 1.4, 2.0)  # the noise of a scanner may be this coarse
THICKNESSES_SLICES = (1.5, 2.0, 3.0)  # simulated slice thicknesses; features are interpolated in between


def property_tables(
    images: np.ndarray,
    grid: Grid,
    masks: Mapping[str, np.ndarray],
    fold_of: Mapping[str, int],
    recorded: pd.DataFrame,
    voxel_mm: Sequence[float] | None = None,
    parameters: Parameters = DEFAULT,
) -> Iterator[pd.DataFrame]:
    """Yield the features of unchanged images (BASELINE), then of images with each property changed.

    Parameters
    ----------
    images : ndarray, shape (repeats, z, y, x)
        Repeats of one protocol and noise level, HU.
    masks : mapping of str to ndarray of bool, shape (z, y, x)
        By ROI.
    fold_of : mapping of str to int
        Result of `folds`.
    recorded : DataFrame
        Features of the recording in HU, one row per image and ROI.
    voxel_mm : sequence of 3 float, optional
        Voxel size of the recording (z, y, x), mm; None omits the property `voxels`.

    Yields
    ------
    DataFrame
        One table per strength. Columns: property, strength, fold (EVERY_FOLD, or the fold to which a calibration was
        fitted), and the columns of extraction.extract. Rows: repeats in order, each with all ROIs.

    Raises
    ------
    InputError
        If the recording has no mean HU.
    """
    if MEAN not in recorded:
        raise InputError(f"recorded features: lack {MEAN}, which the HU calibration needs; add it to the table")

    def table(name, strength, fold, changed, on=grid, within=masks):
        found = extract_repeats(changed, on, within, name, parameters)
        front = pd.DataFrame({"property": name, "strength": strength, "fold": fold}, index=found.index)
        return pd.concat([front, found], axis=1).reset_index(drop=True)

    def effect(name, **values):
        return np.stack([apply_image_effects(image, grid.spacing, checked({name: values})) for image in images])

    mean, noise = variants.split(images)
    within = np.any(list(masks.values()), axis=0)
    baseline = table(BASELINE, 0.0, EVERY_FOLD, images)
    yield baseline
    for factor in FLUX_FACTORS:
        yield table("photon_flux", factor, EVERY_FOLD, variants.scale_noise(mean, noise, factor**-0.5))
    for sigma in TEXTURE_SIGMAS_VOXELS:
        yield table("noise_texture", sigma, EVERY_FOLD, variants.filter_noise(mean, noise, sigma, within))
    for sigma in SIGMAS_VOXELS:
        yield table("resolution", sigma, EVERY_FOLD, variants.blur(mean, noise, sigma))
        sigma_mm = sigma * grid.spacing[2]
        yield table("reconstruction_kernel", sigma_mm, EVERY_FOLD, effect("reconstruction_kernel", sigma_mm=sigma_mm))
    for slices in THICKNESSES_SLICES:
        thickness = slices * grid.spacing[0]
        yield table("slice_thickness", thickness, EVERY_FOLD, effect("slice_thickness", thickness_mm=thickness))
    simulated_hu, recorded_hu = (features.groupby("roi")[MEAN].mean() for features in (baseline, recorded))
    for fold in FOLDS:
        chosen = [roi for roi in masks if fold_of[roi] == fold]
        values = calibration(simulated_hu[chosen].to_numpy(), recorded_hu[chosen].to_numpy())
        yield table("hu_calibration", 1.0, fold, effect("hu_calibration", **values))
    if voxel_mm is not None:
        yield table("voxels", 1.0, EVERY_FOLD, *sampled(images, grid, masks, voxel_mm))


def sampled(images, grid, masks, voxel_mm) -> tuple[np.ndarray, Grid, dict[str, np.ndarray]]:
    """Resample images and ROIs to another voxel size, in the bounding box of the ROIs with a margin of two voxels."""
    occupied = np.argwhere(np.any(list(masks.values()), axis=0))
    low = np.maximum(occupied.min(axis=0) - 2, 0)
    high = np.minimum(occupied.max(axis=0) + 3, grid.shape)
    box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    middle = grid.affine[:3, :3] @ ((low + high - 1) / 2)[::-1] + grid.affine[:3, 3]
    part = replace(grid, shape=tuple((high - low).tolist()), centre_mm=tuple(middle.tolist()))
    shape = tuple(max(1, math.floor(e / s + 1e-6)) for e, s in zip(part.extent_mm, voxel_mm, strict=True))
    target = Grid(shape, tuple(voxel_mm), part.centre_mm)
    fine = np.stack([resample(Volume(image[box].astype(np.float32), part), target, HU_AIR) for image in images])
    carried = {
        roi: resample(Volume(mask[box].astype(np.float32), part), target, 0.0) >= HALF_COVERED
        for roi, mask in masks.items()
    }
    return fine, target, carried
