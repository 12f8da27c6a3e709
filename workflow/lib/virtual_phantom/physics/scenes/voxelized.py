"""Objects of shapes on a grid: the share of every voxel that each of their materials fills, and what that is in HU."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...base.errors import InputError
from ...base.geometry import Grid
from ...base.units import HU_AIR, attenuation_to_hu
from ...io.volumes import Volume
from ...phantom import HALF_COVERED, Phantom, Roi, block_mean
from ...phantom.rois import shrink
from ..beam.materials import attenuation_per_mm, energy_of
from .objects import ShapedObject, ShapedRoi
from .shapes import NOTHING, Shape

# Points of a voxel that an edge runs through: a lattice (N. M. Korobov) in which no two are alike along any axis, so
# that a plane across an axis is told to one in so many.
SAMPLES, GENERATOR = 64, (1, 27, 25)
SLAB_VOXELS = 500_000  # voxels at a time: bounds the memory
OUTSIDE = -1  # of every shape
ANY_MU_PER_MM = 0.02  # of water, where no HU is asked for
ROUNDING_MM = 0.01  # by which an object may pass the grid


def share_of_each(shapes: Sequence[Shape], grid: Grid) -> np.ndarray:
    """Share of every voxel in which each shape is the one that counts, the last that is there.

    Voxels that no edge runs through are told exactly; of those at edges points are counted.

    Parameters
    ----------
    shapes : sequence of Shape
        Later ones replace earlier ones.
    grid : Grid
        Its centre at the isocentre.

    Returns
    -------
    ndarray of float32, shape (shapes, z, y, x)
    """
    half = np.hypot.reduce(np.array(grid.spacing)) / 2
    lattice = (np.outer(np.arange(SAMPLES), GENERATOR) % SAMPLES + 0.5) / SAMPLES - 0.5
    offsets = lattice * grid.spacing[::-1]
    z, y, x = grid.axes_mm()
    points = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).T.reshape(3, -1).T  # (x, y, z) of voxels in order
    last = np.full(len(points), OUTSIDE)
    at_edge = np.zeros(len(points), bool)
    for place, shape in enumerate(shapes):
        near = np.flatnonzero(_near(shape, points, half))
        surely, perhaps = _covers(shape, points[near], half)
        last[near[surely]] = place
        at_edge[near[surely]] = False  # whatever is below
        at_edge[near[perhaps & ~surely]] = True
    shares = np.zeros((len(shapes), len(points)), np.float32)
    whole = np.flatnonzero(~at_edge & (last != OUTSIDE))
    shares[last[whole], whole] = 1
    edge = np.flatnonzero(at_edge)
    if edge.size:
        parts = points[edge, None] + offsets
        top = np.full(parts.shape[:2], OUTSIDE)
        for place, shape in enumerate(shapes):
            near = _near(shape, points[edge], half)
            inside = np.zeros(top.shape, bool)
            inside[near] = contains(shape, parts[near])
            top[inside] = place
        for place in range(len(shapes)):
            shares[place, edge] = (top == place).mean(axis=1)
    return shares.reshape(-1, *grid.shape)


def contains(shape: Shape, points_mm: np.ndarray) -> np.ndarray:
    """Whether points lie in a shape.

    Parameters
    ----------
    points_mm : ndarray, shape (..., 3)
        (x, y, z), mm.

    Returns
    -------
    ndarray of bool, shape (...)
    """
    inside = np.ones(points_mm.shape[:-1], bool)
    for *normal, offset in shape.planes:
        inside &= points_mm @ np.array(normal) <= offset
    if shape.quadric is not None:
        inside &= _level(shape.quadric, points_mm) <= 0
    return inside


def hu_of(shaped: ShapedObject, shares: np.ndarray, mu_water_per_mm: float) -> np.ndarray:
    """What shares of shapes are in HU at the energy where water attenuates like this.

    Parameters
    ----------
    shares : ndarray, shape (shapes, ...)
        As share_of_each gives them; what they leave is air without attenuation.
    mu_water_per_mm : float
        1/mm.

    Returns
    -------
    ndarray of float32, shape (...)
        HU.
    """
    energy = energy_of("water", mu_water_per_mm)
    mu = [0.0 if one.material == NOTHING else attenuation_per_mm(one.material, [energy])[0] for one in shaped.shapes]
    return attenuation_to_hu(np.tensordot(np.array(mu, np.float32), shares, 1), mu_water_per_mm)


def build(
    shaped: ShapedObject,
    grid: Grid,
    oversampling: int,
    mu_water_per_mm: float,
    rois: Sequence[ShapedRoi] | None = None,
) -> Phantom:
    """The phantom that an object of shapes is on a grid.

    Parameters
    ----------
    grid : Grid
        Of the reconstruction.
    oversampling : int
        By how much the phantom's own grid is finer.
    mu_water_per_mm : float
        At the energy of which shapes have their HU, 1/mm.
    rois : sequence of ShapedRoi, optional
        None: those of the object.

    Raises
    ------
    InputError
        If it reaches out of the grid in the plane, or a region fills no voxel by half.
    """
    rois = shaped.rois if rois is None else rois
    check_fits(shaped, grid)
    fine_grid = grid.refined(oversampling)
    fine = np.full(fine_grid.shape, HU_AIR, np.float32)
    image = np.empty(grid.shape, np.float32)
    covered = {roi.name: np.empty(grid.shape, np.float32) for roi in rois}
    slices = max(1, SLAB_VOXELS // (oversampling**3 * grid.shape[1] * grid.shape[2]))
    middle = (grid.shape[0] - 1) / 2
    for first in range(0, grid.shape[0], slices):
        last = min(first + slices, grid.shape[0])
        up = ((first + last - 1) / 2 - middle) * grid.spacing[0]
        slab = Grid((last - first, *grid.shape[1:]), grid.spacing).refined(oversampling)
        shares = share_of_each([_moved(one, up) for one in shaped.shapes], slab)
        hu = hu_of(shaped, shares, mu_water_per_mm)
        fine[first * oversampling : last * oversampling] = hu
        image[first:last] = block_mean(hu, oversampling)
        for roi in rois:
            covered[roi.name][first:last] = block_mean(shares[shaped.names.index(roi.shape)], oversampling)
    masks = tuple(Roi(roi.name, roi.tissue_class, mask_of(roi, covered[roi.name], grid)) for roi in rois)
    for roi, mask in zip(rois, masks, strict=True):
        if not mask.mask.any():
            raise InputError(
                f"grid: ROI {roi.name} fills no voxel by half at {grid}; give smaller voxels, or a margin_mm of less "
                f"than {roi.margin_mm:g}"
            )
    return Phantom(Volume(fine, fine_grid), Volume(image, grid), masks)


def outlined(shaped: ShapedObject, grid: Grid, rois: Sequence[ShapedRoi]) -> tuple[Roi, ...]:
    """The regions alone, found without the finer voxels.

    Raises
    ------
    InputError
        As `build` does.
    """
    return build(shaped, grid, 1, ANY_MU_PER_MM, rois).rois


def reach_mm(shaped: ShapedObject) -> float:
    """How far an object reaches from the isocentre's axis, mm; infinite where it does not end."""
    return max(float(np.hypot(*one.around[:2])) + one.around[2] for one in shaped.shapes if one.material != NOTHING)


