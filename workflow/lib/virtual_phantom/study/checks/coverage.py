"""Coverage of a phantom by a scan, and the detector size that covers all of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import distance_transform_edt
from skimage.measure import block_reduce

from ...base.errors import InputError
from ...base.geometry import Grid, scan_geometry
from ...base.parallel_rays import ParallelRays
from ...base.settings import ScanSettings
from ...base.units import HU_BODY
from ...base.vectors import FLAT
from ...io.volumes import Volume
from ...phantom.body import edges_mm, find_body
from ...physics.scenes.line_integrals import hardest_points, share_seen

TISSUE_HU = -300.0  # below fat (-100) by more than the noise; excludes lungs and air
MOST_POINTS = 500  # points of an ROI at each extreme; jobs check all points again
MOST_PIXELS = 16384  # maximum of detector rows or columns in the schema of the configuration


def reach_mm(image: Volume, grid: Grid) -> float:
    """Return the largest distance of body voxels (their centers) from the axis of rotation, mm; 0 without a body.

    Parameters
    ----------
    image : Volume
        HU. Slices above and below the grid are ignored.
    grid : Grid
        Its center is the isocenter.
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
class RemovedTissue:
    """Tissue that keep_mm replaces by air, in the scanned slices.

    Attributes
    ----------
    share : float
        Removed fraction of all tissue.
    detached_share : float
        Removed fraction of all tissue that is separate from the body, such as arms and a table.
    body_share : float
        Removed fraction of the body's tissue.
    columns : ndarray of bool, shape (y, x)
        Columns of the CT that lose voxels of the body.
    box_mm : list
        Box that contains the whole body, [[x, x], [y, y]], NIfTI world mm.
    """

    share: float
    detached_share: float
    body_share: float
    columns: np.ndarray
    box_mm: list
    ct: Grid

    def distance_mm(self, grid: Grid, mask: np.ndarray) -> float:
        """Return the smallest in-plane distance from a mask on a grid to removed voxels of the body."""
        distance = distance_transform_edt(~self.columns, sampling=self.ct.spacing[1:])
        index = []
        for axis, pixels in zip((1, 2), np.nonzero(mask.any(axis=0)), strict=True):
            position = grid.axes_mm()[axis][pixels] + grid.centre_mm[2 - axis] - self.ct.centre_mm[2 - axis]
            n = self.ct.shape[axis]
            index.append(np.clip(np.rint(position / self.ct.spacing[axis] + (n - 1) / 2).astype(int), 0, n - 1))
        return float(distance[tuple(index)].min())


