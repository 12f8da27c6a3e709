"""Fan rays sorted into parallel ones, and which directions of them a point is seen from."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .errors import InputError
from .geometry import ScanGeometry, orbit_of


class ParallelRays:
    """The parallel rays of a scan: ray (t, angle) leaves the source of view angle b = angle - asin(t / R).

    Only complete angles are held, those of which every ray was measured: where the outermost ones are missing, the ramp
    filter would take the cut for an edge.

    Parameters
    ----------
    geometry : ScanGeometry
        A circle or helix.

    Attributes
    ----------
    geometry : OrbitGeometry
    half_turn : int
        How many angles there are per pi.
    angles_rad : ndarray, shape (angles,)
        Ray directions (sin, -cos), radians.
    t_mm : ndarray, shape (columns,)
        Signed distances of the rays from the isocentre's axis, as dense as the detector's columns.
    t_pitch_mm : float
        From one of these distances to the next, mm.
    view_step : float
        Radians from view to view, signed.
    view_of_angle : ndarray, shape (angles,)
        Fractional view of the central ray of each angle.
    periodic : bool
        Whole turns in one plane: view 0 follows the last view.

    Raises
    ------
    InputError
        For a scan that is no circle or helix, of one view or one column, or of less than half a turn and the fan.
    """

    def __init__(self, geometry: ScanGeometry):
        geometry = orbit_of(geometry, "filtered back-projection")
        if geometry.views < 2 or geometry.columns < 2:
            raise InputError("scan: one view or one detector column cannot be reconstructed; give it more")
        self.geometry = geometry
        self.view_step = float(geometry.angles_rad[1] - geometry.angles_rad[0])
        self.half_turn = max(1, round(geometry.views_per_rotation / 2))
        self.t_pitch_mm = geometry.column_pitch_mm / geometry.magnification
        centred = np.arange(geometry.columns) - (geometry.columns - 1) / 2 + geometry.column_offset_px
        self.t_mm = centred * self.t_pitch_mm
        turns = geometry.views / geometry.views_per_rotation
        self.periodic = geometry.feed_per_rotation_mm == 0 and abs(turns - round(turns)) < 1e-9
        step = np.copysign(np.pi / self.half_turn, self.view_step)
        if self.periodic:
            first, count = 0, 2 * self.half_turn * round(turns)
        else:
            fan = np.arctan(np.abs(geometry.column_positions_mm()).max() / geometry.source_to_detector_mm)
            scanned = (geometry.views - 1) * abs(self.view_step)
            first = int(np.ceil(fan / abs(step)))
            count = int(np.floor((scanned - fan) / abs(step))) - first + 1
            if count < self.half_turn:
                least = (np.pi + 2 * fan) / (2 * np.pi)
                raise InputError(
                    f"scan: {geometry.views} views over {turns:.3g} turns do not hold every direction of rays; "
                    f"at least {least:.2f} turns are needed and a few views more (turns, projections)"
                )
        self.angles_rad = geometry.angles_rad[0] + step * (first + np.arange(count))
        self.view_of_angle = (self.angles_rad - geometry.angles_rad[0]) / self.view_step

    def rebin(self, stack: np.ndarray) -> Iterator[np.ndarray]:
        """Interpolate projections linearly to parallel rays, angle by angle.

        Parameters
        ----------
        stack : ndarray, shape (views, rows, columns)
            Projections of the fan.

        Yields
        ------
        ndarray, shape (rows, columns)
            Projections [row, t] of the next angle; 0 where unknown.
        """
        geometry = self.geometry
        fan = np.arcsin(np.clip(self.t_mm / geometry.source_to_isocentre_mm, -1, 1))
        column = np.tan(fan) * geometry.source_to_detector_mm / geometry.column_pitch_mm
        column = column + (geometry.columns - 1) / 2 - geometry.column_offset_px
        known = (column >= 0) & (column <= geometry.columns - 1)
        left = np.clip(np.floor(column).astype(int), 0, geometry.columns - 2)
        right_share = (column - left).astype(np.float32)
        for central in self.view_of_angle:
            view = central - fan / self.view_step
            low = np.floor(view).astype(int)
            later_share = (view - low).astype(np.float32)
            if self.periodic:
                low, high = low % geometry.views, (low + 1) % geometry.views
            else:
                low = np.clip(low, 0, geometry.views - 1)
                high = np.minimum(low + 1, geometry.views - 1)
            earlier = stack[low, :, left] * (1 - right_share)[:, None] + stack[low, :, left + 1] * right_share[:, None]
            later = stack[high, :, left] * (1 - right_share)[:, None] + stack[high, :, left + 1] * right_share[:, None]
            rows = earlier * (1 - later_share)[:, None] + later * later_share[:, None]
            yield np.where(known[:, None], rows, np.float32(0)).T

    def directions_seen(self, points_mm: np.ndarray) -> np.ndarray:
        """How many of the `half_turn` directions some view sees each point in.

        Seen is what falls between the centres of the outermost columns and of the outermost rows (on the row, if there
        is but one), the same as in the reconstruction.

        Parameters
        ----------
        points_mm : ndarray, shape (points, 3)
            Points (x, y, z), mm.

        Returns
        -------
        ndarray of int, shape (points,)
        """
        geometry = self.geometry
        radius = geometry.source_to_isocentre_mm
        x, y, z = np.asarray(points_mm, dtype=np.float64).T
        middle = geometry.row_offset_px * geometry.row_pitch_mm
        half_height = max(geometry.rows - 1, 1) / 2 * geometry.row_pitch_mm
        start, z_step = geometry.source_z_mm[0], geometry.source_z_mm[1] - geometry.source_z_mm[0]
        seen = np.zeros((self.half_turn, len(x)), dtype=bool)
        for i, (angle, central) in enumerate(zip(self.angles_rad, self.view_of_angle, strict=True)):
            sine, cosine = np.sin(angle), np.cos(angle)
            t = x * cosine + y * sine
            fan = np.arcsin(np.clip(t / radius, -1, 1))
            depth = radius * np.cos(fan) + x * sine - y * cosine
            magnification = geometry.source_to_detector_mm / (np.cos(fan) * depth)
            height = (z - start - (central - fan / self.view_step) * z_step) * magnification
            inside = (t >= self.t_mm[0]) & (t <= self.t_mm[-1]) & (np.abs(t) < radius)
            seen[i % self.half_turn] |= inside & (np.abs(height - middle) < half_height)
        return seen.sum(0)
