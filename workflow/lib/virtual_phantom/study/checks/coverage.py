"""What of a phantom a scan sees, and how large a detector would see all of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt
from skimage.measure import block_reduce

from ...base.errors import InputError
from ...base.geometry import Grid, scan_geometry
from ...base.parallel_rays import ParallelRays
from ...base.units import HU_BODY
from ...base.vectors import FLAT
from ...io.volumes import Volume
from ...phantom.body import body_of, edges_mm
from ...physics.scenes.line_integrals import hardest_points, share_seen

TISSUE_HU = -300.0  # fat (-100) and denser, with noise; lungs and air do not count
MOST_POINTS = 500  # of an ROI, at either extreme; jobs look at all of them again
MOST_PIXELS = 16384  # rows or columns of a detector, as the configuration's schema allows


def reach_mm(image: Volume, grid: Grid) -> float:
    """How far voxels of the body, their centres, reach from the isocentre's axis.

    Parameters
    ----------
    image : Volume
        HU; what lies above or below the grid does not count.
    grid : Grid
        Its centre is the isocentre.

    Returns
    -------
    float
        mm; 0 without a body.
    """
    z, y, x = (
        axis + here - there
        for axis, here, there in zip(
            image.grid.axes_mm(), image.grid.centre_mm[::-1], grid.centre_mm[::-1], strict=True
        )
    )
    seen = np.abs(z) <= (grid.extent_mm[0] + image.grid.spacing[0]) / 2
    occupied = (image.array[seen] > HU_BODY).any(axis=0)
    return float(np.max(np.hypot(y[:, None], x[None, :]), where=occupied, initial=0))


@dataclass(frozen=True)
class Removed:
    """Tissue that keep_mm turns into air, in the slices that are scanned.

    Attributes
    ----------
    share : float
        Of all tissue.
    apart_share : float
        Of all tissue, what lies apart from the body, as arms and a table do.
    body_share : float
        Of the body's tissue, what is removed of the body.
    columns : ndarray of bool, shape (y, x)
        Columns of the CT that lose voxels of the body.
    box_mm : list
        [[x, x], [y, y]], NIfTI world mm: contains the whole body.
    """

    share: float
    apart_share: float
    body_share: float
    columns: np.ndarray
    box_mm: list
    ct: Grid

    def distance_mm(self, grid: Grid, mask: np.ndarray) -> float:
        """Return the least distance in-plane from a mask on a grid to what is removed of the body."""
        away = distance_transform_edt(~self.columns, sampling=self.ct.spacing[1:])
        index = []
        for axis, places in zip((1, 2), np.nonzero(mask.any(axis=0)), strict=True):
            at = grid.axes_mm()[axis][places] + grid.centre_mm[2 - axis] - self.ct.centre_mm[2 - axis]
            n = self.ct.shape[axis]
            index.append(np.clip(np.rint(at / self.ct.spacing[axis] + (n - 1) / 2).astype(int), 0, n - 1))
        return float(away[tuple(index)].min())


def removed_tissue(image: Volume, grid: Grid, kept: np.ndarray) -> Removed:
    """Measure the tissue that keep_mm removes.

    Parameters
    ----------
    image : Volume
        The whole CT, HU.
    grid : Grid
        The study's: slices above and below it are not scanned.
    kept : ndarray of bool, shape (y, x)
        Columns of the CT within keep_mm.
    """
    z = image.grid.axes_mm()[0] + image.grid.centre_mm[2] - grid.centre_mm[2]
    seen = np.flatnonzero(np.abs(z) <= (grid.extent_mm[0] + image.grid.spacing[0]) / 2)
    first, last = int(seen[0]), int(seen[-1]) + 1
    body = body_of(image, first, last)
    tissue = image.array[first:last] > TISSUE_HU
    total = np.count_nonzero(tissue)
    counts = block_reduce(tissue, body.blocks, np.count_nonzero)
    rows, columns = np.nonzero(~kept)
    lost = tissue[:, rows, columns]
    z, y, x = body.blocks
    of_body = body.mask[(np.arange(last - first) // z)[:, None], (rows // y)[None], (columns // x)[None]] & lost
    cut = np.zeros(kept.shape, bool)
    cut[rows, columns] = of_body.any(axis=0)
    own = np.count_nonzero(of_body)
    box = []
    for axis in (2, 1):
        low, high = edges_mm(image.grid, axis, body.pixels_of(axis)) if body.mask.any() else (0.0, 0.0)
        box.append([math.floor(low), math.ceil(high)])
    return Removed(
        share=np.count_nonzero(lost) / max(total, 1),
        apart_share=(np.count_nonzero(lost) - own) / max(total, 1),
        body_share=own / max(int(counts[body.mask].sum()), 1),
        columns=cut,
        box_mm=box,
        ct=image.grid,
    )


def columns_for(reach: float, scan: Mapping) -> int | None:
    """The fewest detector columns whose field of view holds a circle.

    Parameters
    ----------
    reach : float
        The circle's radius, mm.
    scan : mapping
        A complete `scan` section.

    Returns
    -------
    int or None
        None: no detector does, as the source is nearer than that or it would need too many.
    """
    if reach >= scan["source_to_isocentre_mm"]:
        return None
    half = _half_mm(math.asin(reach / scan["source_to_isocentre_mm"]), scan)
    columns = math.ceil(2 * (half / scan["column_pitch_mm"] + abs(scan["column_offset_px"])))
    return columns if columns <= MOST_PIXELS else None


def _half_mm(fan_rad: float, scan: Mapping) -> float:
    """How far along the detector a ray of a fan angle meets it, and a flying focal spot's beside it."""
    distance = scan["source_to_detector_mm"]
    beyond = distance / scan["source_to_isocentre_mm"] - 1
    flown = beyond * max(
        (abs(spot.get("columns_mm", 0.0)) for spot in scan.get("flying_focal_spot") or []), default=0.0
    )
    if scan.get("detector", FLAT) == FLAT:
        return math.tan(fan_rad) * distance + flown
    radius = scan.get("arc_radius_mm") or distance
    return (fan_rad + math.asin((distance - radius) * math.sin(fan_rad) / radius)) * radius + flown