def check_fits(shaped: ShapedObject, grid: Grid) -> None:
    """Check that an object lies within a grid in the plane.

    Raises
    ------
    InputError
        If it reaches out of it.
    """
    half = np.array(grid.extent_mm[:0:-1]) / 2
    for axis, size in zip("xy", half, strict=True):
        index = "xy".index(axis)
        reach = max(abs(one.around[index]) + one.around[2] for one in shaped.shapes if one.material != NOTHING)
        if not np.isfinite(reach):
            raise InputError(f"object {shaped.name}: does not end along {axis}; scans see only what they see whole")
        if reach > size + ROUNDING_MM:
            raise InputError(
                f"grid: object {shaped.name} reaches {reach:.1f} mm from the isocentre along {axis}, but the grid only "
                f"{size:.1f} mm; give more or larger voxels along {axis}"
            )


def mask_of(roi: ShapedRoi, covered: np.ndarray, grid: Grid) -> np.ndarray:
    """Voxels that a region fills by half, less its margin.

    Parameters
    ----------
    covered : ndarray, shape (z, y, x)
        Share of every voxel in which its shape is the one that counts.

    Returns
    -------
    ndarray of bool, shape (z, y, x)
    """
    # Between the centres of voxels on either side of an edge it runs about half a voxel away.
    margin = roi.margin_mm and roi.margin_mm + max(grid.spacing[1:]) / 2
    return shrink(covered >= HALF_COVERED, margin, grid)


def _moved(shape: Shape, down_mm: float) -> Shape:
    """The shape as it is seen from a slab at this height."""
    planes = shape.planes.copy()
    planes[:, 3] -= planes[:, 2] * down_mm
    quadric = shape.quadric
    if quadric is not None:
        shift = np.eye(4)
        shift[2, 3] = down_mm
        quadric = shift.T @ quadric @ shift
    x, y, radius, low, high = shape.around
    return Shape(shape.material, planes, quadric, (x, y, radius, low - down_mm, high - down_mm))


def _level(quadric: np.ndarray, points: np.ndarray) -> np.ndarray:
    return (points @ quadric[:3, :3] * points).sum(axis=-1) + 2 * points @ quadric[:3, 3] + quadric[3, 3]


def _near(shape: Shape, points: np.ndarray, within_mm: float) -> np.ndarray:
    """Whether points are so near to what lies around a shape."""
    x, y, radius, low, high = shape.around
    high_enough = (points[:, 2] >= low - within_mm) & (points[:, 2] <= high + within_mm)
    return high_enough & (np.hypot(points[:, 0] - x, points[:, 1] - y) <= radius + within_mm)


def _covers(shape: Shape, points: np.ndarray, within_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """Whether all that is so near to points lies in a shape, and whether anything of it may."""
    surely, perhaps = (np.ones(len(points), bool) for _ in range(2))
    for *normal, offset in shape.planes:
        beyond = points @ np.array(normal) - offset
        surely &= beyond <= -within_mm
        perhaps &= beyond <= within_mm
    if shape.quadric is not None:
        # Of a quadratic form, what a step of this length changes at most.
        slope = 2 * np.linalg.norm(points @ shape.quadric[:3, :3] + shape.quadric[:3, 3], axis=1)
        most = slope * within_mm + np.abs(np.linalg.eigvalsh(shape.quadric[:3, :3])).max() * within_mm**2
        level = _level(shape.quadric, points)
        surely &= level <= -most
        perhaps &= level <= most
    return surely, perhaps
