"""Phantom and recording at one resolution, and the quality of their alignment."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import SimpleITK as sitk
from scipy import ndimage
from skimage.measure import marching_cubes

from ..base.geometry import Grid
from ..base.units import HU_AIR, HU_BODY
from ..io.simpleitk import itk_image, matrix_of
from ..io.volumes import Volume
from ..phantom import HALF_COVERED
from ..phantom.ct import resample
from ..phantom.plausibility import BELOW_AIR_HU
from .images import LEAST_REPORTED_PADDING

SOFT_HU = (-200.0, 300.0)  # fat to contrast-filled vessels: the tissue that the alignment is judged by
DENSEST_HU = 1000.0  # higher values are clipped: metal and its streaks would dominate soft tissue
LEAST_COVERED = 0.4  # share of the body; with less overlap, chance fits score higher than the correct one
WHOLE_ROI = 0.99  # share of an ROI that the recording must cover for the ROI to count as whole
EDGE_POINTS, LEAST_EDGE_POINTS = 20_000, 100  # on the body's surface: more only take time, fewer are too noisy
EDGE_REACH_VOXELS = 3  # edges farther apart than this belong to different structures
SMOOTHING = 0.6  # voxels, standard deviation


@dataclass(frozen=True)
class Level:
    """Smoothed images of phantom and recording at one resolution.

    Attributes
    ----------
    phantom, region : SimpleITK.Image
        HU, and where the images are compared (not 0).
    recording, valid : SimpleITK.Image
        HU, and where the recording contains measured values (not 0).
    """

    phantom: sitk.Image
    region: sitk.Image
    recording: sitk.Image
    valid: sitk.Image

    @cached_property
    def arrays(self):
        """The phantom, HU, and the region, bool; both [z, y, x]."""
        return sitk.GetArrayFromImage(self.phantom), sitk.GetArrayFromImage(self.region) != 0

    def resampled(self, transform: sitk.Transform) -> tuple[np.ndarray, np.ndarray]:
        """Return the recording on the phantom's grid (HU, linear), and where it has a measured value."""
        image = sitk.Resample(self.recording, self.phantom, transform, sitk.sitkLinear, HU_AIR)
        valid = sitk.Resample(self.valid, self.phantom, transform, sitk.sitkNearestNeighbor, 0)
        return sitk.GetArrayFromImage(image), sitk.GetArrayFromImage(valid) != 0

    def score(self, transform: sitk.Transform) -> float:
        """Return the correlation in the region; -1 if the recording covers less than LEAST_COVERED of it."""
        array, region = self.arrays
        image, valid = self.resampled(transform)
        overlap = region & valid
        if overlap.sum() < LEAST_COVERED * region.sum():
            return -1.0
        return correlation(array[overlap], image[overlap])

    def soft_tissue_correlation(self, transform: sitk.Transform, mask: np.ndarray) -> float:
        """Return the correlation within a mask on the phantom's grid, HU clipped to SOFT_HU."""
        image, valid = self.resampled(transform)
        overlap = mask & valid
        if not overlap.any():
            return 0.0
        return correlation(np.clip(self.arrays[0][overlap], *SOFT_HU), np.clip(image[overlap], *SOFT_HU))


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Return Pearson's correlation coefficient; 0 if either array is constant."""
    a, b = a.astype(np.float64) - a.mean(dtype=np.float64), b.astype(np.float64) - b.mean(dtype=np.float64)
    norm = math.sqrt(float((a * a).sum() * (b * b).sum()))
    return float((a * b).sum() / norm) if norm > 0 else 0.0


def clipped(array: np.ndarray) -> np.ndarray:
    """Clip HU to the range from air to DENSEST_HU, float32."""
    return np.clip(array, HU_AIR, DENSEST_HU).astype(np.float32)


def valid_voxels(image: Volume) -> np.ndarray:
    """Return where an image contains measured values, bool [z, y, x], as opposed to padding outside the scan circle.

    Padding is the lowest value of the image, if it is below air and more frequent than noise.
    """
    lowest = image.array.min()
    padding = image.array == lowest
    if lowest >= BELOW_AIR_HU or padding.mean() < LEAST_REPORTED_PADDING:
        return np.ones(image.array.shape, bool)
    return ~padding


