"""Grid and detector that cover a body and its regions."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ...base.errors import InputError
from ...base.geometry import Grid
from ...io.study_sizes import paper_groups
from .regions import Region

STEP_MM = 0.05  # voxel sizes are multiples of it
PITCH_STEP_MM = 0.5  # pixel pitches of the detector are multiples of it
SLICE_SHARE = 0.85  # ratio of slice thickness to voxel width, as in config/paper_groups.yaml (2 of 2.35 mm)
END_MM = 10.0  # also scanned beyond the regions, because the cone angle degrades the ends of an object
FINEST_OVERSAMPLING, COARSEST_OVERSAMPLING = 2, 4
_SCAN = paper_groups()["scan"]
RADIUS_MM = _SCAN["source_to_isocentre_mm"]
MAGNIFICATION = _SCAN["source_to_detector_mm"] / RADIUS_MM
LARGEST_REACH = 0.6  # radius of a body relative to that of the source's orbit: a fan of 74 degrees
SPARE = 1.03  # field of view relative to the body
SPARE_ROWS = 4
COLUMNS_STEP = 4


def propose_grid(
    ct: Grid, box_mm: Sequence[Sequence[float]], regions: Sequence[Region], voxels_across: int
) -> tuple[Grid, int]:
    """Return a grid that contains the box in-plane and all regions along z.

    Parameters
    ----------
    box_mm : sequence
        Scanned box, [[x, x], [y, y]], NIfTI world mm.
    voxels_across : int
        Maximum number of voxels along the longer side of the box.

    Returns
    -------
    grid : Grid
        Grid in NIfTI world coordinates.
    oversampling : int
        Oversampling that makes the fine voxels about as large as the CT's pixels.
    """
    sides = [high - low for low, high in box_mm]
    pixel = min(ct.spacing[1:])
    in_plane = math.ceil(max(max(sides) / (voxels_across - 1), pixel) / STEP_MM) * STEP_MM
    thick = ct.spacing[0] * max(1, round(SLICE_SHARE * in_plane / ct.spacing[0]))
    # Use whole slices of the CT, so that slices of equal thickness are not interpolated.
    first, last = scanned_slices(ct, regions)
    count = max(1, round((last - first) * ct.spacing[0] / thick))
    middle = ct.centre_mm[2] + ((first + last) / 2 - ct.shape[0] / 2) * ct.spacing[0]
    shape = (count, *(2 * math.ceil((side / in_plane + 1) / 2) for side in reversed(sides)))
    centre = (sum(box_mm[0]) / 2, sum(box_mm[1]) / 2, middle)
    grid = Grid(shape, (round(thick, 4), round(in_plane, 4), round(in_plane, 4)), tuple(round(c, 4) for c in centre))
    fine = round(in_plane / pixel)
    return grid, min(max(fine, FINEST_OVERSAMPLING), COARSEST_OVERSAMPLING)


def scanned_slices(ct: Grid, regions: Sequence[Region]) -> tuple[int, int]:
    """Return the first and the end slice of the CT that are scanned: the regions and up to END_MM around them."""
    more = round(END_MM / ct.spacing[0])
    first = max(0, min(region.box[0].start for region in regions) - more)
    last = min(ct.shape[0], max(region.box[0].stop for region in regions) + more)
    return first, last


def propose_scan(grid: Grid, reach_mm: float) -> dict:
    """Return the keys of `scan` for the distances of source and detector and the size of the detector.

    Parameters
    ----------
    reach_mm : float
        Largest distance of the body from the isocenter, mm.

    Raises
    ------
    InputError
        If the body is wider than the field of view of any scanner.
    """
    radius = RADIUS_MM
    if reach_mm > LARGEST_REACH * radius:
        radius = 50 * math.ceil(reach_mm / LARGEST_REACH / 50)
    if reach_mm > 10 * RADIUS_MM:
        raise InputError(f"CT: the body reaches {reach_mm:.0f} mm from the isocenter; check its voxel size (mm)")
    column_pitch = _pitch(grid.spacing[2])
    row_pitch = _pitch(grid.spacing[0])
    half = math.tan(math.asin(min(SPARE * reach_mm / radius, 0.99))) * MAGNIFICATION * radius
    columns = COLUMNS_STEP * math.ceil(2 * half / column_pitch / COLUMNS_STEP)
    rows = math.ceil(grid.extent_mm[0] * MAGNIFICATION / row_pitch) + SPARE_ROWS
    return {
        "source_to_isocentre_mm": radius,
        "source_to_detector_mm": round(MAGNIFICATION * radius),
        "columns": columns,
        "column_pitch_mm": column_pitch,
        "rows": rows + rows % 2,
        "row_pitch_mm": row_pitch,
    }


def _pitch(voxel_mm: float) -> float:
    """Return the largest pixel pitch that samples the isocenter at least as finely as the voxels."""
    wide = MAGNIFICATION * voxel_mm
    return math.floor(wide / PITCH_STEP_MM + 1e-6) * PITCH_STEP_MM if wide > PITCH_STEP_MM else wide
