"""The variants of one simulated scan that are set against a recording of features.

They ask which property explains the misses. Noise amplitude and contrast are brought to what the recording's features
say of them. Of noise texture, resolution and voxels, features do not say enough: they are tried at fixed steps, each a
variant of its own.
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
from ...io.volumes import Volume
from ...phantom import HALF_COVERED
from ...phantom.ct import resample
from ...statistics.attribution import BASELINE

MEAN, VARIANCE = "original_firstorder_Mean", "original_firstorder_Variance"
SIGMAS_VOXELS = (0.4, 0.7, 1.0)  # of blurs that are simulated; under 0.4 a voxel hardly mixes with its neighbours


def noise_factor(images: np.ndarray, masks: Mapping[str, np.ndarray], recorded: pd.DataFrame) -> float:
    """By what the noise's SD must be multiplied so that the variance among an ROI's voxels is the recording's.

    The variance is structure (that of the mean image, less the noise left in it) and noise.

    Parameters
    ----------
    images : ndarray, shape (repeats, z, y, x)
        HU.
    masks : mapping of str to ndarray of bool, shape (z, y, x)
        By ROI.
    recorded : DataFrame
        Features, one row per image and ROI.

    Returns
    -------
    float
        The median over the ROIs; 0 where structure alone exceeds the recording.
    """
    noise = images - images.mean(axis=0)
    n = len(images)
    theirs = recorded.groupby("roi")[VARIANCE].mean()
    squares = []
    for roi, mask in masks.items():
        own = float(noise[:, mask].var(axis=1).mean()) * n / (n - 1)
        structure = float(images.mean(axis=0)[mask].var()) - own / n
        squares.append((theirs[roi] - structure) / own)
    return math.sqrt(max(0.0, float(np.median(squares))))


def property_variants(
    images: np.ndarray,
    grid: Grid,
    masks: Mapping[str, np.ndarray],
    recorded: pd.DataFrame,
    voxel_mm: Sequence[float] | None = None,
) -> Iterator[tuple[str, np.ndarray, Grid, dict[str, np.ndarray]]]:
    """Variants of images, the images as they are first (BASELINE).

    Parameters
    ----------
    images : ndarray, shape (repeats, z, y, x)
        Repeats of one protocol and noise level, HU.
    grid : Grid
    masks : mapping of str to ndarray of bool, shape (z, y, x)
        By ROI; those that the recording has.
    recorded : DataFrame
        Features of the recording in HU, one row per image and ROI.
    voxel_mm : sequence of 3 float, optional
        (z, y, x) of the recording, mm: a variant `voxels` is the images interpolated linearly to such voxels, which
        smooths their noise too; None leaves it out.

    Yields
    ------
    name : str
    images : ndarray, shape (repeats, z, y, x)
        HU.
    grid : Grid
    masks : dict of str to ndarray of bool, shape (z, y, x)
        The ROIs on it.

    Raises
    ------
    InputError
        If an ROI is not in the recording, or the recording lacks the means and variances of its ROIs.
    """
    if lacking := [name for name in (MEAN, VARIANCE) if name not in recorded]:
        raise InputError(f"recorded features lack {lacking[0]}, which the variants are made to meet")
    if odd := sorted(set(masks) - set(recorded["roi"])):
        raise InputError(f"recorded features: there is no ROI {odd[0]}; give the ROIs to compare as rois")
    mean, noise = variants.split(images)
    within = np.any(list(masks.values()), axis=0)
    masks = dict(masks)
    yield BASELINE, images, grid, masks
    yield "noise amplitude", variants.scale_noise(mean, noise, noise_factor(images, masks, recorded)), grid, masks
    for sigma in SIGMAS_VOXELS:
        yield f"noise texture {sigma:g}", variants.filter_noise(mean, noise, sigma, within), grid, masks
    for sigma in SIGMAS_VOXELS:
        yield f"resolution {sigma:g}", variants.blur(mean, noise, sigma), grid, masks
    targets = recorded.groupby("roi")[MEAN].mean()
    contrast = variants.match_means(mean, noise, masks, {roi: float(targets[roi]) for roi in masks})
    yield "contrast", contrast, grid, masks
    if voxel_mm is not None:
        yield "voxels", *sampled(images, grid, masks, voxel_mm)


def sampled(images, grid, masks, voxel_mm) -> tuple[np.ndarray, Grid, dict[str, np.ndarray]]:
    """Images and ROIs on voxels of this size in the box of the ROIs and two voxels around it."""
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