def worst_share(scan: Mapping, projections: int, grid: Grid, points_mm: np.ndarray) -> float:
    """Of the directions of half a turn, the share that the worst of some points is seen from.

    Parameters
    ----------
    scan : mapping
        A complete `scan` section.
    points_mm : ndarray, shape (points, 3)
        (x, y, z) from the isocentre.

    Raises
    ------
    InputError
        For a scan that lacks directions altogether.
    """
    return share_seen(ParallelRays(scan_geometry(dict(scan), projections, grid)), points_mm)


def rows_for(scan: Mapping, projections: int, grid: Grid, points_mm: np.ndarray) -> int | None:
    """The fewest further detector rows that see points from every direction of half a turn, all else as it is.

    Fewer rows may do it too: a helix then has more turns.

    Parameters
    ----------
    scan : mapping
        A complete `scan` section, whose rows do not do it.
    points_mm : ndarray, shape (points, 3)
        (x, y, z) from the isocentre.

    Returns
    -------
    int or None
        How many rows in all; None: rows alone do not do it.
    """

    def enough(rows: int) -> bool:
        try:
            return worst_share({**scan, "rows": rows}, projections, grid, points_mm) == 1
        except InputError:
            return False

    # From the farthest point of the orbit this many rows see the grid twice over.
    tall = 2 * grid.extent_mm[0] * scan["source_to_detector_mm"] / (scan["source_to_isocentre_mm"] / 2)
    most = min(MOST_PIXELS, max(2 * scan["rows"], math.ceil(2 * tall / scan["row_pitch_mm"])))
    low, high = scan["rows"], scan["rows"] + 1
    while not enough(high):
        if high == most:
            return None
        low, high = high, min(2 * high, most)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if enough(middle) else (middle, high)
    return high


def points_of(grid: Grid, masks: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """{ROI: where it is hardest to see}, shape (points, 3), mm from the isocentre."""
    return {name: _thinned(hardest_points(grid, mask)) for name, mask in masks.items()}


def _thinned(points: np.ndarray) -> np.ndarray:
    """Of many points the ones farthest along z and farthest from the axis: the others are seen where these are."""
    if len(points) <= 2 * MOST_POINTS:
        return points
    along, away = np.abs(points[:, 2]), np.hypot(points[:, 0], points[:, 1])
    chosen = {*np.argsort(-along, kind="stable")[:MOST_POINTS], *np.argsort(-away, kind="stable")[:MOST_POINTS]}
    return points[sorted(chosen)]
