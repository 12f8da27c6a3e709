"""Where the phantom lies in an image: rigid 3D registration.

The transform maps phantom world mm to recording world mm, so that masks go to the image and the image is never
resampled. Search, all of it deterministic: the masked normalised cross-correlation over every shift at once [1]_ at
coarse voxels and some turns about z gives starts, beside the isocentre and the centres of mass; the best of them are
refined with SimpleITK through three levels of resolution.

References
----------
.. [1] D. Padfield, IEEE Trans. Image Process. 21, 2706, 2012.
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
from .cross_correlation import LEAST_COVERED, masked_cross_correlation
from .levels import Level, clipped, coarser_mask, correlation, edges, level_of, seen_of

COARSE_VOXELS = 40  # across the body's width in the coarsest level; each further level has half its voxel
TURNS_DEG = (-14.0, -7.0, 0.0, 7.0, 14.0)  # about z; the optimiser covers half of a step and other axes' few degrees
KEPT_STARTS = 2  # best of TURNS_DEG and shifts, followed to the finest level
THIN = 8  # voxels that even a thin phantom is high in the coarsest level
TOUCHING_VOXELS = 1  # of the finest level: nearer to the body's surface, matter may be a shifted body
FAR_MM = 10.0  # from the body's surface: farther than it is out of place by now
TABLE_VOXELS = 4  # left out around a table; from the true place, 1 ended up to 0.15 degrees off, 4 up to 0.06
SIDES = ("left and right", "front and back", "top and bottom")
# Experiments: shifts up to 60 mm, turns up to 12 degrees, other voxels, noise of 10 to 150 HU per voxel.
#   right:  printed phantom 0.99 to 0.998 (inside 0.95 to 0.996), abdomen 0.99 to 0.998 (0.99), with table and arms
#           0.91 to 0.94 (0.95 to 0.99)
#   wrong:  printed phantom mirrored 0.92 (0.60), end to end 0.96 (0.83); abdomen mirrored 0.78 (0.50), end to end 0.85
#           (0.83), front to back 0.67 (0.52), other slices of it 0.77 (0.69); the one for the other 0.62 (0.52)
LEAST_CORRELATION, LEAST_CORRELATION_INSIDE = 0.85, 0.9
# Left unexplained (1 - correlation inside) by swapped sides, as a share of that by the right ones: 3 to 10 for abdomen
# and printed phantom, 1 for an object that is its own mirror image, 0.02 to 0.1 if the recording has them swapped.
FLIPPED_LEAVES = 0.5
UNDETERMINED = 5e-4  # correlation lost by a shift of a rim's width; 0.005 along the axis of the printed phantom


def body_of(phantom: Volume) -> np.ndarray:
    """What is denser than HU_BODY, holes in axial slices filled, bool [z, y, x]."""
    return np.stack([ndimage.binary_fill_holes(part) for part in phantom.array > HU_BODY])


def refine(
    level: Level, start: sitk.Euler3DTransform, relaxation: float = 0.8, last: bool = False
) -> sitk.Euler3DTransform:
    """Descend from a start.

    Parameters
    ----------
    start : SimpleITK.Euler3DTransform
    relaxation : float, optional
        By which steps shrink at each turn: 0.5 stops early, some tenths of a degree off.
    last : bool, optional
        Line searches instead [1]_: on a slab of 40 mm, where a tilt changes little, the descent stopped 0.34 degrees
        off and this at 0.06.

    Returns
    -------
    SimpleITK.Euler3DTransform

    References
    ----------
    .. [1] Powell, Comput. J. 7, 155, 1964.
    """
    method = sitk.ImageRegistrationMethod()
    # sums over threads depend on their number in the last digits
    method.SetNumberOfThreads(1)
    method.SetNumberOfWorkUnits(1)
    method.SetMetricAsCorrelation()
    method.SetMetricSamplingStrategy(method.NONE)
    method.SetMetricFixedMask(level.region)
    method.SetMetricMovingMask(level.seen)
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
    except RuntimeError:  # all points left the recording
        return start
    return transform


@dataclass(frozen=True)
class Alignment:
    """Where the phantom lies in a recording, and how well it fits.

    Attributes
    ----------
    matrix : tuple of 4 tuple of 4 float
        Phantom world mm (x, y, z) to recording world mm.
    translation_mm : tuple of 3 float
        How far the centre is moved, (x, y, z).
    rotation_deg : tuple of 3 float
        Right-handed about x, y, z: first about y, then x, then z, all through centre_mm.
    centre_mm : tuple of 3 float
        Centre of rotation in the phantom's world: the body's centre of mass, (x, y, z).
    correlation : float
        Over the body and a rim around it, at voxels of `residual_voxel_mm`, HU limited to -1000 to 1000.
    correlation_inside : float
        The same over the body less that rim, HU limited to SOFT_HU: without the outline, and bone and gas do not
        outvote soft tissue.
    rms_hu : float
        Root mean square difference over the body, HU, same voxels.
    residual_voxel_mm : tuple of 3 float
        Voxels (z, y, x), mm.
    edge_mm : float or None
        Median distance between the surfaces at HU_BODY, outer and inner, along their normals, mm; None if they are too
        few.
    growth_mm : float or None
        Median of the same distances with sign: positive where the recording is larger, mm.
    covered : float
        Share of the phantom's body that the recording covers.
    loss : tuple of 3 float
        Correlation lost if the phantom is shifted by a rim's width along x, y, z: what is near 0 is not known from this
        recording.
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
        """Axes along which the recording does not say where the phantom lies."""
        return tuple(axis for axis, lost in zip("xyz", self.loss, strict=True) if lost < UNDETERMINED)

    @property
    def transform(self) -> sitk.AffineTransform:
        """Phantom world to recording world, as ITK's resampling of the recording onto the phantom takes it."""
        matrix = np.array(self.matrix)
        return sitk.AffineTransform(matrix[:3, :3].ravel().tolist(), matrix[:3, 3].tolist())

    def to_recording(self, points_mm: np.ndarray) -> np.ndarray:
        """Phantom world points, shape (n, 3), in the recording's world, mm."""
        matrix = np.array(self.matrix)
        return points_mm @ matrix[:3, :3].T + matrix[:3, 3]


