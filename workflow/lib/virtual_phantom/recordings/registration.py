"""Rigid 3D registration of the phantom with a recording's image.

The transform maps phantom world mm to recording world mm: masks are transferred to the image, which is not resampled.
The search is deterministic. At the coarsest resolution, masked normalized cross-correlation over all shifts [1]_ and
some rotations about z gives starting points. The isocenter and the centers of mass give two more. SimpleITK refines all
of them at the coarsest level, the best KEPT_STARTS at the middle level, and the best one at the finest level.

References
----------
.. [1] D. Padfield, "Masked object registration in the Fourier domain", IEEE Trans. Image Process. 21, 2706, 2012.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
import SimpleITK as sitk
from scipy import ndimage

from ..base.errors import InputError
from ..base.geometry import Grid
from ..base.units import HU_AIR, HU_BODY
from ..io.simpleitk import matrix_of
from ..io.volumes import Volume
from ..phantom import HALF_COVERED
from .levels import (
    LEAST_COVERED,
    Level,
    clipped,
    coarsen_mask,
    correlation,
    make_level,
    surface_distances,
    valid_voxels,
)

COARSE_VOXELS = 40  # across the body's width in the coarsest level; each further level halves the voxel size
ROTATIONS_DEG = (-14.0, -7.0, 0.0, 7.0, 14.0)  # about z; the optimizer covers half a step and small tilts about x, y
KEPT_STARTS = 2  # best starting points that are refined further
MIN_COARSE_SLICES = 8  # height of a thin phantom in voxels of the coarsest level
CONTACT_VOXELS = 1  # of the finest level; denser matter this close may be the body itself, not yet exactly aligned
FAR_MM = 10.0  # matter that reaches farther from the body is a table or arms: remaining alignment errors are smaller
TABLE_VOXELS = 4  # margin excluded around a table; with 1 voxel, rotations were up to 0.15 degrees off, with 4, 0.06
SIDES = ("left and right", "front and back", "top and bottom")
# Lowest correlations in experiments with shifts of up to 60 mm, rotations of up to 12 degrees, other voxel sizes, and
# noise of 10 to 150 HU per voxel. In parentheses: inside the body.
#   Correct: printed phantom 0.99 to 0.998 (0.95 to 0.996), abdomen 0.99 to 0.998 (0.99), abdomen with table and arms
#     0.91 to 0.94 (0.95 to 0.99).
#   Wrong: printed phantom mirrored 0.92 (0.60), end to end 0.96 (0.83). Abdomen mirrored 0.78 (0.50), end to end 0.85
#     (0.83), front to back 0.67 (0.52), other slices 0.77 (0.69). One phantom aligned with the other 0.62 (0.52).
LEAST_CORRELATION, LEAST_CORRELATION_INSIDE = 0.85, 0.9
# Ratio of 1 - r, flipped over unflipped, where r is the correlation inside the body. Observed: 3 to 10 for abdomen and
# printed phantom, 1 for a symmetric object, 0.02 to 0.1 for a recording with flipped axes.
FLIPPED_RATIO = 0.5
# The position along an axis is undetermined if a shift by the rim's width lowers the correlation by less than this. The
# loss along the printed phantom's axis is 0.005.
UNDETERMINED = 5e-4


def body_of(phantom: Volume) -> np.ndarray:
    """Return a mask of everything denser than HU_BODY, with holes filled in each axial slice, bool [z, y, x]."""
    return np.stack([ndimage.binary_fill_holes(part) for part in phantom.array > HU_BODY])


def refine(
    level: Level, start: sitk.Euler3DTransform, relaxation: float = 0.8, last: bool = False
) -> sitk.Euler3DTransform:
    """Refine a rigid transform by maximizing the correlation with SimpleITK.

    Parameters
    ----------
    relaxation : float, optional
        Factor by which steps shrink when the gradient changes direction. 0.5 stops early, some tenths of a degree off.
    last : bool, optional
        Use Powell's line searches [1]_ instead of gradient descent. On a slab of 40 mm, where tilts change little,
        gradient descent stopped 0.34 degrees off and line searches 0.06 degrees off.

    References
    ----------
    .. [1] M. J. D. Powell, Comput. J. 7, 155, 1964.
    """
    method = sitk.ImageRegistrationMethod()
    # The last digits of sums over threads depend on the number of threads.
    method.SetNumberOfThreads(1)
    method.SetNumberOfWorkUnits(1)
    method.SetMetricAsCorrelation()
    method.SetMetricSamplingStrategy(method.NONE)
    method.SetMetricFixedMask(level.region)
    method.SetMetricMovingMask(level.valid)
    method.SetInterpolator(sitk.sitkLinear)
    voxel = max(level.phantom.GetSpacing()[:2])
    if last:
        method.SetOptimizerAsPowell(20, 20, 0.5, 1e-2, 1e-6)
    else:
        method.SetOptimizerAsRegularStepGradientDescent(0.5 * voxel, 1e-3 * voxel, 300, relaxation, 1e-10)
    method.SetOptimizerScalesFromPhysicalShift()
    transform = sitk.Euler3DTransform(start)
    method.SetInitialTransform(transform, inPlace=True)
    try:
        method.Execute(level.phantom, level.recording)
    except RuntimeError:  # all points are outside the recording
        return start
    return transform


@dataclass(frozen=True)
class Alignment:
    """Position of the phantom in a recording, and quality of the fit. Fields are keys of alignment.json.

    Attributes
    ----------
    matrix : tuple of 4 tuple of 4 float
        Maps phantom world mm (x, y, z) to recording world mm.
    translation_mm : tuple of 3 float
        Displacement of the center, (x, y, z).
    rotation_deg : tuple of 3 float
        Right-handed, about x, y, z; applied about y, then x, then z, through centre_mm.
    centre_mm : tuple of 3 float
        Center of rotation in the phantom's world: the body's center of mass, (x, y, z).
    correlation : float
        In the body and a rim around it, on voxels of `residual_voxel_mm`, HU clipped to -1000 to 1000.
    correlation_inside : float
        In the body without its rim, HU clipped to SOFT_HU: neither the outline nor bone and gas dominate it.
    rms_hu : float
        Root mean square difference in the body, HU, on the same voxels.
    residual_voxel_mm : tuple of 3 float
        Voxel size (z, y, x), mm.
    edge_mm : float or None
        Median distance between the surfaces at HU_BODY along their normals, mm; None if there are too few points.
    growth_mm : float or None
        Median signed distance, mm; positive where the recording is larger.
    covered : float
        Share of the phantom's body that the recording covers.
    loss : tuple of 3 float
        Loss of correlation if the phantom is shifted by the rim's width along x, y, z. Near 0, the recording does not
        determine the position along that axis.
    """

    matrix: tuple[tuple[float, ...], ...]
    translation_mm: tuple[float, float, float]
    rotation_deg: tuple[float, float, float]
    centre_mm: tuple[float, float, float]
    correlation: float
    correlation_inside: float
    rms_hu: float
    residual_voxel_mm: tuple[float, float, float]
    edge_mm: float | None
    growth_mm: float | None
    covered: float
    loss: tuple[float, float, float]

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Axes along which the recording does not determine the phantom's position."""
        return tuple(axis for axis, lost in zip("xyz", self.loss, strict=True) if lost < UNDETERMINED)

    @property
    def transform(self) -> sitk.AffineTransform:
        """ITK transform, phantom world to recording world: resamples the recording onto the phantom."""
        matrix = np.array(self.matrix)
        return sitk.AffineTransform(matrix[:3, :3].ravel().tolist(), matrix[:3, 3].tolist())

    def to_recording(self, points_mm: np.ndarray) -> np.ndarray:
        """Map phantom world points, shape (n, 3), to recording world mm."""
        matrix = np.array(self.matrix)
        return points_mm @ matrix[:3, :3].T + matrix[:3, 3]


