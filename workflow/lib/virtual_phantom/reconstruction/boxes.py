"""Filtered back-projection at a scanner's own voxel size, in boxes around regions only.

Back-projection is local: the value of a voxel does not depend on which other voxels are reconstructed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from scipy import ndimage

from ..base.geometry import Grid
from ..base.units import HU_AIR, attenuation_to_hu
from ..projectors import parallel_projector
from .fbp import ParallelProjections
from .slices import thin_slices

MARGIN_MM = 3.0  # margin for figures; features of the region do not need it

Box = tuple[slice, slice, slice]


def whole(grid: Grid) -> list[Box]:
    """Return one box that contains the whole grid."""
    return [tuple(slice(0, count) for count in grid.shape)]


def voxels_over(grid: Grid, spacing_mm: Sequence[float]) -> Grid:
    """Return a grid with the same extent and center but voxels of another size (z, y, x), mm."""
    shape = [math.ceil(long / wide - 1e-6) for long, wide in zip(grid.extent_mm, spacing_mm, strict=True)]
    return Grid(tuple(shape), tuple(spacing_mm), grid.centre_mm)


def boxes_around(masks: Iterable[np.ndarray], grid: Grid, margin_mm: float = MARGIN_MM) -> list[Box]:
    """Return the bounding box of each region, with a margin and within the grid. Regions must not be empty."""
    margins = [math.ceil(margin_mm / wide - 1e-9) for wide in grid.spacing]
    boxes = []
    for mask in masks:
        (box,) = ndimage.find_objects(mask.astype(np.uint8))
        boxes.append(
            tuple(
                slice(max(part.start - margin, 0), min(part.stop + margin, count))
                for part, margin, count in zip(box, margins, grid.shape, strict=True)
            )
        )
    return boxes


def back_in_boxes(
    rays: ParallelProjections,
    grid: Grid,
    boxes: Sequence[Box],
    *,
    mu_water_per_mm: float,
    thickness_mm: float | None = None,
    threads: int = 1,
) -> np.ndarray:
    """Return images in HU, not rounded, from rebinned and filtered projections; voxels outside of the boxes are air.

    Parameters
    ----------
    grid : Grid
        The whole image, with the isocenter at its center.
    boxes : sequence of tuple of 3 slice
        Parts to reconstruct.
    mu_water_per_mm : float
        Linear attenuation of water, 1/mm.
    thickness_mm : float, optional
        Slice thickness (slices.thin_slices); None: slices are planes, as in `fbp`.

    Returns
    -------
    ndarray of float32, shape (filters, acquisitions, z, y, x)
    """
    images = np.full((len(rays.packed), rays.lanes, *grid.shape), HU_AIR, np.float32)
    for box in boxes:
        shape = tuple(part.stop - part.start for part in box)
        centre_mm = [
            ((part.start + part.stop - count) / 2) * wide
            for part, count, wide in zip(box, grid.shape, grid.spacing, strict=True)
        ][::-1]
        weights, thin, thin_mm = None, shape[0], grid.spacing[0]
        if thickness_mm is not None:
            weights, thin, thin_mm = thin_slices(shape[0], grid.spacing[0], thickness_mm)
        part = Grid((thin, *shape[1:]), (thin_mm, *grid.spacing[1:]))
        made = rays.back(parallel_projector(rays.engine, rays.rays.geometry, part, rays.lanes, threads, centre_mm))
        if weights is not None:
            made = np.einsum("st,fltyx->flsyx", weights, made, optimize=True)
        images[:, :, *box] = attenuation_to_hu(made, mu_water_per_mm)
    return images
