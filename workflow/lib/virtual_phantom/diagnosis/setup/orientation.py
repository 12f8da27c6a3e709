"""Whether images lie as the phantom does, or were mirrored, turned or stacked the other way round.

A mirrored image has the wrong organ at every place: what that leaves would pass for physics.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy import ndimage
from skimage.registration import phase_cross_correlation

from ...base.geometry import Grid
from ...base.units import HU_AIR, HU_BODY
from ...physics.scenes.scene import Pose
from ...recordings.levels import correlation
from ..comparison.regions import sampled
from ..verdict.caveats import ALIKE
from .finding import AS_STATED, DESCRIPTION, OBJECT

COARSE_MM = 5.0  # sides of the voxels that are compared: organs stay, and noise is averaged
FINE = 8  # by which a shift is found finer than a coarse voxel
WITHIN_MM = 15.0  # of the isocentre: three times what a fit of the alignment may move the object by default
INSIDE = 2  # coarse voxels from the surface inwards, where kernels no longer matter
# An orientation is named if it leaves so little of the variance inside the body, and less than that of the stated one:
# right ones leave 1 to 22 % in images of the default study, most where views are few, wrong ones 51 to 94 %.
MOST_LEFT, REMOVED = 0.3, 0.5
TOLD = 20.0  # HU that organs must differ by (SD) for an orientation to be seen
SHAPES = (0, 1, 2, 3)  # powers of HU: hardening, another energy and a wrong scale bend HU, and move nothing
SAME_BODY = 0.6  # overlap (Dice) of the bodies below which it is another one


@dataclass(frozen=True)
class Orientation:
    """A way in which voxels may be ordered.

    Attributes
    ----------
    name, line : str
        What it is called, and what to change.
    ordered : callable
        An array (z, y, x) to one in the phantom's order.
    square : bool
        Whether x and y must be alike.
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
    Orientation("mirrored left to right", "turn the order of the voxels along x round", _flipped(2)),
    Orientation("mirrored front to back", "turn the order of the voxels along y round", _flipped(1)),
    Orientation("turned by 180 degrees", "turn the order of the voxels along x and y round", _flipped(1, 2)),
    Orientation("slices in the other order", "turn the order of the slices round", _flipped(0)),
    Orientation(
        "face down, feet first", "turn the order of the slices and of the voxels along y round", _flipped(0, 1)
    ),
    Orientation("feet first", "turn the order of the slices and of the voxels along x round", _flipped(0, 2)),
    Orientation("mirrored in all directions", "turn the order of the voxels along x, y and z round", _flipped(0, 1, 2)),
    Orientation("x and y swapped", "swap the axes x and y of the voxels", _transposed(), square=True),
    Orientation("turned by 90 degrees", "turn the voxels by 90 degrees about z", _transposed(1), square=True),
    Orientation("turned by -90 degrees", "turn the voxels by -90 degrees about z", _transposed(2), square=True),
)
CHANGE = "repeats: {}, in the files or in their affine"


@dataclass(frozen=True)
class OrientationFound:
    """How images lie, as SetUp says it of projections.

    Attributes
    ----------
    kind : {"as stated", "description", "object"}
    share_stated, share : float
        Of the variance inside the body, what the phantom leaves as the images are described, and as they should be.
    stated, best : ndarray, shape (y, x)
        Middle slice of images less phantom, HU.
    """

    kind: str
    mistakes: dict[str, str]
    alike: tuple[str, ...]
    share_stated: float
    share: float
    stated: np.ndarray = field(repr=False)
    best: np.ndarray = field(repr=False)

    @property
    def content(self) -> dict:
        """As SetUp.content."""
        return {
            "of": "HU inside the body",
            "kind": self.kind,
            "mistakes": self.mistakes,
            "alike": list(self.alike),
            "share_stated": self.share_stated,
            "share": self.share,
            "location": {},
        }

    def maps(self) -> tuple[np.ndarray, np.ndarray]:
        """As SetUp.maps."""
        return self.stated, self.best


@dataclass(frozen=True)
class Laid:
    """Images in one order, beside the phantom.

    Attributes
    ----------
    share : float
        Of the variance inside the body, what the phantom leaves beyond noise; 1 where the bodies hardly overlap.
    overlap : float
        Of the bodies (Dice).
    off_mm : tuple of 3 float
        Offset of the images from the isocenter (z, y, x), mm.
    correlation : float
        Of images and phantom over all coarse voxels, air among them.
    rest : ndarray, shape (z, y, x)
        Images less phantom, HU.
    """

    share: float
    overlap: float
    off_mm: tuple[float, float, float]
    correlation: float
    rest: np.ndarray