def coarsen(volume: Volume, spacing: Sequence[float]) -> Volume:
    """Resample a volume to voxels of at least `spacing` mm (z, y, x), within its own box."""
    coarse = tuple(max(wanted, present) for wanted, present in zip(spacing, volume.grid.spacing, strict=True))
    if coarse == volume.grid.spacing:
        return volume
    shape = tuple(max(1, math.floor(e / s + 1e-6)) for e, s in zip(volume.grid.extent_mm, coarse, strict=True))
    grid = replace(volume.grid, shape=shape, spacing=coarse)
    return Volume(resample(volume, grid, outside=HU_AIR), grid)


def coarsen_mask(mask: np.ndarray, grid: Grid, voxel_mm: np.ndarray, least: float) -> tuple[np.ndarray, Grid]:
    """Return where a mask fills at least the share `least` of voxels of at least `voxel_mm` (uint8), and their grid."""
    share = coarsen(Volume(mask.astype(np.float32), grid), voxel_mm)
    return (share.array >= least).astype(np.uint8), share.grid


def make_level(phantom: Volume, region: np.ndarray, image: Volume, valid: np.ndarray, voxel_mm: np.ndarray) -> Level:
    """Resample both images to coarser voxels and smooth them equally, by the wider voxel of the two.

    Parameters
    ----------
    phantom, image : Volume
        HU, each on its own grid.
    region : ndarray of bool, shape (z, y, x)
        Where the images are compared, on the phantom's grid.
    valid : ndarray of bool, shape (z, y, x)
        Where the recording contains measured values, on its grid.
    voxel_mm : ndarray, shape (3,)
        Minimum voxel size (z, y, x), mm.
    """
    sigma_mm = SMOOTHING * np.maximum.reduce([voxel_mm, phantom.grid.spacing, image.grid.spacing])

    def hu(volume: Volume) -> sitk.Image:
        volume = coarsen(volume, voxel_mm)
        array = ndimage.gaussian_filter(volume.array, sigma_mm / volume.grid.spacing, mode="nearest")
        return itk_image(array, volume.grid)

    def part(mask: np.ndarray, grid: Grid, least: float) -> sitk.Image:
        return itk_image(*coarsen_mask(mask, grid, voxel_mm, least))

    return Level(hu(phantom), part(region, phantom.grid, HALF_COVERED), hu(image), part(valid, image.grid, WHOLE_ROI))


def surface_distances(level: Level, transform: sitk.Transform) -> tuple[float | None, float | None]:
    """Measure distances between the HU_BODY surfaces of phantom and recording, along the phantom's normals.

    Returns
    -------
    absolute, signed : float or None
        Medians of the absolute and of the signed distances, mm; None if there are too few points.
    """
    array = level.arrays[0]
    if min(array.shape) < 2 or not array.min() < HU_BODY < array.max():
        return None, None
    spacing = np.array(level.phantom.GetSpacing())
    index = marching_cubes(array, HU_BODY)[0]
    index = index[:: max(1, len(index) // EDGE_POINTS)].T
    downhill = [-ndimage.map_coordinates(part, index, order=1) for part in np.gradient(array, *spacing[::-1])]
    normals = np.stack(downhill[::-1], axis=1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    points = index[::-1].T * spacing + level.phantom.GetOrigin()
    reach = EDGE_REACH_VOXELS * spacing.max()
    steps = np.linspace(-reach, reach, 8 * EDGE_REACH_VOXELS + 1)
    along = points[:, None] + steps[:, None] * normals[:, None]
    matrix = matrix_of(transform)
    found = []
    for image, positions in ((level.phantom, along), (level.recording, along @ matrix[:3, :3].T + matrix[:3, 3])):
        index = (positions - image.GetOrigin()) / image.GetSpacing()
        values = ndimage.map_coordinates(
            sitk.GetArrayViewFromImage(image), np.moveaxis(index, -1, 0)[::-1], order=1, mode="constant", cval=np.nan
        )
        found.append(falling_crossings(values - HU_BODY, steps))
    distance = found[1] - found[0]
    distance = distance[np.isfinite(distance)]
    if len(distance) < LEAST_EDGE_POINTS:
        return None, None
    return float(np.median(np.abs(distance))), float(np.median(distance))


def falling_crossings(profiles: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Return where each profile, shape (n, steps), falls through 0, nearest to step 0; NaN where it does not."""
    before, after = profiles[:, :-1], profiles[:, 1:]
    crossing = (before > 0) & (after <= 0)
    drop = np.where(crossing, before - after, 1)
    position = np.where(crossing, steps[:-1] + before / drop * (steps[1] - steps[0]), np.inf)
    nearest = position[np.arange(len(position)), np.argmin(np.abs(position), axis=1)]
    return np.where(np.isfinite(nearest), nearest, np.nan)
