"""A phantom and a recording at one resolution, and how well one lies on the other."""

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
from ..phantom.plausible import BELOW_AIR_HU
from .cross_correlation import LEAST_COVERED
from .images import MENTIONED_SHARE

SOFT_HU = (-200.0, 300.0)  # fat to contrast-filled vessels: what soft tissue is aligned by
DENSEST_HU = 1000.0  # metal and its streaks would outvote soft tissue
WHOLE_ROI = 0.99  # share of an ROI that must be seen for it to count as seen
EDGE_POINTS, LEAST_EDGE_POINTS = 20_000, 100  # of the body's surface: more add time only, fewer say too little
EDGE_REACH_VOXELS = 3  # farther apart, two edges are not the same one
SMOOTHING = 0.6  # voxels, standard deviation


@dataclass(frozen=True)
class Level:
    """Phantom and recording in HU at one resolution, smoothed, with the region that is compared.

    Attributes
    ----------
    phantom, region : SimpleITK.Image
        HU, and where it is compared (not 0).
    recording, seen : SimpleITK.Image
        HU, and where the recording really holds something (not 0).
    """

    phantom: sitk.Image
    region: sitk.Image
    recording: sitk.Image
    seen: sitk.Image

    @cached_property
    def arrays(self):
        """The phantom, HU, and the region, bool: both [z, y, x]."""
        return sitk.GetArrayFromImage(self.phantom), sitk.GetArrayFromImage(self.region) != 0

    def carried(self, transform: sitk.Transform) -> tuple[np.ndarray, np.ndarray]:
        """The recording on the phantom's grid (HU, linear), and where it has any value."""
        image = sitk.Resample(self.recording, self.phantom, transform, sitk.sitkLinear, HU_AIR)
        seen = sitk.Resample(self.seen, self.phantom, transform, sitk.sitkNearestNeighbor, 0)
        return sitk.GetArrayFromImage(image), sitk.GetArrayFromImage(seen) != 0

    def score(self, transform: sitk.Transform) -> float:
        """Correlation in the region; -1 where too little of it is covered."""
        array, region = self.arrays
        image, seen = self.carried(transform)
        both = region & seen
        if both.sum() < LEAST_COVERED * region.sum():
            return -1.0
        return correlation(array[both], image[both])

    def inside(self, transform: sitk.Transform, mask: np.ndarray) -> float:
        """Correlation of soft tissue within a mask on the phantom's grid."""
        image, seen = self.carried(transform)
        both = mask & seen
        return correlation(soft(self.arrays[0][both]), soft(image[both])) if both.any() else 0.0


def soft(array: np.ndarray) -> np.ndarray:
    """HU limited to those of soft tissue."""
    return np.clip(array, *SOFT_HU)


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Pearson's coefficient; 0 where either does not vary."""
    a, b = a.astype(np.float64) - a.mean(dtype=np.float64), b.astype(np.float64) - b.mean(dtype=np.float64)
    norm = math.sqrt(float((a * a).sum() * (b * b).sum()))
    return float((a * b).sum() / norm) if norm > 0 else 0.0


def clipped(array: np.ndarray) -> np.ndarray:
    """HU limited to those from air to DENSEST_HU, float32."""
    return np.clip(array, HU_AIR, DENSEST_HU).astype(np.float32)


def padding_of(array: np.ndarray) -> np.ndarray:
    """Voxels outside the scanned circle: the lowest value, if it is below air and not a single voxel's noise."""
    lowest = array.min()
    padding = array == lowest
    if lowest >= BELOW_AIR_HU or padding.mean() < MENTIONED_SHARE:
        return np.zeros(array.shape, bool)
    return padding


def seen_of(image: Volume) -> np.ndarray:
    """What a recording really holds: all but the padding outside the scanned circle, bool [z, y, x]."""
    return ~padding_of(image.array)


