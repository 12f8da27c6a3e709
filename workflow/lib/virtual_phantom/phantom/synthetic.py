"""Build the virtual phantom from its layout (resources/phantom.yaml).

Shapes are painted in order, weighted by the fraction of the voxel that they fill: hu <- hu + fraction (tissue + texture
- hu). All lengths are in mm, so a finer grid shows the same phantom at a higher resolution.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..base.errors import InputError
from ..base.geometry import Grid
from ..base.pose import IN_PLACE, Pose, turned_axes
from ..base.streams import Stream
from ..base.units import HU_AIR, HU_BODY
from ..io.volumes import Volume
from . import HALF_COVERED, Phantom, Roi, block_mean
from .grid_size import suggest_size
from .layout import PaintedShape, RoiSpec, parse_layout
from .shapes import Ellipsoid, Tube, coverage, fade, window

ANGLES, RADII = 361, 1001  # samples for the farthest point of an ellipse, at steps of 0.1 % of its reach
SLAB_SLICES = 8  # slices that are painted at a time, to limit memory


def build(layout: dict, grid: Grid, oversampling: int, seed: Stream) -> Phantom:
    """Paint the phantom on a refined grid, and average it to the reconstruction grid.

    Shapes and textures do not depend on the grid; equal seeds give equal phantoms.

    Parameters
    ----------
    layout : dict
        From layout.read_layout.
    oversampling : int
        Refinement of the grid of `Phantom.fine`.
    seed : Stream
        Random stream of the textures.

    Raises
    ------
    InputError
        If an entry of the layout is invalid, the body or an ROI does not fit the grid, or an ROI covers no voxel by
        half.
    """
    paints, rois = parse_layout(layout, seed)
    _check_fit(paints, rois, grid)
    fine_grid = grid.refined(oversampling)
    fine = np.full(fine_grid.shape, HU_AIR, np.float32)
    image = np.empty(grid.shape, np.float32)
    fine_z, fine_y, fine_x = fine_grid.axes_mm()
    for first in range(0, grid.shape[0], SLAB_SLICES):
        last = min(first + SLAB_SLICES, grid.shape[0])
        rows = slice(first * oversampling, last * oversampling)
        slab = fine[rows]
        for paint in paints:
            _apply(paint, slab, (fine_z[rows], fine_y, fine_x), fine_grid.spacing)
        image[first:last] = block_mean(slab, oversampling)
    return Phantom(Volume(fine, fine_grid), Volume(image, grid), tuple(_draw(roi, grid) for roi in rois))


def _apply(paint: PaintedShape, slab: np.ndarray, axes, spacing) -> None:
    box = window(paint.shape, axes, spacing)
    part = slab[box]
    if part.size == 0:
        return
    axes = tuple(axis[extent] for axis, extent in zip(axes, box, strict=True))
    share = fade(paint.shape, axes, paint.fade_mm) if paint.fade_mm else coverage(paint.shape, axes, spacing)
    part += share * (np.float32(paint.hu) + paint.texture.sample(*axes) - part)


def _draw(roi: RoiSpec, grid: Grid) -> Roi:
    """Return the ROI of all voxels that its ellipsoid covers by at least half."""
    axes = grid.axes_mm()
    box = window(roi.shape, axes, grid.spacing)
    mask = np.zeros(grid.shape, bool)
    part = tuple(axis[extent] for axis, extent in zip(axes, box, strict=True))
    mask[box] = coverage(roi.shape, part, grid.spacing, subdivisions=8) >= HALF_COVERED
    if not mask.any():
        raise InputError(f"grid: ROI {roi.name} covers no voxel by half at {grid}; give smaller voxels")
    return Roi(roi.name, roi.tissue_class, mask)


def rois(layout: dict, grid: Grid, seed: Stream, pose: Pose = IN_PLACE) -> tuple[Roi, ...]:
    """Make the ROIs of a layout on a grid, with the phantom at a pose."""
    return tuple(_draw(replace(roi, shape=_moved(roi.shape, pose)), grid) for roi in parse_layout(layout, seed)[1])


def _moved(shape: Ellipsoid, pose: Pose) -> Ellipsoid:
    centre = turned_axes(pose.turn_deg).T @ shape.centre_mm + [pose.x_mm, pose.y_mm, pose.z_mm]
    return replace(shape, centre_mm=tuple(centre.tolist()), rotation_deg=shape.rotation_deg + pose.turn_deg)


def find_outline(layout: dict, grid: Grid, seed: Stream) -> tuple[float, tuple[Roi, ...]]:
    """Return the largest distance (mm) of the body from the axis of rotation, and the ROIs, without painting.

    Parameters and errors as for `build`.
    """
    paints, rois = parse_layout(layout, seed)
    _check_fit(paints, rois, grid)
    reach = max((_reach_mm(paint.shape, grid) for paint in paints if paint.hu > HU_BODY), default=0.0)
    return reach, tuple(_draw(roi, grid) for roi in rois)


def _reach_mm(shape: Ellipsoid | Tube, grid: Grid) -> float:
    """Return the largest distance of a shape from the axis of rotation, mm."""
    if isinstance(shape, Tube):
        return max(math.hypot(x, y) + radius for (x, y, _), radius in zip(shape.points_mm, shape.radii_mm, strict=True))
    # An ellipsoid is widest at its center, or the closest slice of the grid. The farthest point is found on rays.
    end = grid.extent_mm[0] / 2
    z = np.clip(shape.centre_mm[2], -end, end) * np.ones(1)
    low, high = shape.bounds_mm()
    farthest = math.hypot(*np.maximum(np.abs(low[:2]), np.abs(high[:2])))
    away = np.linspace(0, farthest, RADII)[:, None]
    angle = np.linspace(0, 2 * np.pi, ANGLES)
    inside = shape.level(z, away * np.sin(angle), away * np.cos(angle)) < 0
    return float(np.max(np.broadcast_to(away, inside.shape), where=inside, initial=0))


def _check_fit(paints: list[PaintedShape], rois: list[RoiSpec], grid: Grid) -> None:
    half = np.array(grid.extent_mm[::-1]) / 2
    bounds = [np.abs(paint.shape.bounds_mm()).max(axis=0) for paint in paints]
    width, height = 2 * np.max(bounds, axis=0)[:2]
    reaches = {roi.name: float(np.abs(roi.shape.bounds_mm())[:, 2].max()) for roi in rois}
    farthest = max(reaches, key=reaches.get)
    needed = (2 * reaches[farthest], height, width)
    if width > 2 * half[0] + 1e-6 or height > 2 * half[1] + 1e-6:
        raise InputError(
            f"grid: the phantom's body needs {height:.0f} mm along y and {width:.0f} mm along x, but the grid spans "
            f"{2 * half[1]:.0f} and {2 * half[0]:.0f} mm; {suggest_size(grid, needed)}, or give larger voxels"
        )
    if reaches[farthest] > half[2] + 1e-6:
        raise InputError(
            f"grid: ROI {farthest} reaches {reaches[farthest]:.1f} mm from the isocenter along z, but the grid only "
            f"{half[2]:.1f} mm; {suggest_size(grid, needed)}, or give thicker slices"
        )
