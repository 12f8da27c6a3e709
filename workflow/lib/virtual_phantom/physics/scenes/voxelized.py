"""Objects of shapes on a voxel grid: the share of every voxel that each shape fills, and the phantom in HU."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...base.errors import InputError
from ...base.geometry import Grid
from ...base.settings import ShapedRoi
from ...base.units import HU_AIR, attenuation_to_hu
from ...io.volumes import Volume
from ...phantom import HALF_COVERED, Phantom, Roi, block_mean
from ...phantom.rois import shrink
from ..beam.materials import attenuation_per_mm, energy_of
from .objects import ShapedObject
from .shapes import NOTHING, Shape

# Points in a voxel at an edge: a lattice (N. M. Korobov) in which no two points have the same coordinate. Shares behind
# a plane perpendicular to an axis therefore have a resolution of 1/64.
SAMPLES, GENERATOR = 64, (1, 27, 25)
SLAB_VOXELS = 500_000  # voxels at a time, to limit memory
OUTSIDE = -1  # index of a voxel outside of all shapes
ANY_MU_PER_MM = 0.02  # attenuation of water when only regions are needed
ROUNDING_MM = 0.01  # by which an object may extend beyond the grid


def shape_shares(shapes: Sequence[Shape], grid: Grid) -> np.ndarray:
    """Return the share of every voxel in which each shape is visible.

    The result is exact for voxels without an edge; in voxels at an edge, SAMPLES points are counted.

    Parameters
    ----------
    shapes : sequence of Shape
        Later shapes replace earlier ones.
    grid : Grid
        Grid with its center at the isocenter.

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
    for index, shape in enumerate(shapes):
        near = np.flatnonzero(_near(shape, points, half))
        inside, touching = _covers(shape, points[near], half)
        last[near[inside]] = index
        at_edge[near[inside]] = False  # hides the edges of earlier shapes
        at_edge[near[touching & ~inside]] = True
    shares = np.zeros((len(shapes), len(points)), np.float32)
    whole = np.flatnonzero(~at_edge & (last != OUTSIDE))
    shares[last[whole], whole] = 1
    edge = np.flatnonzero(at_edge)
    if edge.size:
        samples = points[edge, None] + offsets
        visible = np.full(samples.shape[:2], OUTSIDE)
        for index, shape in enumerate(shapes):
            near = _near(shape, points[edge], half)
            inside = np.zeros(visible.shape, bool)
            inside[near] = contains(shape, samples[near])
            visible[inside] = index
        for index in range(len(shapes)):
            shares[index, edge] = (visible == index).mean(axis=1)
    return shares.reshape(-1, *grid.shape)


def contains(shape: Shape, points_mm: np.ndarray) -> np.ndarray:
    """Return whether points (x, y, z), shape (..., 3), lie in a shape."""
    inside = np.ones(points_mm.shape[:-1], bool)
    for *normal, offset in shape.planes:
        inside &= points_mm @ np.array(normal) <= offset
    if shape.quadric is not None:
        inside &= _quadric_value(shape.quadric, points_mm) <= 0
    return inside


def shapes_to_hu(shaped: ShapedObject, shares: np.ndarray, mu_water_per_mm: float) -> np.ndarray:
    """Return the HU of voxels at the energy at which water has the given attenuation.

    Parameters
    ----------
    shares : ndarray, shape (shapes, ...)
        As shape_shares returns them; the rest of a voxel has no attenuation.
    """
    energy = energy_of("water", mu_water_per_mm)
    materials = [shape.material for shape in shaped.shapes]
    mu = [0.0 if material == NOTHING else attenuation_per_mm(material, [energy])[0] for material in materials]
    return attenuation_to_hu(np.tensordot(np.array(mu, np.float32), shares, 1), mu_water_per_mm)