def removed_tissue(image: Volume, grid: Grid, kept: np.ndarray) -> RemovedTissue:
    """Measure the tissue that keep_mm removes.

    Parameters
    ----------
    image : Volume
        The whole CT, HU.
    grid : Grid
        Grid of the study. Slices above and below it are not scanned.
    kept : ndarray of bool, shape (y, x)
        Columns of the CT inside keep_mm.
    """
    z = image.grid.axes_mm()[0] + image.grid.centre_mm[2] - grid.centre_mm[2]
    seen = np.flatnonzero(np.abs(z) <= (grid.extent_mm[0] + image.grid.spacing[0]) / 2)
    first, last = int(seen[0]), int(seen[-1]) + 1
    body = find_body(image, first, last)
    tissue = image.array[first:last] > TISSUE_HU
    total = np.count_nonzero(tissue)
    counts = block_reduce(tissue, body.blocks, np.count_nonzero)
    rows, columns = np.nonzero(~kept)
    lost = tissue[:, rows, columns]
    z, y, x = body.blocks
    of_body = body.mask[(np.arange(last - first) // z)[:, None], (rows // y)[None], (columns // x)[None]] & lost
    cut = np.zeros(kept.shape, bool)
    cut[rows, columns] = of_body.any(axis=0)
    lost_of_body = np.count_nonzero(of_body)
    box = []
    for axis in (2, 1):
        low, high = edges_mm(image.grid, axis, body.pixels_of(axis)) if body.mask.any() else (0.0, 0.0)
        box.append([math.floor(low), math.ceil(high)])
    return RemovedTissue(
        share=np.count_nonzero(lost) / max(total, 1),
        detached_share=(np.count_nonzero(lost) - lost_of_body) / max(total, 1),
        body_share=lost_of_body / max(int(counts[body.mask].sum()), 1),
        columns=cut,
        box_mm=box,
        ct=image.grid,
    )


def columns_for(reach: float, scan: ScanSettings) -> int | None:
    """Return the smallest number of detector columns whose field of view contains a circle with radius `reach`, mm.

    It is None if the source lies inside the circle or the detector would need too many columns.
    """
    if reach >= scan.source_to_isocentre_mm:
        return None
    half = _half_mm(math.asin(reach / scan.source_to_isocentre_mm), scan)
    columns = math.ceil(2 * (half / scan.column_pitch_mm + abs(scan.column_offset_px)))
    return columns if columns <= MOST_PIXELS else None


def _half_mm(fan_rad: float, scan: ScanSettings) -> float:
    """Return where a ray with a fan angle meets the detector, mm from its center, including a flying focal spot."""
    distance = scan.source_to_detector_mm
    spots = (abs(spot.columns_mm) for spot in scan.flying_focal_spot or ())
    shift = (distance / scan.source_to_isocentre_mm - 1) * max(spots, default=0.0)
    if scan.detector == FLAT:
        return math.tan(fan_rad) * distance + shift
    radius = scan.arc_radius_mm or distance
    return (fan_rad + math.asin((distance - radius) * math.sin(fan_rad) / radius)) * radius + shift


def worst_share(scan: ScanSettings, projections: int, grid: Grid, points_mm: np.ndarray) -> float:
    """Return the fraction of the directions of half a turn from which a scan sees the worst of some points.

    The points have the shape (points, 3), (x, y, z) from the isocenter.

    Raises
    ------
    InputError
        For a scan that covers less than half a turn.
    """
    return share_seen(ParallelRays(scan_geometry(scan, projections, grid)), points_mm)


def rows_for(scan: ScanSettings, projections: int, grid: Grid, points_mm: np.ndarray) -> int | None:
    """Return a number of detector rows, more than the scan has, that see points from every direction of half a turn.

    It is None if no number of rows suffices. Fewer rows may suffice too, because a helix then has more turns. Points
    have the shape (points, 3), (x, y, z) from the isocenter.
    """

    def enough(rows: int) -> bool:
        try:
            return worst_share(replace(scan, rows=rows), projections, grid, points_mm) == 1
        except InputError:
            return False

    # Seen from the far side of the orbit, twice the height of the grid.
    tall = 2 * grid.extent_mm[0] * scan.source_to_detector_mm / (scan.source_to_isocentre_mm / 2)
    most = min(MOST_PIXELS, max(2 * scan.rows, math.ceil(2 * tall / scan.row_pitch_mm)))
    low, high = scan.rows, scan.rows + 1
    while not enough(high):
        if high == most:
            return None
        low, high = high, min(2 * high, most)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if enough(middle) else (middle, high)
    return high


def points_of(grid: Grid, masks: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return {ROI: points that are hardest to see}, shape (points, 3), mm from the isocenter."""
    return {name: _thinned(hardest_points(grid, mask)) for name, mask in masks.items()}


def _thinned(points: np.ndarray) -> np.ndarray:
    """Reduce many points to those farthest along z and from the axis: a scan that sees these sees the others too."""
    if len(points) <= 2 * MOST_POINTS:
        return points
    z, radius = np.abs(points[:, 2]), np.hypot(points[:, 0], points[:, 1])
    chosen = {*np.argsort(-z, kind="stable")[:MOST_POINTS], *np.argsort(-radius, kind="stable")[:MOST_POINTS]}
    return points[sorted(chosen)]
