"""Build the virtual phantom from its layout (resources/phantom.yaml).

Shapes are painted one over the other, each voxel by the share that the shape fills: hu <- hu + share (tissue
+ texture - hu). Everything is in mm, so a finer grid shows the same phantom more sharply.
"""

from __future__ import annotations

import numpy as np

from ..base.errors import InputError
from ..base.geometry import Grid
from ..base.streams import Stream
from ..base.units import HU_AIR
from ..io.volumes import Volume
from . import HALF_COVERED, Phantom, Roi, block_mean
from .layout import Paint, RoiSpec, parse
from .shapes import coverage, fade, window

SLAB_SLICES = 8  # slices of the reconstruction grid painted at a time: bounds the memory


def build(layout: dict, grid: Grid, oversampling: int, seed: Stream) -> Phantom:
    """Paint the phantom on a refined grid, and average it down to the grid.

    Shapes and textures are the same at every grid and oversampling; equal seeds give equal phantoms.

    Parameters
    ----------
    layout : dict
        As layout.read_layout gives it.
    grid : Grid
        Of the reconstruction.
    oversampling : int
        By how much the phantom's own grid is finer.
    seed : Stream
        Of the textures.

    Returns
    -------
    Phantom

    Raises
    ------
    InputError
        If the layout has an unknown, missing or impossible entry, if the body or an ROI does not fit the grid, or if an
        ROI covers no voxel by half.
    """
    paints, rois = parse(layout, seed)
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


def _apply(paint: Paint, slab: np.ndarray, axes, spacing) -> None:
    box = window(paint.shape, axes, spacing)
    part = slab[box]
    if part.size == 0:
        return
    axes = tuple(axis[extent] for axis, extent in zip(axes, box, strict=True))
    share = fade(paint.shape, axes, paint.fade_mm) if paint.fade_mm else coverage(paint.shape, axes, spacing)
    part += share * (np.float32(paint.hu) + paint.texture.sample(*axes) - part)


def _draw(roi: RoiSpec, grid: Grid) -> Roi:
    """The ROI of all voxels of the grid that its ellipsoid covers at least by half."""
    axes = grid.axes_mm()
    box = window(roi.shape, axes, grid.spacing)
    mask = np.zeros(grid.shape, bool)
    part = tuple(axis[extent] for axis, extent in zip(axes, box, strict=True))
    mask[box] = coverage(roi.shape, part, grid.spacing, subdivisions=8) >= HALF_COVERED
    if not mask.any():
        raise InputError(f"grid: ROI {roi.name} covers no voxel by half at {grid}; give smaller voxels")
    return Roi(roi.name, roi.tissue_class, mask)


def _check_fit(paints: list[Paint], rois: list[RoiSpec], grid: Grid) -> None:
    half = np.array(grid.extent_mm[::-1]) / 2
    bounds = [np.abs(paint.shape.bounds_mm()).max(axis=0) for paint in paints]
    needed = 2 * np.max(bounds, axis=0)[:2]
    if np.any(needed > 2 * half[:2] + 1e-6):
        raise InputError(
            f"grid: the phantom's body needs {needed[0]:.0f} x {needed[1]:.0f} mm (x, y), but the grid spans "
            f"{2 * half[0]:.0f} x {2 * half[1]:.0f} mm; give more or larger voxels"
        )
    for roi in rois:
        reach = float(np.abs(roi.shape.bounds_mm())[:, 2].max())
        if reach > half[2] + 1e-6:
            raise InputError(
                f"grid: ROI {roi.name} reaches {reach:.1f} mm from the isocentre along z, but the grid only "
                f"{half[2]:.1f} mm; give more or thicker slices"
            )
