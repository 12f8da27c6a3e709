"""What of a phantom a scan sees, and how large a detector would see all of it."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from ..base.errors import InputError
from ..base.geometry import Grid, scan_geometry
from ..base.parallel_rays import ParallelRays
from ..base.units import HU_BODY
from ..base.vectors import FLAT
from ..io.volumes import Volume
from ..physics.line_integrals import hardest_points, share_seen

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
    projections : int
    grid : Grid
    points_mm : ndarray, shape (points, 3)
        (x, y, z) from the isocentre.

    Returns
    -------
    float

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
    projections : int
    grid : Grid
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
