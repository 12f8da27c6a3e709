"""The part of a CT that is scanned: the body with the regions in it, without arms beside it and table."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import distance_transform_edt, label
from skimage.measure import block_reduce

from ...base.errors import InputError
from ...base.units import HU_BODY
from ...io.volumes import Volume
from .regions import Region

COARSE_MM = 4.0  # pixels at which the body is looked for: a fourth of those of a clinical CT
# Of the radius of the largest circle in the body: what is narrower than such a circle is cut off, as where an arm lies
# on. Arms come off a clinical abdomen (config/abdomen.yaml) from 0.3 to 0.6.
BRIDGE = 0.4
APART_MM = 1e4  # between slices, so that each is looked at alone
AROUND_MM = 3.0  # air that is left around the body


def keep_box(image: Volume, regions: Sequence[Region]) -> tuple[list[list[float]], list[Region]]:
    """The box that holds the body, and the regions that lie out of it.

    Parameters
    ----------
    image : Volume
        The CT, HU.
    regions : sequence of Region

    Returns
    -------
    keep_mm : list
        As phantom.ct.keep_mm: [[x, x], [y, y]], NIfTI world mm.
    outside : list of Region
        Those of which a part lies in another piece of the body, as in an arm.

    Raises
    ------
    InputError
        If the CT shows no body.
    """
    factor = max(1, round(COARSE_MM / image.grid.spacing[2]))
    # A block that holds some air is air: what is a pixel apart stays apart. Beyond the CT's columns there is air.
    body = block_reduce(image.array > HU_BODY, (1, factor, factor), np.min)
    opened = _opened(body, factor * image.grid.spacing[2])
    pieces, count = label(opened)
    if not count:
        raise InputError(f"CT: nothing in it is denser than {HU_BODY:g} HU; is it in HU?")
    trunk = pieces == _piece_of_most(pieces, regions, factor)
    edges = [np.flatnonzero(trunk.any(axis=axes)) for axes in ((0, 1), (0, 2))]  # x, y
    box = []
    for axis, index in zip((2, 1), edges, strict=True):
        wide, n = image.grid.spacing[axis], image.grid.shape[axis]
        start = image.grid.centre_mm[2 - axis] - n / 2 * wide
        low, high = max(0, (index[0] - 1) * factor), min((index[-1] + 2) * factor, n)
        box.append([math.floor(start + low * wide - AROUND_MM), math.ceil(start + high * wide + AROUND_MM)])
    outside = [region for region in regions if not within(region, box)]
    return box, outside


def _opened(body: np.ndarray, pixel_mm: float) -> np.ndarray:
    """The body, slice by slice, without what is narrower than a circle of BRIDGE times its own size."""
    sampling = (APART_MM, pixel_mm, pixel_mm)
    depth = distance_transform_edt(np.pad(body, ((0, 0), (1, 1), (1, 1))), sampling=sampling)[:, 1:-1, 1:-1]
    radius = BRIDGE * float(depth.max())
    return distance_transform_edt(depth <= radius, sampling=sampling) <= radius if radius else body


def within(region: Region, box: Sequence[Sequence[float]]) -> bool:
    """Whether a region lies whole in a box as of `keep_box`."""
    _, y, x = region.bounds_mm
    return all(low <= edges[0] and edges[1] <= high for edges, (low, high) in zip((x, y), box, strict=True))


def widened(box: Sequence[Sequence[float]], regions: Sequence[Region]) -> list[list[float]]:
    """The smallest box around one as of `keep_box` and regions."""
    wide = [list(edges) for edges in box]
    for region in regions:
        _, y, x = region.bounds_mm
        for edges, (low, high) in zip(wide, (x, y), strict=True):
            edges[0] = min(edges[0], math.floor(low - AROUND_MM))
            edges[1] = max(edges[1], math.ceil(high + AROUND_MM))
    return wide


def _piece_of_most(pieces: np.ndarray, regions: Sequence[Region], factor: int) -> int:
    """The number of the piece that holds most of the regions' voxels; without any, the largest."""
    votes = np.zeros(pieces.max() + 1, np.int64)
    for region in regions:
        z, y, x = np.nonzero(region.mask)
        at = pieces[z + region.box[0].start, (y + region.box[1].start) // factor, (x + region.box[2].start) // factor]
        votes += np.bincount(at, minlength=len(votes))
    if not votes[1:].any():
        votes = np.bincount(pieces.ravel())
    votes[0] = 0
    return int(votes.argmax())
