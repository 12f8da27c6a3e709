"""Filtered back-projection at a scanner's own voxels, in boxes around regions only: what is elsewhere is not made.

Back-projection is local, so that a voxel's value does not depend on which others are made.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from scipy import ndimage

from ..base.geometry import Grid, ScanGeometry
from ..base.units import HU_AIR, attenuation_to_hu
from ..projectors.cpu import CpuProjector
from .fbp import ParallelProjections
from .kernel import Kernel
from .slices import thin_slices

MARGIN_MM = 3.0  # what a box has around its region: features of the region need nothing of it, pictures do

Box = tuple[slice, slice, slice]


def voxels_over(grid: Grid, spacing_mm: Sequence[float]) -> Grid:
    """Voxels of another size over the whole of a grid, with the same centre.

    Parameters
    ----------
    spacing_mm : sequence of 3 float
        (z, y, x).
    """
    shape = [math.ceil(long / wide - 1e-6) for long, wide in zip(grid.extent_mm, spacing_mm, strict=True)]
    return Grid(tuple(shape), tuple(spacing_mm), grid.centre_mm)


def boxes_around(masks: Iterable[np.ndarray], grid: Grid, margin_mm: float = MARGIN_MM) -> list[Box]:
    """The box of each region and a margin around it, cut at the grid's border.

    Parameters
    ----------
    masks : iterable of ndarray of bool, shape (z, y, x)
        None empty.

    Returns
    -------
    list of tuple of 3 slice
    """
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


def fbp_in_boxes(
    line_integrals: np.ndarray,
    geometry: ScanGeometry,
    grid: Grid,
    boxes: Sequence[Box],
    *,
    mu_water_per_mm: float,
    thickness_mm: float | None = None,
    kernel: Kernel | None = None,
    threads: int = 1,
) -> np.ndarray:
    """Images of every acquisition, not rounded; air outside of the boxes.

    Parameters
    ----------
    line_integrals : ndarray, shape (acquisitions, views, rows, columns)
    geometry : ScanGeometry
        A circle or helix.
    grid, boxes, mu_water_per_mm, thickness_mm, threads
        As back_in_boxes takes them.
    kernel : Kernel, optional
        None: the ramp alone.

    Returns
    -------
    ndarray of float32, shape (acquisitions, z, y, x)
        HU.

    Raises
    ------
    InputError
        As fbp.fbp does of a scan.
    """
    rays = ParallelProjections.of(line_integrals, geometry, kernel)
    return back_in_boxes(rays, grid, boxes, mu_water_per_mm=mu_water_per_mm, thickness_mm=thickness_mm, threads=threads)


def back_in_boxes(
    rays: ParallelProjections,
    grid: Grid,
    boxes: Sequence[Box],
    *,
    mu_water_per_mm: float,
    thickness_mm: float | None = None,
    threads: int = 1,
) -> np.ndarray:
    """The same of projections that are sorted and filtered, which slices of several thicknesses may share.

    Parameters
    ----------
    grid : Grid
        Of the whole image, the isocentre in its middle.
    boxes : sequence of tuple of 3 slice
        What is made of it.
    mu_water_per_mm : float
        Linear attenuation of water, 1/mm.
    thickness_mm : float, optional
        Of slices, as slices.thin_slices; None: the slices lie in planes, as `fbp` makes them.

    Returns
    -------
    ndarray of float32, shape (acquisitions, z, y, x)
        HU.
    """
    lanes = rays.packed.shape[-1]
    images = np.full((lanes, *grid.shape), HU_AIR, np.float32)
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
        made = rays.back(CpuProjector(rays.rays.geometry, part, lanes, threads, centre_mm))
        if weights is not None:
            made = np.einsum("st,ltyx->lsyx", weights, made, optimize=True)
        images[:, *box] = attenuation_to_hu(made, mu_water_per_mm)
    return images