def euler(centre_mm, rotation_deg=(0.0, 0.0, 0.0), translation_mm=(0.0, 0.0, 0.0)) -> sitk.Euler3DTransform:
    """A rigid transform.

    Parameters
    ----------
    centre_mm : sequence of 3 float
        Centre of rotation, (x, y, z).
    rotation_deg : sequence of 3 float, optional
        About (x, y, z), as in Alignment.
    translation_mm : sequence of 3 float, optional
        (x, y, z).

    Returns
    -------
    SimpleITK.Euler3DTransform
    """
    transform = sitk.Euler3DTransform()
    transform.SetCenter(tuple(map(float, centre_mm)))
    transform.SetRotation(*(math.radians(angle) for angle in rotation_deg))
    transform.SetTranslation(tuple(map(float, translation_mm)))
    return transform


def angles_deg(transform: sitk.Euler3DTransform) -> tuple[float, float, float]:
    """Rotation of a transform about x, y and z, degrees."""
    return tuple(map(math.degrees, (transform.GetAngleX(), transform.GetAngleY(), transform.GetAngleZ())))


def centre_of(mask: np.ndarray, grid: Grid) -> tuple[float, float, float]:
    """Centre of mass of a mask in world mm (x, y, z)."""
    index = np.array(ndimage.center_of_mass(mask))[::-1]
    return tuple((grid.affine[:3, :3] @ index + grid.affine[:3, 3]).tolist())