def rigid_transform(centre_mm, rotation_deg=(0.0, 0.0, 0.0), translation_mm=(0.0, 0.0, 0.0)) -> sitk.Euler3DTransform:
    """Return the ITK transform that rotates (as in Alignment) about a center and translates; all (x, y, z)."""
    transform = sitk.Euler3DTransform()
    transform.SetCenter(tuple(map(float, centre_mm)))
    transform.SetRotation(*(math.radians(angle) for angle in rotation_deg))
    transform.SetTranslation(tuple(map(float, translation_mm)))
    return transform


def angles_deg(transform: sitk.Euler3DTransform) -> tuple[float, float, float]:
    """Return the rotation about x, y and z, degrees."""
    return tuple(map(math.degrees, (transform.GetAngleX(), transform.GetAngleY(), transform.GetAngleZ())))


def mass_center(mask: np.ndarray, grid: Grid) -> tuple[float, float, float]:
    """Return the center of mass of a mask in world mm (x, y, z)."""
    index = np.array(ndimage.center_of_mass(mask))[::-1]
    return tuple((grid.affine[:3, :3] @ index + grid.affine[:3, 3]).tolist())


class Search:
    """Registration of a phantom with one image.

    Voxels of the phantom's body and of a rim around it are compared. The rim is half a coarse voxel wide (1/80 of the
    body's width). At each end of the stack, slices within a coarse voxel are excluded, at most a quarter of the height.
    The refinement at the finest level also excludes everything outside the body that only the recording contains, such
    as a table or arms.

    Parameters
    ----------
    image, phantom : Volume
        HU, each on its own grid.

    Raises
    ------
    InputError
        If either image contains nothing denser than HU_BODY.
    """

    def __init__(self, image: Volume, phantom: Volume, name: str):
        self.name = name
        self.body = body_of(phantom)
        if not self.body.any():
            raise InputError(
                f"phantom image: no voxel is above {HU_BODY:g} HU, so it cannot be aligned; give a CT in HU, not in "
                "stored values or attenuation"
            )
        self.valid = valid_voxels(image)
        if not (image.array > HU_BODY).any():
            raise InputError(
                f"recording {name}: no voxel is above {HU_BODY:g} HU, so it cannot be aligned; give images in HU, not "
                "in stored values or attenuation"
            )
        self.image = Volume(np.where(self.valid, clipped(image.array), np.float32(HU_AIR)), image.grid)
        self.phantom = Volume(clipped(phantom.array), phantom.grid)
        columns = np.flatnonzero(self.body.any(axis=(0, 1)))
        self.coarse_mm = (columns[-1] - columns[0] + 1) * phantom.grid.spacing[2] / COARSE_VOXELS
        self.rim_mm = self.coarse_mm / 2
        self.region = ndimage.distance_transform_edt(~self.body, sampling=phantom.grid.spacing) <= self.rim_mm
        self.inside = ndimage.distance_transform_edt(self.body, sampling=phantom.grid.spacing) > self.rim_mm
        height, slice_mm = phantom.grid.extent_mm[0], phantom.grid.spacing[0]
        self.coarse = np.array([min(self.coarse_mm, height / MIN_COARSE_SLICES), self.coarse_mm, self.coarse_mm])
        # Structures beyond the phantom's first and last slices are unknown but blur into them. In simulated scans, z
        # was 0.5 mm off with an eighth of the abdomen's 40 mm excluded at each end, and 0.05 mm off with a quarter.
        if ends := round(min(self.coarse_mm, height / 4) / slice_mm):
            for mask in (self.region, self.inside):
                mask[:ends] = mask[-ends:] = False
        self.center = mass_center(self.body, phantom.grid)

    @cached_property
    def coarsest(self) -> Level:
        """Images at the coarsest resolution."""
        return make_level(self.phantom, self.region, self.image, self.valid, self.coarse)

    @cached_property
    def middle(self) -> Level:
        """Images at half the coarsest voxel size."""
        return make_level(self.phantom, self.region, self.image, self.valid, self.coarse / 2)

    @cached_property
    def finest(self) -> Level:
        """Images at a quarter of the coarsest voxel size."""
        return make_level(self.phantom, self.region, self.image, self.valid, self.coarse / 4)

    def coarse_alignment(self, isocentre_mm: Sequence[float] | None) -> sitk.Euler3DTransform:
        """Search all positions; the result is accurate to a voxel.

        Parameters
        ----------
        isocentre_mm : sequence of 3 float or None
            Phantom world point (x, y, z) at the center of the recording's volume, as one of the starting points. None:
            the center of the phantom's volume.
        """
        coarsest_level, middle_level = self.coarsest, self.middle
        starts = self.starts(coarsest_level, isocentre_mm)
        fits = [refine(coarsest_level, start, 0.5) for start in starts]
        fits.sort(key=lambda fit: -coarsest_level.score(fit))
        fits = [refine(middle_level, fit) for fit in fits[:KEPT_STARTS]]
        return max(fits, key=middle_level.score)

    def refine_to_finest(self, start: sitk.Euler3DTransform) -> sitk.Euler3DTransform:
        """Refine a transform that is accurate to a voxel.

        The first of two passes improves the alignment, so that the second can exclude the table more precisely.
        """
        first_pass = refine(self.exclude_table(start), start)
        return refine(self.exclude_table(first_pass), first_pass, last=True)

    def exclude_table(self, transform: sitk.Transform) -> Level:
        """Return the finest level without those parts of the rim where the recording contains foreign matter.

        Foreign matter extends more than FAR_MM from the body. Matter only near its surface is the body itself, not yet
        aligned.
        """
        level, region = self.finest, self.finest.arrays[1]
        spacing = level.phantom.GetSpacing()[::-1]
        body = coarsen_mask(self.body, self.phantom.grid, self.coarse / 4, HALF_COVERED)[0] != 0
        distance = ndimage.distance_transform_edt(~body, sampling=spacing)
        beyond = (distance > CONTACT_VOXELS * max(spacing[1:])) & (level.resampled(transform)[0] > HU_BODY)
        parts, count = ndimage.label(beyond)
        far = ndimage.maximum(distance, parts, np.arange(1, count + 1)) > FAR_MM
        foreign = np.isin(parts, 1 + np.flatnonzero(far))
        kept = region & ~ndimage.binary_dilation(foreign, iterations=TABLE_VOXELS)
        mask = sitk.GetImageFromArray(kept.astype(np.uint8))
        mask.CopyInformation(level.region)
        return replace(level, region=mask)

    def starts(self, level: Level, isocentre_mm) -> list[sitk.Euler3DTransform]:
        """Return the starting points: isocenter, centers of mass, and cross-correlation after each rotation."""
        center = np.array(self.center)
        isocentre = np.array(isocentre_mm if isocentre_mm is not None else self.phantom.grid.centre_mm, float)
        mass = np.array(mass_center(self.image.array > HU_BODY, self.image.grid))
        shifts = [np.array(self.image.grid.centre_mm) - isocentre, mass - center]
        starts = [rigid_transform(center, translation_mm=shift) for shift in shifts]
        return starts + [
            rigid_transform(center, (0, 0, angle), self.best_shift(level, angle)[1]) for angle in ROTATIONS_DEG
        ]

    def best_shift(self, level: Level, angle_deg: float) -> tuple[float, np.ndarray]:
        """Find the shift with the largest masked normalized cross-correlation after a rotation about z.

        Returns
        -------
        score : float
            The largest coefficient. Shifts where the recording covers less than LEAST_COVERED of the region count as 0.
        shift_mm : ndarray, shape (3,)
            Its shift, (x, y, z), a multiple of the recording's voxels.
        """
        spacing = np.array(level.recording.GetSpacing())
        # A grid with the recording's voxels around the phantom's center, wide enough for any rotation about z.
        size = np.array(level.phantom.GetSize()) * level.phantom.GetSpacing()
        diagonal = math.hypot(size[0], size[1])
        shape = np.ceil(np.array([diagonal, diagonal, size[2]]) / spacing).astype(int)
        middle = np.array(
            level.phantom.TransformContinuousIndexToPhysicalPoint([(n - 1) / 2 for n in level.phantom.GetSize()])
        )
        origin = middle - (shape - 1) / 2 * spacing
        arguments = (shape.tolist(), rigid_transform(self.center, (0, 0, -angle_deg)))
        grid = (origin.tolist(), spacing.tolist(), (1, 0, 0, 0, 1, 0, 0, 0, 1))
        rotated = sitk.Resample(level.phantom, *arguments, sitk.sitkLinear, *grid, HU_AIR, sitk.sitkFloat32)
        region = sitk.Resample(level.region, *arguments, sitk.sitkNearestNeighbor, *grid, 0, sitk.sitkUInt8)
        arrays = [sitk.GetArrayViewFromImage(image) for image in (level.recording, rotated, level.valid, region)]
        # Voxels outside the region have no weight: without them, the transforms are smaller.
        (box,) = ndimage.find_objects(arrays[-1]) or [np.s_[0:, 0:, 0:]]
        arrays[1::2] = [array[box] for array in arrays[1::2]]
        last = np.array([part.start for part in box]) + arrays[1].shape - 1
        # ITK accepts only images with the same origin, so positions are removed.
        images = [sitk.GetImageFromArray(array.astype(np.float64)) for array in arrays]
        overlap = math.ceil(LEAST_COVERED * arrays[-1].sum())
        scores = sitk.GetArrayFromImage(sitk.MaskedFFTNormalizedCorrelation(*images, overlap, 0.0))
        best = np.unravel_index(np.argmax(scores), scores.shape)
        # At index 0 of an axis, the last voxel of the box lies on the first voxel of the recording.
        offset = (np.array(best) - last)[::-1]
        return float(scores[best]), np.array(level.recording.GetOrigin()) + offset * spacing - origin

    def measure(self, transform) -> Alignment:
        """Return the quality of a transform's fit."""
        middle, fine = self.middle, self.finest
        array, region = middle.arrays
        inside, body = (
            coarsen_mask(mask, self.phantom.grid, self.coarse / 2, HALF_COVERED)[0] != 0
            for mask in (self.inside, self.body & self.region)
        )
        image, valid = middle.resampled(transform)
        region, overlap = region & valid, body & valid
        covered = float(overlap.sum() / max(1, body.sum()))
        edge, growth = surface_distances(fine, transform)
        score = correlation(array[region], image[region]) if region.any() else 0.0
        loss = []
        for axis in range(3):
            losses = []
            for sign in (-1, 1):
                moved = sitk.Euler3DTransform(transform)
                shift = np.array(transform.GetTranslation())
                shift[axis] += sign * self.rim_mm
                moved.SetTranslation(shift.tolist())
                losses.append(score - middle.score(moved))
            loss.append(min(losses))
        matrix = matrix_of(transform)
        return Alignment(
            matrix=tuple(map(tuple, matrix.tolist())),
            translation_mm=tuple(transform.GetTranslation()),
            rotation_deg=angles_deg(transform),
            centre_mm=self.center,
            correlation=score,
            correlation_inside=middle.soft_tissue_correlation(transform, inside),
            rms_hu=float(np.sqrt(np.mean((array[overlap] - image[overlap]) ** 2))) if overlap.any() else math.inf,
            residual_voxel_mm=middle.phantom.GetSpacing()[::-1],
            edge_mm=edge,
            growth_mm=growth,
            covered=covered,
            loss=tuple(loss),
        )

    def flipped_correlations(self) -> dict[tuple[int, int, int], float]:
        """Return the correlation inside the body, at coarse voxels, for every choice of flipped axes (x, y, z)."""
        found = {}
        coarse = self.coarsest
        inside = coarsen_mask(self.inside, self.phantom.grid, self.coarse, HALF_COVERED)[0] != 0
        for flip in product((0, 1), repeat=3):
            axes = [2 - k for k in range(3) if flip[k]]
            flipped = []
            for image in (coarse.phantom, coarse.region):
                copy = sitk.GetImageFromArray(np.ascontiguousarray(np.flip(sitk.GetArrayViewFromImage(image), axes)))
                copy.CopyInformation(image)
                flipped.append(copy)
            level = replace(coarse, phantom=flipped[0], region=flipped[1])
            fits = [(*self.best_shift(level, angle), angle) for angle in ROTATIONS_DEG]
            _, shift, angle = max(fits, key=lambda fit: fit[0])
            fit = refine(level, rigid_transform(self.center, (0, 0, angle), shift), 0.5)
            found[flip] = level.soft_tissue_correlation(fit, np.flip(inside, axes))
        return found

    def checked(self, transform: sitk.Euler3DTransform) -> Alignment:
        """Measure the quality of a transform's fit, and check that it is good enough.

        Raises
        ------
        InputError
            If it is below LEAST_CORRELATION, LEAST_CORRELATION_INSIDE or LEAST_COVERED, or better with flipped axes.
        """
        result = self.measure(transform)
        flips = self.flipped_correlations()
        unflipped = max(flips.pop((0, 0, 0)), result.correlation_inside)
        best = max(flips, key=flips.get)
        flipped = 1 - flips[best] < FLIPPED_RATIO * (1 - unflipped)
        if (
            result.covered >= LEAST_COVERED
            and result.correlation >= LEAST_CORRELATION
            and result.correlation_inside >= LEAST_CORRELATION_INSIDE
            and not flipped
        ):
            return result
        advice = "check that the recording shows this phantom completely and in HU; average more repeats if it is noisy"
        if flipped:
            sides = ", ".join(side for side, flip in zip(SIDES, best, strict=True) if flip)
            advice = f"the fit is better ({flips[best]:.2f} inside) with {sides} swapped: correct the orientation"
        raise InputError(
            f"recording {self.name}: the phantom does not fit: correlation {result.correlation:.2f} (at least "
            f"{LEAST_CORRELATION:g}), inside the body {result.correlation_inside:.2f} (at least "
            f"{LEAST_CORRELATION_INSIDE:g}), RMS {result.rms_hu:.0f} HU, {100 * result.covered:.0f} % of the phantom "
            f"covered; {advice}"
        )


def describe_alignment(alignment: Alignment) -> str:
    """Return the fit as one line."""

    def triple(values: Sequence[float]) -> str:
        return ", ".join(f"{value:.2f}" for value in values)

    edge = "" if alignment.edge_mm is None else f", edges {alignment.edge_mm:.2f} mm apart"
    unknown = "".join(f"; its position along {axis} is undetermined" for axis in alignment.undetermined)
    return (
        f"phantom moved by ({triple(alignment.translation_mm)}) mm and rotated by ({triple(alignment.rotation_deg)}) "
        f"degrees about (x, y, z); correlation {alignment.correlation:.3f}, inside the body "
        f"{alignment.correlation_inside:.3f}, RMS {alignment.rms_hu:.0f} HU{edge}, "
        f"{100 * alignment.covered:.0f} % covered{unknown}"
    )