def orientation(repeats: np.ndarray, phantom: np.ndarray, of: Grid, grid: Grid) -> OrientationFound:
    """Look for the order of voxels in which images resemble the phantom most.

    Parameters
    ----------
    repeats : ndarray, shape (repeats, z, y, x)
        HU.
    phantom : ndarray, shape (z, y, x)
        HU.
    of, grid : Grid
        The phantom's, and the images', whose centre is taken for the isocentre.
    """
    # Slices stay: few thick ones would hardly show their order. Whole voxels are averaged in the plane.
    size = tuple(max(1, round(COARSE_MM / step)) for step in grid.spacing)
    expected = _coarse(sampled(phantom, of, grid, Pose(), order=1, outside=HU_AIR), size)
    images = np.stack([_coarse(one, size) for one in repeats])
    mean = images.mean(axis=0)
    noise = images.var(axis=0, ddof=1).mean() / len(images) if len(images) > 1 else 0.0
    spacing = [step * many for step, many in zip(grid.spacing, size, strict=True)]
    stated = _laid(mean, expected, spacing, noise)
    square = expected.shape[1] == expected.shape[2] and np.isclose(spacing[1], spacing[2])
    others = {one: _laid(one.ordered(mean), expected, spacing, noise) for one in OTHERS if square or not one.square}
    nearest = min(others, key=lambda one: others[one].share)
    best = others[nearest]
    telling = float(expected[_inside(expected)].std()) > TOLD if _inside(expected).any() else False
    found, kind, mistakes, chosen = stated, AS_STATED, {}, None
    nearer = min(stated, best, key=lambda one: one.share)
    other = telling and nearer.share > 1 - ALIKE**2 and nearer.correlation < ALIKE
    if other or max(one.overlap for one in (stated, *others.values())) < SAME_BODY:
        kind, found = OBJECT, nearer
    elif telling and best.share < min(MOST_LEFT, REMOVED * stated.share):
        found, kind, chosen = best, DESCRIPTION, nearest
        mistakes = {nearest.name: CHANGE.format(nearest.line)}
    if kind == OBJECT:
        far = _laid(mean, expected, spacing, noise, far=True)
        if far.overlap >= SAME_BODY and not (telling and far.share > MOST_LEFT):
            z, y, x = (round(one) + 0.0 for one in far.off_mm)
            where = f"{x:g}, {y:g}, {z:g} mm off the isocenter in x, y, z"
            found, kind = far, DESCRIPTION
            mistakes = {"location": f"repeats: crop or pad the images, whose center is the isocenter; they lie {where}"}
    # Those that leave hardly more than what is taken for right.
    near = (one for one, laid in others.items() if one is not chosen and laid.share * REMOVED < found.share)
    alike = [] if kind == OBJECT else [one.name for one in near]
    middle = mean.shape[0] // 2
    maps = stated.rest[middle], found.rest[middle]
    return OrientationFound(kind, mistakes, tuple(alike), stated.share, found.share, *maps)


def _coarse(array: np.ndarray, size: tuple[int, int, int]) -> np.ndarray:
    cut = tuple(slice(0, n - n % many) for n, many in zip(array.shape, size, strict=True))
    whole = array[cut].astype(np.float64)
    shape = [part for n, many in zip(whole.shape, size, strict=True) for part in (n // many, many)]
    return whole.reshape(shape).mean(axis=(1, 3, 5))


def _inside(image: np.ndarray) -> np.ndarray:
    body = ndimage.binary_fill_holes(image > HU_BODY)
    disc = ndimage.generate_binary_structure(2, 1)[None]
    return ndimage.binary_erosion(body, disc, iterations=INSIDE)


def _overlap(images: np.ndarray, expected: np.ndarray) -> float:
    """Of the bodies (Dice)."""
    bodies = images > HU_BODY, expected > HU_BODY
    both, count = (bodies[0] & bodies[1]).sum(), bodies[0].sum() + bodies[1].sum()
    return float(2 * both / count) if count else 0.0


def _laid(images: np.ndarray, expected: np.ndarray, spacing: list[float], noise: float, far: bool = False) -> Laid:
    """Images moved onto the phantom, and what a cubic polynomial of the phantom's HU leaves of them inside."""
    shift = phase_cross_correlation(expected, images, upsample_factor=FINE, normalization=None)[0]
    moved = ndimage.shift(images, shift, order=1, mode="nearest")
    overlap, off_mm = _overlap(moved, expected), tuple(map(float, -shift * spacing))
    if max(map(abs, off_mm)) > WITHIN_MM and not far:
        moved, overlap, off_mm = images, _overlap(images, expected), (0.0, 0.0, 0.0)
    inside = _inside(expected) & _inside(moved)
    rest, alike = moved - expected, correlation(moved, expected)
    if inside.sum() < 2 * len(SHAPES):
        return Laid(1.0, overlap, off_mm, alike, rest)
    theirs, ours = moved[inside], expected[inside]
    scale = max(float(ours.std()), 1.0)
    design = np.stack([((ours - ours.mean()) / scale) ** power for power in SHAPES], axis=1)
    left = theirs - design @ np.linalg.lstsq(design, theirs, rcond=None)[0]
    total = float(theirs.var()) - noise
    share = (float((left**2).mean()) - noise) / total if total > 0 else 1.0
    return Laid(float(np.clip(share, 0.0, 1.0)), overlap, off_mm, alike, rest)
