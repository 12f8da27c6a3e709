"""Noise-free monochromatic line integrals of a phantom in HU, and checks of the field of view."""

from __future__ import annotations

import numpy as np

from ...base.errors import InputError
from ...base.geometry import Grid, ScanGeometry, orbit_of
from ...base.parallel_rays import ParallelRays
from ...base.pose import IN_PLACE, Pose, turned_back
from ...base.units import HU_BODY, hu_to_attenuation
from ...io.volumes import Volume
from ...projectors.cpu import CpuProjector


def clean_line_integrals(
    phantom: Volume, geometry: ScanGeometry, mu_water_per_mm: float, threads: int = 1, pose: Pose = IN_PLACE
) -> np.ndarray:
    """Return monochromatic line integrals of a phantom on any grid, float32, shape (views, rows, columns).

    The CPU engine is always used: a phantom is projected only once, which takes seconds.

    Parameters
    ----------
    phantom : Volume
        HU.
    pose : Pose, optional
        Pose of the phantom. The scan moves in the opposite direction, so that nothing is interpolated.

    Raises
    ------
    InputError
        As check_scannable.
    """
    check_scannable(phantom, geometry, pose)
    moved_scan, shift_mm = turned_back(geometry, pose, None)
    projector = CpuProjector(moved_scan, phantom.grid, threads=threads, centre_mm=shift_mm)
    volume = projector.pack_volume(hu_to_attenuation(phantom.array, mu_water_per_mm)[None])
    return projector.unpack_projections(projector.forward(volume))[0]


def check_scannable(phantom: Volume, geometry: ScanGeometry, pose: Pose = IN_PLACE) -> None:
    """Check that a phantom in HU can be scanned.

    Raises
    ------
    InputError
        If the phantom has NaN or infinite voxels, or extends beyond the field of view, where reconstructions would
        have truncation artifacts.
    """
    if not np.isfinite(phantom.array).all():
        raise InputError("phantom image: holds NaN or infinite voxels; repair the CT that it was made from")
    _, y, x = phantom.grid.axes_mm()
    occupied = (phantom.array > HU_BODY).any(axis=0)
    shift_x, shift_y, _ = turned_back(geometry, pose, None)[1]
    reach = float(np.max(np.hypot(y[:, None] + shift_y, x[None, :] + shift_x), where=occupied, initial=0))
    radius = orbit_of(geometry, "a check of the field of view").field_of_view_radius_mm
    if reach > radius:
        raise InputError(
            f"scan: the phantom reaches {reach:.0f} mm from the isocenter, the field of view only {radius:.0f} mm; "
            "give the detector more columns or a larger column_pitch_mm, or move the phantom's center"
        )


def check_rois_seen(geometry: ScanGeometry, grid: Grid, masks: dict[str, np.ndarray]) -> None:
    """Check that every voxel of every ROI is seen from every direction of half a turn.

    No algorithm can reconstruct other voxels exactly [1]_, and their errors would change every feature of the ROI.

    Raises
    ------
    InputError
        Naming the ROI, if one is not, or if one is empty.

    References
    ----------
    .. [1] H. K. Tuy, SIAM J. Appl. Math. 43, 546, 1983.
    """
    rays = ParallelRays(geometry)
    for name, mask in masks.items():
        if not mask.any():
            raise InputError(f"scan: ROI {name} has no voxel; remove it")
        share = share_seen(rays, hardest_points(grid, mask))
        if share < 1:
            raise InputError(
                f"scan: ROI {name} is not seen from every direction: {100 * share:.0f} % of half a turn at worst; use "
                "more detector rows or columns, more projections, a smaller pitch or more turns"
            )


def hardest_points(grid: Grid, mask: np.ndarray) -> np.ndarray:
    """Return the points of a region seen from the fewest directions: the lowest and highest voxel of each column.

    Parameters
    ----------
    mask : ndarray of bool, shape (z, y, x)
        Not empty.

    Returns
    -------
    ndarray, shape (points, 3)
        (x, y, z), mm.
    """
    z, y, x = grid.axes_mm()
    columns = np.argwhere(mask.any(axis=0))
    along = mask[:, columns[:, 0], columns[:, 1]]
    lowest, highest = along.argmax(axis=0), len(z) - 1 - along[::-1].argmax(axis=0)
    return np.concatenate([np.column_stack([x[columns[:, 1]], y[columns[:, 0]], z[end]]) for end in (lowest, highest)])


def share_seen(rays: ParallelRays, points_mm: np.ndarray) -> float:
    """Return the smallest share of the directions of half a turn from which one of the points is seen."""
    return float(rays.directions_seen(points_mm).min() / rays.half_turn)
