"""Fan rays sorted into parallel ones, and which directions of them a point is seen from."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from .errors import InputError
from .geometry import ScanGeometry, orbit_of
from .vectors import FLAT

SAME_MM = 1e-6  # places of focal spots that differ by less are one
# Of a step from angle to angle: a ray so near to a view is that view's. So half a turn is enough for parallel rays,
# whose fan angles are not quite 0.
BESIDE_VIEW = 1e-3


class _Interleaved(NamedTuple):
    """Between which two samples each t lies, of spots whose rays interleave; tuples hold one array for either of them.

    Attributes
    ----------
    known : ndarray of bool, shape (t,)
        Whether every spot has rays on both sides.
    spot, column : tuple of 2 ndarray of int, shape (t,)
    right_share : ndarray of float32, shape (t,)
        Of the second.
    fan_rad : tuple of 2 ndarray, shape (t,)
        Angle of the ray at t over that of the view from whose spot it comes.
    """

    known: np.ndarray
    spot: tuple[np.ndarray, np.ndarray]
    column: tuple[np.ndarray, np.ndarray]
    right_share: np.ndarray
    fan_rad: tuple[np.ndarray, np.ndarray]


class ParallelRays:
    """The parallel rays of a scan: ray (t, angle) leaves the source of view angle b = angle - asin(t / R).

    Only complete angles are held, those of which every ray was measured: where the outermost ones are missing, the ramp
    filter would take the cut for an edge.

    Where the focal spot flies, rays of spots at one height interleave, so that t is the denser. Spots at other heights
    make a level of their own, which sees a point through other rows: all levels hold all t and angles.

    Parameters
    ----------
    geometry : ScanGeometry
        A circle or helix.

    Attributes
    ----------
    half_turn : int
        How many angles there are per pi.
    angles_rad : ndarray, shape (angles,)
        Ray directions (sin, -cos), radians.
    t_mm : ndarray, shape (t,)
        Signed distances of the rays from the isocentre's axis, as dense as the detector's columns, times the spots that
        interleave.
    t_pitch_mm : float
        From one of these distances to the next, mm.
    view_step : float
        Radians from view to view, signed.
    view_of_angle : ndarray, shape (angles,)
        Fractional view of the central ray of each angle.
    periodic : bool
        Whole turns in one plane: view 0 follows the last view.
    level_z_mm, level_radius_mm, level_turn_rad : ndarray, shape (levels,)
        Of each level's spots on average: height over the focal centre, distance from the axis, and how far they are
        turned about it from the focal centre.
    level_ahead_mm : ndarray, shape (levels, t)
        In-plane length of the rays from the source to the detector, times the cosine of the fan angle.

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
        levels, dense = _levels(geometry.spots_mm)
        self.t_pitch_mm = geometry.column_pitch_mm / geometry.magnification / dense
        samples = geometry.columns * dense
        self.t_mm = (np.arange(samples) - (samples - 1) / 2 + geometry.column_offset_px * dense) * self.t_pitch_mm
        turns, spots = geometry.views / geometry.views_per_rotation, len(geometry.spots_mm)
        self.periodic = geometry.feed_per_rotation_mm == 0 and abs(turns - round(turns)) < 1e-9
        self.periodic &= geometry.views % spots == 0
        self._see(geometry, levels)
        step = np.copysign(np.pi / self.half_turn, self.view_step)
        if self.periodic:
            first, count = 0, 2 * self.half_turn * round(turns)
        else:
            fan = self._widest_rad(geometry)
            # Every spot must have been there before, and be there again.
            scanned, before = (geometry.views - spots) * abs(self.view_step), (spots - 1) * abs(self.view_step)
            first = int(np.ceil((fan + before) / abs(step) - BESIDE_VIEW))
            count = int(np.floor((scanned - fan) / abs(step) + BESIDE_VIEW)) - first + 1
            if count < self.half_turn:
                least = (np.pi + 2 * fan) / (2 * np.pi)
                raise InputError(
                    f"scan: {geometry.views} views over {turns:.3g} turns do not hold every direction of rays; "
                    f"at least {least:.2f} turns are needed and a few views more (turns, projections)"
                )
        self.angles_rad = geometry.angles_rad[0] + step * (first + np.arange(count))
        self.view_of_angle = (self.angles_rad - geometry.angles_rad[0]) / self.view_step

    def _see(self, geometry, levels):
        """Work out what each level's rays are, seen from above."""
        positions = geometry.column_positions_mm()
        along, away, z = geometry.spots_mm.T
        radius = geometry.source_to_isocentre_mm + away
        self._radius, self._turn = np.hypot(radius, along), np.arctan2(-along, radius)
        self._from_axis = geometry.from_axis_mm(positions)
        self._ahead = np.hypot(*geometry.from_spots_mm(positions))
        self.level_z_mm, self.level_radius_mm, self.level_turn_rad = (
            np.array([one[spots].mean() for spots in levels]) for one in (z, self._radius, self._turn)
        )
        self._interleaved = [self._between(geometry, spots) for spots in levels]
        self.level_ahead_mm = np.full((len(levels), len(self.t_mm)), float(geometry.source_to_detector_mm))
        if geometry.surface != FLAT or geometry.flies:
            for level, spots in enumerate(levels):
                lengths = [np.interp(self.t_mm, self._from_axis[spot], self._ahead[spot]) for spot in spots]
                sine = np.clip(self.t_mm / self.level_radius_mm[level], -1, 1)
                self.level_ahead_mm[level] = np.mean(lengths, axis=0) * np.sqrt(1 - sine**2)

    def _between(self, geometry, spots) -> _Interleaved:
        last, number = geometry.columns - 1, np.arange(len(self.t_mm))
        fans = [np.arcsin(np.clip(self.t_mm / self._radius[spot], -1, 1)) + self._turn[spot] for spot in spots]
        if geometry.surface == FLAT and not geometry.flies:
            columns = np.tan(fans[0]) * geometry.source_to_detector_mm / geometry.column_pitch_mm
            columns = (columns + last / 2 - geometry.column_offset_px)[None]
        else:
            ends = dict(left=-1.0, right=last + 1.0)
            columns = [np.interp(self.t_mm, self._from_axis[spot], np.arange(last + 1.0), **ends) for spot in spots]
            columns = np.array(columns)
        known = ((columns >= 0) & (columns <= last)).all(axis=0)
        left = np.clip(np.floor(columns).astype(int), 0, last - 1)
        if len(spots) == 1:
            chosen = (np.zeros_like(number), np.zeros_like(number))
            share = columns[0] - left[0]
        else:
            lower = np.stack([self._from_axis[spot][below] for spot, below in zip(spots, left, strict=True)])
            upper = np.stack([self._from_axis[spot][below + 1] for spot, below in zip(spots, left, strict=True)])
            chosen = (lower.argmax(axis=0), upper.argmin(axis=0))
            lowest, highest = lower[chosen[0], number], upper[chosen[1], number]
            share = (self.t_mm - lowest) / (highest - lowest)
        fans = np.array(fans)
        return _Interleaved(
            known,
            tuple(spots[one] for one in chosen),
            (left[chosen[0], number], left[chosen[1], number] + 1),
            share.astype(np.float32),
            tuple(fans[one, number] for one in chosen),
        )

    def _widest_rad(self, geometry) -> float:
        """The largest fan angle of a measured ray."""
        if geometry.surface == FLAT and not geometry.flies:
            return float(np.arctan(np.abs(geometry.column_positions_mm()).max() / geometry.source_to_detector_mm))
        fans = np.arcsin(np.clip(self._from_axis / self._radius[:, None], -1, 1)) + self._turn[:, None]
        return float(np.abs(fans).max())

    @property
    def levels(self) -> int:
        """How many heights focal spots have over the focal centre."""
        return len(self.level_z_mm)

    def in_the_plane(self, stack: np.ndarray) -> np.ndarray:
        """Projections times the cosine of the angle between rays and the plane across z, what the ramp filter asks for.

        Parameters
        ----------
        stack : ndarray, shape (views, rows, columns)
            Projections of the fan.
        """
        geometry = self.geometry
        along, ahead = geometry.from_spots_mm(geometry.column_positions_mm())
        flat = (ahead**2 + along**2)[:, None]
        up = geometry.row_positions_mm() - geometry.spots_mm[:, 2:]
        cosine = np.sqrt(flat / (flat + up[..., None] ** 2)).astype(np.float32)
        spots = len(cosine)
        if spots == 1:
            return stack * cosine[0]
        result = np.empty(stack.shape, np.float32)
        for spot in range(spots):
            result[spot::spots] = stack[spot::spots] * cosine[spot]
        return result

    def rebin(self, stack: np.ndarray, level: int = 0) -> Iterator[np.ndarray]:
        """Interpolate projections linearly to parallel rays, angle by angle.

        Parameters
        ----------
        stack : ndarray, shape (views, rows, columns)
            Projections of the fan.
        level : int, optional
            Of whose spots.

        Yields
        ------
        ndarray, shape (rows, t)
            Projections [row, t] of the next angle; 0 where unknown.
        """
        known, spot, column, right_share, fan = self._interleaved[level]
        (left, right), right_share = column, right_share[:, None]
        for central in self.view_of_angle:
            low, high, later_share = self._views_about(spot[0], central - fan[0] / self.view_step)
            if len(self.geometry.spots_mm) == 1:
                earlier = stack[low, :, left] * (1 - right_share) + stack[low, :, right] * right_share
                later = stack[high, :, left] * (1 - right_share) + stack[high, :, right] * right_share
                rows = earlier * (1 - later_share) + later * later_share
            else:
                rows = (stack[low, :, left] * (1 - later_share) + stack[high, :, left] * later_share) * (
                    1 - right_share
                )
                low, high, later_share = self._views_about(spot[1], central - fan[1] / self.view_step)
                another = stack[low, :, right] * (1 - later_share) + stack[high, :, right] * later_share
                rows += another * right_share
            yield np.where(known[:, None], rows, np.float32(0)).T

    def _views_about(self, spot, view):
        """The views of a spot before and after a fractional view, and the share of the one after, (t, 1)."""
        views, spots = self.geometry.views, len(self.geometry.spots_mm)
        number = (view - spot) / spots
        low = np.floor(number).astype(int)
        if self.periodic:
            later_share = (number - low).astype(np.float32)[:, None]
            return (low * spots + spot) % views, ((low + 1) * spots + spot) % views, later_share
        last = (views - 1 - spot) // spots
        low = np.clip(low, 0, last)
        later_share = np.clip(number - low, 0, 1).astype(np.float32)[:, None]
        return low * spots + spot, np.minimum(low + 1, last) * spots + spot, later_share

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
        x, y, z = np.asarray(points_mm, dtype=np.float64).T
        middle = geometry.row_offset_px * geometry.row_pitch_mm
        half_height = max(geometry.rows - 1, 1) / 2 * geometry.row_pitch_mm
        start, z_step = geometry.source_z_mm[0], geometry.source_z_mm[1] - geometry.source_z_mm[0]
        seen = np.zeros((self.half_turn, len(x)), dtype=bool)
        for level, (radius, up, turn) in enumerate(
            zip(self.level_radius_mm, self.level_z_mm, self.level_turn_rad, strict=True)
        ):
            for i, (angle, central) in enumerate(zip(self.angles_rad, self.view_of_angle, strict=True)):
                sine, cosine = np.sin(angle), np.cos(angle)
                t = x * cosine + y * sine
                fan = np.arcsin(np.clip(t / radius, -1, 1))
                depth = radius * np.cos(fan) + x * sine - y * cosine
                magnification = np.interp(t, self.t_mm, self.level_ahead_mm[level]) / (np.cos(fan) * depth)
                height = (z - up - start - (central - (fan + turn) / self.view_step) * z_step) * magnification + up
                inside = (t >= self.t_mm[0]) & (t <= self.t_mm[-1]) & (np.abs(t) < radius)
                seen[i % self.half_turn] |= inside & (np.abs(height - middle) < half_height)
        return seen.sum(0)


def _levels(spots_mm: np.ndarray) -> tuple[list[np.ndarray], int]:
    """Spots at one height each, and by how much the densest of these interleave."""
    heights = np.round(spots_mm[:, 2] / SAME_MM)
    levels = [np.flatnonzero(heights == height) for height in np.unique(heights)]
    return levels, max(len(np.unique(np.round(spots_mm[spots, 0] / SAME_MM))) for spots in levels)