def coarser(volume: Volume, spacing: Sequence[float]) -> Volume:
    """The volume in voxels of at least `spacing` mm (z, y, x), within its own box."""
    wide = tuple(max(s, own) for s, own in zip(spacing, volume.grid.spacing, strict=True))
    if wide == volume.grid.spacing:
        return volume
    shape = tuple(max(1, math.floor(e / s + 1e-6)) for e, s in zip(volume.grid.extent_mm, wide, strict=True))
    grid = replace(volume.grid, shape=shape, spacing=wide)
    return Volume(resample(volume, grid, outside=HU_AIR), grid)


def coarser_mask(mask: np.ndarray, grid: Grid, voxel_mm: np.ndarray, least: float) -> tuple[np.ndarray, Grid]:
    """Where a mask fills coarser voxels by at least some share.

    Parameters
    ----------
    mask : ndarray of bool, shape (z, y, x)
    grid : Grid
        Of the mask.
    voxel_mm : ndarray, shape (3,)
        Least voxel (z, y, x), mm.
    least : float
        The share.

    Returns
    -------
    coarse : ndarray of uint8, shape (z, y, x)
    grid : Grid
        Of the coarser voxels.
    """
    share = coarser(Volume(mask.astype(np.float32), grid), voxel_mm)
    return (share.array >= least).astype(np.uint8), share.grid


def level_of(phantom: Volume, region: np.ndarray, image: Volume, seen: np.ndarray, voxel_mm: np.ndarray) -> Level:
    """Both in coarser voxels, smoothed alike over the widest voxel of the two.

    Parameters
    ----------
    phantom : Volume
        HU.
    region : ndarray of bool, shape (z, y, x)
        What is compared, on the phantom's grid.
    image : Volume
        The recording's image, HU.
    seen : ndarray of bool, shape (z, y, x)
        What the recording really holds, on its grid.
    voxel_mm : ndarray, shape (3,)
        Least voxel (z, y, x), mm.
    """
    sigma_mm = SMOOTHING * np.maximum.reduce([voxel_mm, phantom.grid.spacing, image.grid.spacing])

    def hu(volume: Volume) -> sitk.Image:
        volume = coarser(volume, voxel_mm)
        array = ndimage.gaussian_filter(volume.array, sigma_mm / volume.grid.spacing, mode="nearest")
        return itk_image(array, volume.grid)

    def part(mask: np.ndarray, grid: Grid, least: float) -> sitk.Image:
        return itk_image(*coarser_mask(mask, grid, voxel_mm, least))

    return Level(hu(phantom), part(region, phantom.grid, HALF_COVERED), hu(image), part(seen, image.grid, WHOLE_ROI))


def edges(level: Level, transform: sitk.Transform) -> tuple[float | None, float | None]:
    """Distances between the HU_BODY surfaces, along the phantom's normals.

    Returns
    -------
    size, signed : float or None
        Median of their sizes, and of the distances themselves, mm; None if there are too few.
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
    for image, places in ((level.phantom, along), (level.recording, along @ matrix[:3, :3].T + matrix[:3, 3])):
        index = (places - image.GetOrigin()) / image.GetSpacing()
        values = ndimage.map_coordinates(
            sitk.GetArrayViewFromImage(image), np.moveaxis(index, -1, 0)[::-1], order=1, mode="constant", cval=np.nan
        )
        found.append(falls(values - HU_BODY, steps))
    distance = found[1] - found[0]
    distance = distance[np.isfinite(distance)]
    if len(distance) < LEAST_EDGE_POINTS:
        return None, None
    return float(np.median(np.abs(distance))), float(np.median(distance))


def falls(profiles: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Where each profile falls through 0, nearest to step 0.

    Parameters
    ----------
    profiles : ndarray, shape (n, steps)
    steps : ndarray, shape (steps,)
        Places, evenly spaced.

    Returns
    -------
    ndarray, shape (n,)
        NaN where it does not.
    """
    before, after = profiles[:, :-1], profiles[:, 1:]
    crossing = (before > 0) & (after <= 0)
    drop = np.where(crossing, before - after, 1)
    place = np.where(crossing, steps[:-1] + before / drop * (steps[1] - steps[0]), np.inf)
    nearest = place[np.arange(len(place)), np.argmin(np.abs(place), axis=1)]
    return np.where(np.isfinite(nearest), nearest, np.nan)