class Search:
    """One registration: both images at three resolutions, made when first used, and what is compared.

    Compared are voxels of the phantom's body and a rim of half a coarse voxel around it (1/80 of its width), less as
    much at the first and last slices. In the last refinement what lies beside the body in the recording alone (a table,
    arms) is left out. The same input gives the same numbers, whatever the number of threads.

    Parameters
    ----------
    image, phantom : Volume
        HU, each on its own grid; any difference of voxels and of the boxes around them.
    name : str
        Of the recording, for messages.

    Raises
    ------
    InputError
        Naming the recording, if either holds nothing.
    """

    def __init__(self, image: Volume, phantom: Volume, name: str):
        self.name = name
        self.body = body_of(phantom)
        if not self.body.any():
            raise InputError(f"phantom image: nothing in it is denser than {HU_BODY:g} HU; is it in HU?")
        self.seen = seen_of(image)
        if not (image.array > HU_BODY).any():
            raise InputError(
                f"recording {name}: nothing in it is denser than {HU_BODY:g} HU, so it cannot be aligned; is it in HU?"
            )
        self.image = Volume(np.where(self.seen, clipped(image.array), np.float32(HU_AIR)), image.grid)
        self.phantom = Volume(clipped(phantom.array), phantom.grid)
        columns = np.flatnonzero(self.body.any(axis=(0, 1)))
        self.coarse_mm = (columns[-1] - columns[0] + 1) * phantom.grid.spacing[2] / COARSE_VOXELS
        self.rim_mm = self.coarse_mm / 2
        self.region = ndimage.distance_transform_edt(~self.body, sampling=phantom.grid.spacing) <= self.rim_mm
        self.inside = ndimage.distance_transform_edt(self.body, sampling=phantom.grid.spacing) > self.rim_mm
        height, slice_mm = phantom.grid.extent_mm[0], phantom.grid.spacing[0]
        self.coarse = np.array([min(self.coarse_mm, height / THIN), self.coarse_mm, self.coarse_mm])
        # What lies beyond the phantom's first and last slices is not known, but blurs into them: with an eighth of the
        # abdomen's 40 mm left out at each end, z was 0.5 mm off in simulated scans, with a quarter 0.05 mm.
        if ends := round(min(self.coarse_mm, height / 4) / slice_mm):
            for mask in (self.region, self.inside):
                mask[:ends] = mask[-ends:] = False
        self.centre = centre_of(self.body, phantom.grid)

    @cached_property
    def coarsest(self) -> Level:
        """At the coarsest resolution."""
        return level_of(self.phantom, self.region, self.image, self.seen, self.coarse)

    @cached_property
    def middle(self) -> Level:
        """At half of its voxels."""
        return level_of(self.phantom, self.region, self.image, self.seen, self.coarse / 2)

    @cached_property
    def finest(self) -> Level:
        """At a quarter of its voxels."""
        return level_of(self.phantom, self.region, self.image, self.seen, self.coarse / 4)

    def place(self, isocentre_mm: Sequence[float] | None) -> sitk.Euler3DTransform:
        """The search from nothing, right to a voxel.

        Parameters
        ----------
        isocentre_mm : sequence of 3 float or None
            Phantom world point (x, y, z) that lay at the middle of the recording's volume; None: the middle of the
            phantom's volume. One start among several.

        Returns
        -------
        SimpleITK.Euler3DTransform
        """
        coarse, middle = self.coarsest, self.middle
        starts = self.starts(coarse, isocentre_mm)
        fits = [refine(coarse, start, 0.5) for start in starts]
        fits.sort(key=lambda fit: -coarse.score(fit))
        fits = [refine(middle, fit) for fit in fits[:KEPT_STARTS]]
        return max(fits, key=middle.score)

    def finish(self, start: sitk.Euler3DTransform) -> sitk.Euler3DTransform:
        """The last refinement, from a transform that is right to a voxel; twice, as the first places the table."""
        once = refine(self.without_table(self.finest, start), start)
        return refine(self.without_table(self.finest, once), once, last=True)

    def without_table(self, level: Level, transform: sitk.Transform) -> Level:
        """The level without those parts of the rim where the recording holds matter that is not the body's.

        That is matter that reaches far from it. What lies near its surface alone is the body, not yet in place.
        """
        array, region = level.arrays
        spacing = level.phantom.GetSpacing()[::-1]
        body = coarser_mask(self.body, self.phantom.grid, self.coarse / 4, HALF_COVERED)[0] != 0
        distance = ndimage.distance_transform_edt(~body, sampling=spacing)
        beyond = (distance > TOUCHING_VOXELS * max(spacing[1:])) & (level.carried(transform)[0] > HU_BODY)
        parts, count = ndimage.label(beyond)
        far = ndimage.maximum(distance, parts, np.arange(1, count + 1)) > FAR_MM
        foreign = np.isin(parts, 1 + np.flatnonzero(far))
        kept = region & ~ndimage.binary_dilation(foreign, iterations=TABLE_VOXELS)
        mask = sitk.GetImageFromArray(kept.astype(np.uint8))
        mask.CopyInformation(level.region)
        return replace(level, region=mask)

    def starts(self, level: Level, isocentre_mm) -> list[sitk.Euler3DTransform]:
        """Transforms to refine: by convention, by centres of mass, by cross-correlation after each turn."""
        centre = np.array(self.centre)
        lay = np.array(isocentre_mm if isocentre_mm is not None else self.phantom.grid.centre_mm, float)
        mass = np.array(centre_of(self.image.array > HU_BODY, self.image.grid))
        shifts = [np.array(self.image.grid.centre_mm) - lay, mass - centre]
        starts = [euler(centre, translation_mm=shift) for shift in shifts]
        return starts + [euler(centre, (0, 0, turn), self.best_shift(level, turn)[1]) for turn in TURNS_DEG]

    def best_shift(self, level: Level, turn_deg: float) -> tuple[float, np.ndarray]:
        """Masked normalised cross-correlation of the turned phantom with the recording over all shifts.

        Parameters
        ----------
        turn_deg : float
            About z, degrees.

        Returns
        -------
        score : float
            The largest coefficient.
        shift_mm : ndarray, shape (3,)
            Where it is found, (x, y, z), on the recording's voxels.
        """
        moving = sitk.GetArrayViewFromImage(level.recording)
        seen = sitk.GetArrayViewFromImage(level.seen)
        spacing = np.array(level.recording.GetSpacing())
        # a grid with the recording's voxels around the phantom's centre, wide enough for any turn about z
        size = np.array(level.phantom.GetSize()) * level.phantom.GetSpacing()
        half_plane = math.hypot(size[0], size[1]) / 2
        shape = np.ceil(np.array([2 * half_plane, 2 * half_plane, size[2]]) / spacing).astype(int)
        middle = np.array(
            level.phantom.TransformContinuousIndexToPhysicalPoint([(n - 1) / 2 for n in level.phantom.GetSize()])
        )
        origin = middle - (shape - 1) / 2 * spacing
        back = euler(self.centre, (0, 0, -turn_deg))
        arguments = (shape.tolist(), back)
        placed = (origin.tolist(), spacing.tolist(), (1, 0, 0, 0, 1, 0, 0, 0, 1))
        turned = sitk.GetArrayFromImage(
            sitk.Resample(level.phantom, *arguments, sitk.sitkLinear, *placed, HU_AIR, sitk.sitkFloat32)
        )
        region = sitk.GetArrayFromImage(
            sitk.Resample(level.region, *arguments, sitk.sitkNearestNeighbor, *placed, 0, sitk.sitkUInt8)
        )
        scores, offsets = masked_cross_correlation(turned, region, moving, seen)
        best = np.unravel_index(np.argmax(scores), scores.shape)
        offset = np.array([axis[i] for axis, i in zip(offsets, best, strict=True)])[::-1]
        shift = np.array(level.recording.GetOrigin()) + offset * spacing - origin
        return float(scores[best]), shift

    def measure(self, transform) -> Alignment:
        """The fit of a transform in numbers."""
        middle, fine = self.middle, self.finest
        array, region = middle.arrays
        inside, body = (
            coarser_mask(mask, self.phantom.grid, self.coarse / 2, HALF_COVERED)[0] != 0
            for mask in (self.inside, self.body & self.region)
        )
        image, seen = middle.carried(transform)
        region, both = region & seen, body & seen
        covered = float(both.sum() / max(1, body.sum()))
        edge, growth = edges(fine, transform)
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
            centre_mm=self.centre,
            correlation=score,
            correlation_inside=middle.inside(transform, inside),
            rms_hu=float(np.sqrt(np.mean((array[both] - image[both]) ** 2))) if both.any() else math.inf,
            residual_voxel_mm=middle.phantom.GetSpacing()[::-1],
            edge_mm=edge,
            growth_mm=growth,
            covered=covered,
            loss=tuple(loss),
        )

    def other_sides(self) -> dict:
        """Correlation inside the body, at coarse voxels, of the phantom flipped along every choice of (x, y, z)."""
        found = {}
        coarse = self.coarsest
        inside = coarser_mask(self.inside, self.phantom.grid, self.coarse, HALF_COVERED)[0] != 0
        for flip in product((0, 1), repeat=3):
            axes = [2 - k for k in range(3) if flip[k]]
            flipped = []
            for image in (coarse.phantom, coarse.region):
                copy = sitk.GetImageFromArray(np.ascontiguousarray(np.flip(sitk.GetArrayViewFromImage(image), axes)))
                copy.CopyInformation(image)
                flipped.append(copy)
            level = replace(coarse, phantom=flipped[0], region=flipped[1])
            fits = []
            for turn in TURNS_DEG:
                score, shift = self.best_shift(level, turn)
                fits.append((score, turn, shift))
            score, turn, shift = max(fits, key=lambda fit: fit[0])
            fit = refine(level, euler(self.centre, (0, 0, turn), shift), 0.5)
            found[flip] = level.inside(fit, np.flip(inside, axes))
        return found

    def result(self, transform: sitk.Euler3DTransform) -> Alignment:
        """The measured fit.

        Parameters
        ----------
        transform : SimpleITK.Euler3DTransform

        Raises
        ------
        InputError
            If it is worse than LEAST_CORRELATION, LEAST_CORRELATION_INSIDE or LEAST_COVERED, or better with sides
            swapped.
        """
        result = self.measure(transform)
        sides = self.other_sides()
        upright = max(sides.pop((0, 0, 0)), result.correlation_inside)
        best = max(sides, key=sides.get)
        flipped = 1 - sides[best] < FLIPPED_LEAVES * (1 - upright)
        if (
            result.covered >= LEAST_COVERED
            and result.correlation >= LEAST_CORRELATION
            and result.correlation_inside >= LEAST_CORRELATION_INSIDE
            and not flipped
        ):
            return result
        found = (
            f"correlation {result.correlation:.2f} (at least {LEAST_CORRELATION:g}), inside the body "
            f"{result.correlation_inside:.2f} (at least {LEAST_CORRELATION_INSIDE:g}), RMS {result.rms_hu:.0f} HU, "
            f"{100 * result.covered:.0f} % of the phantom covered"
        )
        advice = "is this the phantom, in HU, the whole of it? average more repeats if it is only noise"
        if flipped:
            swapped = ", ".join(side for side, flip in zip(SIDES, best, strict=True) if flip)
            advice = f"it fits better ({sides[best]:.2f} inside) with {swapped} swapped: correct its orientation"
        raise InputError(f"recording {self.name}: the phantom does not fit it: {found}; {advice}")


def describe(alignment: Alignment) -> str:
    """The fit in a line."""

    def triple(values: Sequence[float]) -> str:
        return ", ".join(f"{value:.2f}" for value in values)

    edge = "" if alignment.edge_mm is None else f", edges {alignment.edge_mm:.2f} mm apart"
    unknown = "".join(f"; its place along {axis} cannot be told" for axis in alignment.undetermined)
    return (
        f"phantom moved by ({triple(alignment.translation_mm)}) mm and turned by ({triple(alignment.rotation_deg)}) "
        f"degrees about (x, y, z); correlation {alignment.correlation:.3f}, inside the body "
        f"{alignment.correlation_inside:.3f}, RMS {alignment.rms_hu:.0f} HU{edge}, "
        f"{100 * alignment.covered:.0f} % covered{unknown}"
    )
