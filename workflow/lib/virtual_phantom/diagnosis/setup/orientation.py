"""Orientation of images relative to the phantom: mirrored, rotated, or with reversed slices.

Wrong orientations are tested first, as their residuals would look like missing physics.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy import ndimage
from skimage.measure import block_reduce
from skimage.registration import phase_cross_correlation

from ...base.geometry import Grid
from ...base.units import HU_AIR, HU_BODY
from ...physics.scenes.scene import Pose
from ...recordings.levels import correlation
from ..comparison.regions import sampled
from ..verdict.warnings import ALIKE
from .finding import AS_STATED, DESCRIPTION, OBJECT, SetupResult

COARSE_MM = 5.0  # side of compared voxels, which keep organs and average noise
FINE = 8  # subdivision of a coarse voxel for shifts
WITHIN_MM = 15.0  # of the isocenter: three times the default tolerance of the alignment
INSIDE = 2  # coarse voxels below the surface, where kernels have no influence
# An orientation is reported if its unexplained share of the variance inside the body is below MOST_LEFT, and below
# REMOVED times the share for the stated orientation. In the default study, the share is 1 to 22 % for correct
# orientations (largest for few views) and 51 to 94 % for wrong ones.
MOST_LEFT, REMOVED = 0.3, 0.5
LEAST_CONTRAST = 20.0  # HU, smallest SD within the body at which the orientation can be determined
SHAPES = (0, 1, 2, 3)  # powers of HU, for hardening, another energy and a wrong scale
SAME_BODY = 0.6  # Dice overlap of the bodies below which the object is another one


@dataclass(frozen=True)
class Orientation:
    """An order of voxels.

    Attributes
    ----------
    ordered : callable
        Reorders an array (z, y, x) like the phantom.
    square : bool
        Whether x and y must have the same size and spacing.
    """

    name: str
    line: str
    ordered: Callable[[np.ndarray], np.ndarray] = field(repr=False)
    square: bool = False


def _flipped(*axes: int) -> Callable[[np.ndarray], np.ndarray]:
    return lambda array: np.flip(array, axes)


def _transposed(*axes: int) -> Callable[[np.ndarray], np.ndarray]:
    return lambda array: np.flip(np.swapaxes(array, 1, 2), axes)


STATED = Orientation("as stated", "", _flipped())
OTHERS = (
    Orientation("mirrored left to right", "flip x", _flipped(2)),
    Orientation("mirrored front to back", "flip y", _flipped(1)),
    Orientation("rotated by 180 degrees", "flip x and y", _flipped(1, 2)),
    Orientation("slices in the other order", "flip z", _flipped(0)),
    Orientation("face down, feet first", "flip y and z", _flipped(0, 1)),
    Orientation("feet first", "flip x and z", _flipped(0, 2)),
    Orientation("mirrored in all directions", "flip x, y and z", _flipped(0, 1, 2)),
    Orientation("x and y swapped", "swap x and y", _transposed(), square=True),
    Orientation("rotated by 90 degrees", "rotate by 90 degrees about z", _transposed(1), square=True),
    Orientation("rotated by -90 degrees", "rotate by -90 degrees about z", _transposed(2), square=True),
)
CHANGE = "repeats: {} in the image files or in their affine"


@dataclass(frozen=True)
class Registered:
    """Images in one orientation, compared with the phantom.

    Attributes
    ----------
    share : float
        Share of the variance inside the body beyond noise that the phantom does not explain; 1 without enough overlap.
    overlap : float
        Dice overlap of the bodies.
    off_mm : tuple of 3 float
        Offset of the images from the isocenter (z, y, x), mm.
    correlation : float
        Correlation of images and phantom over all coarse voxels with air.
    rest : ndarray, shape (z, y, x)
        Images less phantom, HU.
    """

    share: float
    overlap: float
    off_mm: tuple[float, float, float]
    correlation: float
    rest: np.ndarray


def orientation(repeats: np.ndarray, phantom: np.ndarray, of: Grid, grid: Grid) -> SetupResult:
    """Find the order of voxels in which images agree best with the phantom.

    Maps are the middle slice of images minus phantom, HU.

    Parameters
    ----------
    of, grid : Grid
        Grids of the phantom and of the images, whose center is taken as the isocenter.
    """
    # Coarse voxels are about COARSE_MM along each axis.
    size = tuple(max(1, round(COARSE_MM / step)) for step in grid.spacing)
    expected = _coarse(sampled(phantom, of, grid, Pose(), order=1, outside=HU_AIR), size)
    images = np.stack([_coarse(repeat, size) for repeat in repeats])
    mean = images.mean(axis=0)
    noise = images.var(axis=0, ddof=1).mean() / len(images) if len(images) > 1 else 0.0
    spacing = [step * many for step, many in zip(grid.spacing, size, strict=True)]
    stated = _registered(mean, expected, spacing, noise)
    square = expected.shape[1] == expected.shape[2] and np.isclose(spacing[1], spacing[2])
    others = {
        order: _registered(order.ordered(mean), expected, spacing, noise)
        for order in OTHERS
        if square or not order.square
    }
    nearest = min(others, key=lambda order: others[order].share)
    best = others[nearest]
    inside = _inside(expected)
    contrast = bool(inside.any()) and float(expected[inside].std()) > LEAST_CONTRAST
    found, kind, mistakes, chosen = stated, AS_STATED, {}, None
    nearer = min(stated, best, key=lambda registered: registered.share)
    other = contrast and nearer.share > 1 - ALIKE**2 and nearer.correlation < ALIKE
    if other or max(registered.overlap for registered in (stated, *others.values())) < SAME_BODY:
        kind, found = OBJECT, nearer
    elif contrast and best.share < min(MOST_LEFT, REMOVED * stated.share):
        found, kind, chosen = best, DESCRIPTION, nearest
        mistakes = {nearest.name: CHANGE.format(nearest.line)}
    if kind == OBJECT:
        far = _registered(mean, expected, spacing, noise, far=True)
        if far.overlap >= SAME_BODY and not (contrast and far.share > MOST_LEFT):
            z, y, x = (round(off) + 0.0 for off in far.off_mm)
            where = f"(it is {x:g}, {y:g}, {z:g} mm off in x, y, z)"
            found, kind = far, DESCRIPTION
            mistakes = {"location": f"repeats: crop or pad the images so that their center is the isocenter {where}"}
    # Orientations with nearly the same remaining share.
    near = (order for order, other in others.items() if order is not chosen and other.share * REMOVED < found.share)
    alike = [] if kind == OBJECT else [order.name for order in near]
    middle = mean.shape[0] // 2
    maps = stated.rest[middle], found.rest[middle]
    return SetupResult("HU inside the body", kind, mistakes, tuple(alike), stated.share, found.share, maps)


def _coarse(array: np.ndarray, size: tuple[int, int, int]) -> np.ndarray:
    cut = tuple(slice(0, n - n % many) for n, many in zip(array.shape, size, strict=True))
    return block_reduce(array[cut].astype(np.float64), size, np.mean)


def _inside(image: np.ndarray) -> np.ndarray:
    body = ndimage.binary_fill_holes(image > HU_BODY)
    disc = ndimage.generate_binary_structure(2, 1)[None]
    return ndimage.binary_erosion(body, disc, iterations=INSIDE)


def _overlap(images: np.ndarray, expected: np.ndarray) -> float:
    """Return the Dice overlap of the bodies."""
    bodies = images > HU_BODY, expected > HU_BODY
    both, count = (bodies[0] & bodies[1]).sum(), bodies[0].sum() + bodies[1].sum()
    return float(2 * both / count) if count else 0.0


def _registered(
    images: np.ndarray, expected: np.ndarray, spacing: list[float], noise: float, far: bool = False
) -> Registered:
    """Register images to the phantom, and return the residual of a cubic polynomial of its HU inside the body."""
    shift = phase_cross_correlation(expected, images, upsample_factor=FINE, normalization=None)[0]
    moved = ndimage.shift(images, shift, order=1, mode="nearest")
    overlap, off_mm = _overlap(moved, expected), tuple(map(float, -shift * spacing))
    if max(map(abs, off_mm)) > WITHIN_MM and not far:
        moved, overlap, off_mm = images, _overlap(images, expected), (0.0, 0.0, 0.0)
    inside = _inside(expected) & _inside(moved)
    rest, similarity = moved - expected, correlation(moved, expected)
    if inside.sum() < 2 * len(SHAPES):
        return Registered(1.0, overlap, off_mm, similarity, rest)
    recorded, phantom = moved[inside], expected[inside]
    scale = max(float(phantom.std()), 1.0)
    design = np.stack([((phantom - phantom.mean()) / scale) ** power for power in SHAPES], axis=1)
    left = recorded - design @ np.linalg.lstsq(design, recorded, rcond=None)[0]
    total = float(recorded.var()) - noise
    share = (float((left**2).mean()) - noise) / total if total > 0 else 1.0
    return Registered(float(np.clip(share, 0.0, 1.0)), overlap, off_mm, similarity, rest)
