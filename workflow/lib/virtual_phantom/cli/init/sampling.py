"""Voxels and detector that cover a body and the regions in it."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ...base.errors import InputError
from ...base.geometry import Grid
from ...io.default_study import default_study
from .regions import Region

STEP_MM = 0.05  # voxel sizes are multiples of it
PITCH_STEP_MM = 0.5  # as are pitches of the detector
SLICE_SHARE = 0.85  # of a voxel's width that a slice is thick at least, as in config/config.yaml (2 of 2.35 mm)
END_MM = 10.0  # of the CT beyond the regions that is scanned too: ends of an object suffer from the cone angle
FINEST_OVERSAMPLING, COARSEST_OVERSAMPLING = 2, 4
_SCAN = default_study()["scan"]
RADIUS_MM = _SCAN["source_to_isocentre_mm"]
MAGNIFICATION = _SCAN["source_to_detector_mm"] / RADIUS_MM
LARGEST_REACH = 0.6  # of a body, of the source's radius: a fan of 74 degrees
SPARE = 1.03  # of the field of view over the body
SPARE_ROWS = 4
COLUMNS_STEP = 4


def propose_grid(
    ct: Grid, box_mm: Sequence[Sequence[float]], regions: Sequence[Region], voxels_across: int
) -> tuple[Grid, int]:
    """The grid that holds the box in-plane and all regions along z, and its oversampling.

    Parameters
    ----------
    box_mm : sequence
        Box that is scanned, [[x, x], [y, y]], NIfTI world mm.
    voxels_across : int
        At most, along the box's longer side.

    Returns
    -------
    grid : Grid
        At its place in the world.
    oversampling : int
        That comes near the CT's own pixels.
    """
    sides = [high - low for low, high in box_mm]
    pixel = min(ct.spacing[1:])
    in_plane = math.ceil(max(max(sides) / (voxels_across - 1), pixel) / STEP_MM) * STEP_MM
    thick = ct.spacing[0] * max(1, round(SLICE_SHARE * in_plane / ct.spacing[0]))
    # Whole slices of the CT, so that nothing is interpolated where the grid's are as thick.
    first, last = scanned_slices(ct, regions)
    count = max(1, round((last - first) * ct.spacing[0] / thick))
    middle = ct.centre_mm[2] + ((first + last) / 2 - ct.shape[0] / 2) * ct.spacing[0]
    shape = (count, *(2 * math.ceil((side / in_plane + 1) / 2) for side in reversed(sides)))
    centre = (sum(box_mm[0]) / 2, sum(box_mm[1]) / 2, middle)
    grid = Grid(shape, (round(thick, 4), round(in_plane, 4), round(in_plane, 4)), tuple(round(c, 4) for c in centre))
    fine = round(in_plane / pixel)
    return grid, min(max(fine, FINEST_OVERSAMPLING), COARSEST_OVERSAMPLING)


def scanned_slices(ct: Grid, regions: Sequence[Region]) -> tuple[int, int]:
    """Return from which to which slice of the CT the regions reach, with END_MM where there is more of it."""
    more = round(END_MM / ct.spacing[0])
    first = max(0, min(region.box[0].start for region in regions) - more)
    last = min(ct.shape[0], max(region.box[0].stop for region in regions) + more)
    return first, last


def propose_scan(grid: Grid, reach_mm: float) -> dict:
    """The part of `scan` that says where source and detector are, and how large the detector is.

    Parameters
    ----------
    reach_mm : float
        How far the body reaches from the isocentre, mm.

    Raises
    ------
    InputError
        If the body is wider than any scanner's field of view.
    """
    radius = RADIUS_MM
    if reach_mm > LARGEST_REACH * radius:
        radius = 50 * math.ceil(reach_mm / LARGEST_REACH / 50)
    if reach_mm > 10 * RADIUS_MM:
        raise InputError(f"CT: the body reaches {reach_mm:.0f} mm from the isocentre; is its voxel size in mm?")
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
    """Of a detector that samples the isocentre as finely as the voxels or finer."""
    wide = MAGNIFICATION * voxel_mm
    return math.floor(wide / PITCH_STEP_MM + 1e-6) * PITCH_STEP_MM if wide > PITCH_STEP_MM else wide