def voxelize(
    shaped: ShapedObject, grid: Grid, oversampling: int, mu_water_per_mm: float, rois: Sequence[ShapedRoi] | None = None
) -> Phantom:
    """Return the phantom of an object of shapes.

    Parameters
    ----------
    oversampling : int
        Factor by which the grid of the phantom is finer.
    mu_water_per_mm : float
        Attenuation of water, 1/mm, which gives the energy of the HU.
    rois : sequence of ShapedRoi, optional
        None: the regions of the object.

    Raises
    ------
    InputError
        If the object extends beyond the grid in x or y, or a region fills no voxel by half.
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
        height = ((first + last - 1) / 2 - middle) * grid.spacing[0]
        slab = Grid((last - first, *grid.shape[1:]), grid.spacing).refined(oversampling)
        shares = shape_shares([_lowered(shape, height) for shape in shaped.shapes], slab)
        hu = shapes_to_hu(shaped, shares, mu_water_per_mm)
        fine[first * oversampling : last * oversampling] = hu
        image[first:last] = block_mean(hu, oversampling)
        for roi in rois:
            covered[roi.name][first:last] = block_mean(shares[shaped.names.index(roi.shape)], oversampling)
    masks = tuple(Roi(roi.name, roi.tissue_class, roi_mask(roi, covered[roi.name], grid)) for roi in rois)
    for roi, mask in zip(rois, masks, strict=True):
        if not mask.mask.any():
            raise InputError(
                f"grid: ROI {roi.name} fills no voxel by half at {grid}; use smaller voxels, or a margin_mm below "
                f"{roi.margin_mm:g}"
            )
    return Phantom(Volume(fine, fine_grid), Volume(image, grid), masks)


def voxelize_rois(shaped: ShapedObject, grid: Grid, rois: Sequence[ShapedRoi]) -> tuple[Roi, ...]:
    """Return only the regions of `voxelize`, without oversampling.

    Raises
    ------
    InputError
        As `voxelize`.
    """
    return voxelize(shaped, grid, 1, ANY_MU_PER_MM, rois).rois


def reach_mm(shaped: ShapedObject) -> float:
    """Return the largest distance of an object from the z axis, mm; infinite for an infinite object."""
    return max(float(np.hypot(*bounds[:2])) + bounds[2] for bounds in _bounds(shaped))


def check_fits(shaped: ShapedObject, grid: Grid) -> None:
    """Check that an object lies within a grid in x and y.

    Raises
    ------
    InputError
        If it does not.
    """
    half = np.array(grid.extent_mm[:0:-1]) / 2
    for index, (axis, size) in enumerate(zip("xy", half, strict=True)):
        reach = max(abs(bounds[index]) + bounds[2] for bounds in _bounds(shaped))
        if not np.isfinite(reach):
            raise InputError(f"object {shaped.name}: is infinite along {axis}; limit its shapes to the field of view")
        if reach > size + ROUNDING_MM:
            raise InputError(
                f"grid: object {shaped.name} reaches {reach:.1f} mm from the isocenter along {axis}, but the grid only "
                f"{size:.1f} mm; give more or larger voxels along {axis}"
            )


def _bounds(shaped: ShapedObject) -> list[tuple[float, ...]]:
    """Return Shape.around of all shapes with a material."""
    return [shape.around for shape in shaped.shapes if shape.material != NOTHING]


def roi_mask(roi: ShapedRoi, covered: np.ndarray, grid: Grid) -> np.ndarray:
    """Return the voxels that a region fills by half or more, eroded by its margin.

    `covered` is the share of each voxel that the region fills.
    """
    # An edge is about half a voxel away from the voxel centers on either side.
    margin = roi.margin_mm and roi.margin_mm + max(grid.spacing[1:]) / 2
    return shrink(covered >= HALF_COVERED, margin, grid)


def _lowered(shape: Shape, down_mm: float) -> Shape:
    """Return a shape moved down along z."""
    planes = shape.planes.copy()
    planes[:, 3] -= planes[:, 2] * down_mm
    quadric = shape.quadric
    if quadric is not None:
        shift = np.eye(4)
        shift[2, 3] = down_mm
        quadric = shift.T @ quadric @ shift
    x, y, radius, low, high = shape.around
    return Shape(shape.material, planes, quadric, (x, y, radius, low - down_mm, high - down_mm))


def _quadric_value(quadric: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return (x, 1) M (x, 1)' for points x."""
    return (points @ quadric[:3, :3] * points).sum(axis=-1) + 2 * points @ quadric[:3, 3] + quadric[3, 3]


def _near(shape: Shape, points: np.ndarray, distance_mm: float) -> np.ndarray:
    """Return whether points are within a distance of the bounding cylinder of a shape."""
    x, y, radius, low, high = shape.around
    between_ends = (points[:, 2] >= low - distance_mm) & (points[:, 2] <= high + distance_mm)
    return between_ends & (np.hypot(points[:, 0] - x, points[:, 1] - y) <= radius + distance_mm)


def _covers(shape: Shape, points: np.ndarray, radius_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """Return whether balls around points lie in a shape, and whether they may touch it."""
    inside, touching = (np.ones(len(points), bool) for _ in range(2))
    for *normal, offset in shape.planes:
        distance = points @ np.array(normal) - offset
        inside &= distance <= -radius_mm
        touching &= distance <= radius_mm
    if shape.quadric is not None:
        # Largest change of a quadratic form over a step of length r: |gradient| r + |largest eigenvalue| r^2.
        slope = 2 * np.linalg.norm(points @ shape.quadric[:3, :3] + shape.quadric[:3, 3], axis=1)
        most = slope * radius_mm + np.abs(np.linalg.eigvalsh(shape.quadric[:3, :3])).max() * radius_mm**2
        value = _quadric_value(shape.quadric, points)
        inside &= value <= -most
        touching &= value <= most
    return inside, touching
