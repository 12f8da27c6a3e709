"""Scanned box of a CT: the body with the regions, without separate arms and the table."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import label

from ...base.errors import InputError
from ...base.geometry import Grid
from ...base.units import HU_BODY
from ...io.volumes import Volume
from ...phantom.body import Body, edges_mm, find_body
from ...phantom.ct import kept_columns
from .regions import Region

AROUND_MM = 3.0  # air around the body


def keep_box(image: Volume, regions: Sequence[Region], slices: tuple[int, int]) -> tuple[list, list[Region]]:
    """Return the box around the body, and the regions outside of it.

    Parameters
    ----------
    image : Volume
        The CT, HU.
    slices : tuple of int
        First and end slice that are scanned.

    Returns
    -------
    box : list
        [[x, x], [y, y]], NIfTI world mm, see phantom.ct.keep_mm.
    outside : list of Region
        Regions that lie at least partly outside of the box, as in an arm.

    Raises
    ------
    InputError
        If the CT shows no body.
    """
    body = find_body(image, *slices)
    if not body.mask.any():
        raise InputError(f"CT: no voxel is denser than {HU_BODY:g} HU; check that its values are in HU")
    body = _with_regions(body, regions)
    box = []
    for axis in (2, 1):
        low, high = edges_mm(image.grid, axis, body.pixels_of(axis))
        box.append([math.floor(low - AROUND_MM), math.ceil(high + AROUND_MM)])
    outside = [region for region in regions if not within(region, box)]
    return box, outside


def box_is_needed(image: Volume, box: list, grid: Grid) -> bool:
    """Return whether the slices of the study's grid contain dense voxels outside of a box of `keep_box`."""
    z = image.grid.axes_mm()[0] + image.grid.centre_mm[2] - grid.centre_mm[2]
    seen = np.abs(z) <= (grid.extent_mm[0] + image.grid.spacing[0]) / 2
    return bool(((image.array[seen] > HU_BODY).any(axis=0) & ~kept_columns(box, image.grid)).any())


def within(region: Region, box: Sequence[Sequence[float]]) -> bool:
    """Return whether a region lies completely inside a box of `keep_box`."""
    _, y, x = region.bounds_mm
    return all(low <= edges[0] and edges[1] <= high for edges, (low, high) in zip((x, y), box, strict=True))


def widened_box(box: Sequence[Sequence[float]], regions: Sequence[Region]) -> list[list[float]]:
    """Return the smallest box that contains a box of `keep_box` and the regions."""
    wide = [list(edges) for edges in box]
    for region in regions:
        _, y, x = region.bounds_mm
        for edges, (low, high) in zip(wide, (x, y), strict=True):
            edges[0] = min(edges[0], math.floor(low - AROUND_MM))
            edges[1] = max(edges[1], math.ceil(high + AROUND_MM))
    return wide


def _with_regions(body: Body, regions: Sequence[Region]) -> Body:
    """Return the body. If most region voxels lie in one detached piece, such as a hand, the piece is added."""
    pieces, count = label(body.detached)
    if not count or not regions:
        return body
    votes = np.zeros(count + 1, np.int64)
    for region in regions:
        z, y, x = np.nonzero(region.mask)
        at = tuple(
            np.clip((i + part.start - start) // block, 0, n - 1)
            for i, part, start, block, n in zip(
                (z, y, x), region.box, (body.first, 0, 0), body.blocks, body.mask.shape, strict=True
            )
        )
        votes += np.bincount(pieces[at], minlength=count + 1)
    most = int(votes[1:].argmax()) + 1
    return body.with_piece(pieces == most) if votes[most] > votes[0] else body
