"""From a phantom in HU to clean line integrals."""

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
    """Monochromatic line integrals of a phantom, whatever its sampling.

    One pass over a fine grid takes seconds, so it runs on the CPU engine whatever the study reconstructs with.

    Parameters
    ----------
    phantom : Volume
        HU.
    mu_water_per_mm : float
        Linear attenuation of water, 1/mm.
    pose : Pose, optional
        Of the phantom. What moves is the scan around it, so that nothing is interpolated.

    Returns
    -------
    ndarray of float32, shape (views, rows, columns)

    Raises
    ------
    InputError
        As check_scannable.
    """
    check_scannable(phantom, geometry, pose)
    around, shift_mm = turned_back(geometry, pose, None)
    projector = CpuProjector(around, phantom.grid, threads=threads, centre_mm=shift_mm)
    volume = projector.pack_volume(hu_to_attenuation(phantom.array, mu_water_per_mm)[None])
    return projector.unpack_projections(projector.forward(volume))[0]


def check_scannable(phantom: Volume, geometry: ScanGeometry, pose: Pose = IN_PLACE) -> None:
    """Check that a phantom can be scanned.

    Parameters
    ----------
    phantom : Volume
        HU.
    pose : Pose, optional
        Of the phantom.

    Raises
    ------
    InputError
        If the phantom holds a voxel that is no number, or reaches out of the cylinder that every view sees.
    """
    if not np.isfinite(phantom.array).all():
        raise InputError("phantom image: holds NaN or infinite voxels; repair the CT that it was made from")
    _refuse_truncation(phantom, geometry, pose)


def check_rois_seen(geometry: ScanGeometry, grid: Grid, masks: dict[str, np.ndarray]) -> None:
    """Check that every voxel of every ROI is seen from every direction of half a turn.

    One that is not cannot be reconstructed rightly by any algorithm [1]_, and would change every feature of its ROI in
    silence.

    Parameters
    ----------
    masks : dict of str to ndarray of bool, shape (z, y, x)
        On `grid`, by ROI.

    Raises
    ------
    InputError
        Naming the ROI that is not.

    References
    ----------
    .. [1] H. K. Tuy, SIAM J. Appl. Math. 43, 546, 1983.
    """
    rays = ParallelRays(geometry)
    for name, mask in masks.items():
        share = share_seen(rays, hardest_points(grid, mask))
        if share < 1:
            raise InputError(
                f"scan: ROI {name} is not seen from every direction: {100 * share:.0f} % of half a turn where it is "
                "worst; give the detector more rows or columns, a helix a smaller pitch or more turns, or the protocol "
                "more projections"
            )


def hardest_points(grid: Grid, mask: np.ndarray) -> np.ndarray:
    """Where a region is seen from the fewest directions: the lowest and the highest voxel of each of its columns.

    Parameters
    ----------
    mask : ndarray of bool, shape (z, y, x)
        Not empty.

    Returns
    -------
    ndarray, shape (points, 3)
        (x, y, z), mm from the isocentre.
    """
    z, y, x = grid.axes_mm()
    columns = np.argwhere(mask.any(axis=0))
    along = mask[:, columns[:, 0], columns[:, 1]]
    lowest, highest = along.argmax(axis=0), len(z) - 1 - along[::-1].argmax(axis=0)
    return np.concatenate([np.column_stack([x[columns[:, 1]], y[columns[:, 0]], z[end]]) for end in (lowest, highest)])


def share_seen(rays: ParallelRays, points_mm: np.ndarray) -> float:
    """Of the directions of half a turn, the share that the point is seen from that is seen from the fewest."""
    return float(rays.directions_seen(points_mm).min() / rays.half_turn)


def _refuse_truncation(phantom, geometry, pose):
    """Matter outside the field of view would make streaks that no reconstruction here allows for."""
    _, y, x = phantom.grid.axes_mm()
    occupied = (phantom.array > HU_BODY).any(axis=0)
    shift_x, shift_y, _ = turned_back(geometry, pose, None)[1]
    reach = float(np.max(np.hypot(y[:, None] + shift_y, x[None, :] + shift_x), where=occupied, initial=0))
    radius = orbit_of(geometry, "a check of the field of view").field_of_view_radius_mm
    if reach > radius:
        raise InputError(
            f"scan: the phantom reaches {reach:.0f} mm from the isocentre, the field of view only {radius:.0f} mm; "
            "give the detector more columns or a larger column_pitch_mm, or move the phantom's centre"
        )
