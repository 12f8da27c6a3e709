"""Rebinning of fan rays to parallel rays, and the directions from which a point is seen."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .errors import InputError
from .geometry import ScanGeometry, orbit_of
from .vectors import FLAT

SAME_MM = 1e-6  # smaller differences of focal spot positions are ignored
# Tolerance of the first and the last angle, as a fraction of the angle step. With it, half a turn is enough for a
# parallel beam, whose fan angles are not exactly 0.
ANGLE_TOLERANCE = 1e-3
LARGEST_UNEVENNESS = 0.1  # of the steps between views, as a fraction of a step


class Interleaved(NamedTuple):
    """Neighboring samples of each t for spots whose rays interleave. Tuples have one array for each of the two samples.

    Attributes
    ----------
    known : ndarray of bool, shape (t,)
        Whether every spot has rays on both sides of t.
    spot, column : tuple of 2 ndarray of int, shape (t,)
        Focal spot and detector column of each sample.
    right_share : ndarray of float32, shape (t,)
        Weight of the second sample.
    fan_rad : tuple of 2 ndarray, shape (t,)
        Direction of the ray at t, relative to the view angle at which the spot emits it.
    """

    known: np.ndarray
    spot: tuple[np.ndarray, np.ndarray]
    column: tuple[np.ndarray, np.ndarray]
    right_share: np.ndarray
    fan_rad: tuple[np.ndarray, np.ndarray]


class ParallelRays:
    """Parallel rays of a scan: ray (t, angle) leaves the source of view angle b = angle - asin(t / R).

    Only complete angles, of which every ray was measured, are included: the ramp filter would treat a truncation as an
    edge.

    With a flying focal spot, rays of spots at one height interleave, which makes t denser. Spots at another height form
    another level, whose rays through a point end at other detector rows. All levels have the same t and angles.

    Parameters
    ----------
    geometry : ScanGeometry
        Circular or helical.

    Attributes
    ----------
    half_turn : int
        Number of angles per pi.
    angles_rad : ndarray, shape (angles,)
        Ray directions (sin, -cos), radians.
    t_mm : ndarray, shape (t,)
        Signed distances of the rays from the axis, as dense as the columns times the number of interleaved spots.
    t_pitch_mm : float
        Increment of t, mm.
    view_step : float
        Radians per view, signed.
    view_of_angle : ndarray, shape (angles,)
        Fractional view of the central ray of each angle.
    periodic : bool
        True for whole turns in one plane, where view 0 follows the last view.
    interleaved : list of Interleaved
        Neighboring samples of each level.
    level_z_mm, level_radius_mm, level_turn_rad : ndarray, shape (levels,)
        Means over the spots of a level: height above the focal center, distance from the axis, and rotation about the
        axis relative to the focal center.
    level_ahead_mm : ndarray, shape (levels, t)
        In-plane length of the rays from the source to the detector, times the cosine of the fan angle.

    Raises
    ------
    InputError
        For a scan that is neither circular nor helical, has one view or one column, has unevenly spaced views, or
        covers less than half a turn plus the fan.
    """

    def __init__(self, geometry: ScanGeometry):
        geometry = orbit_of(geometry, "filtered back-projection")
        if geometry.views < 2 or geometry.columns < 2:
            raise InputError("scan: one view or one detector column cannot be reconstructed; give it more")
        steps = np.diff(geometry.angles_rad)
        if np.abs(steps - steps[0]).max() > LARGEST_UNEVENNESS * abs(steps[0]):
            raise InputError("scan: unevenly spaced views cannot be reconstructed by filtered back-projection")
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
        self._set_levels(geometry, levels)
        step = np.copysign(np.pi / self.half_turn, self.view_step)
        if self.periodic:
            first, count = 0, 2 * self.half_turn * round(turns)
        else:
            fan = self._widest_rad(geometry)
            # Every spot must occur before and after an angle.
            scanned, before = (geometry.views - spots) * abs(self.view_step), (spots - 1) * abs(self.view_step)
            first = int(np.ceil((fan + before) / abs(step) - ANGLE_TOLERANCE))
            count = int(np.floor((scanned - fan) / abs(step) + ANGLE_TOLERANCE)) - first + 1
            if count < self.half_turn:
                least = (np.pi + 2 * fan) / (2 * np.pi)
                raise InputError(
                    f"scan: {geometry.views} views over {turns:.3g} turns do not contain all directions of rays; "
                    f"at least {least:.2f} turns are needed and a few views more (turns, projections)"
                )
        self.angles_rad = geometry.angles_rad[0] + step * (first + np.arange(count))
        self.view_of_angle = (self.angles_rad - geometry.angles_rad[0]) / self.view_step

    def _set_levels(self, geometry, levels):
        """Compute the in-plane rays of each level."""
        positions = geometry.column_positions_mm()
        along, away, z = geometry.spots_mm.T
        radius = geometry.source_to_isocentre_mm + away
        self._radius, self._turn = np.hypot(radius, along), np.arctan2(-along, radius)
        self._from_axis = geometry.from_axis_mm(positions)
        self._ahead = np.hypot(*geometry.from_spots_mm(positions))
        self.level_z_mm, self.level_radius_mm, self.level_turn_rad = (
            np.array([values[spots].mean() for spots in levels]) for values in (z, self._radius, self._turn)
        )
        self.interleaved = [self._between(geometry, spots) for spots in levels]
        self.level_ahead_mm = np.full((len(levels), len(self.t_mm)), float(geometry.source_to_detector_mm))
        if geometry.surface != FLAT or geometry.has_focal_spot_offset:
            for level, spots in enumerate(levels):
                lengths = [np.interp(self.t_mm, self._from_axis[spot], self._ahead[spot]) for spot in spots]
                sine = np.clip(self.t_mm / self.level_radius_mm[level], -1, 1)
                self.level_ahead_mm[level] = np.mean(lengths, axis=0) * np.sqrt(1 - sine**2)

    def _between(self, geometry, spots) -> Interleaved:
        last, number = geometry.columns - 1, np.arange(len(self.t_mm))
        fans = [np.arcsin(np.clip(self.t_mm / self._radius[spot], -1, 1)) + self._turn[spot] for spot in spots]
        if geometry.surface == FLAT and not geometry.has_focal_spot_offset:
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
            share = np.where(known, self.t_mm - lowest, 0) / np.where(known, highest - lowest, 1)
        fans = np.array(fans)
        return Interleaved(
            known,
            tuple(spots[index] for index in chosen),
            (left[chosen[0], number], left[chosen[1], number] + 1),
            share.astype(np.float32),
            tuple(fans[index, number] for index in chosen),
        )

    def _widest_rad(self, geometry) -> float:
        """Return the largest fan angle of a measured ray."""
        if geometry.surface == FLAT and not geometry.has_focal_spot_offset:
            return float(np.arctan(np.abs(geometry.column_positions_mm()).max() / geometry.source_to_detector_mm))
        fans = np.arcsin(np.clip(self._from_axis / self._radius[:, None], -1, 1)) + self._turn[:, None]
        return float(np.abs(fans).max())

    @property
    def levels(self) -> int:
        """Number of heights of focal spots above the focal center."""
        return len(self.level_z_mm)

    @property
    def cone_cosine(self) -> np.ndarray:
        """Cosine of the angle between a ray and the x-y plane, (spots, rows, columns), float32."""
        geometry = self.geometry
        along, ahead = geometry.from_spots_mm(geometry.column_positions_mm())
        flat = (ahead**2 + along**2)[:, None]
        up = geometry.row_positions_mm() - geometry.spots_mm[:, 2:]
        return np.sqrt(flat / (flat + up[..., None] ** 2)).astype(np.float32)

    def views_about(self, spot: np.ndarray, view: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the views of focal spots before and after fractional views, and the weights of the later ones."""
        views, spots = self.geometry.views, len(self.geometry.spots_mm)
        number = (view - spot) / spots
        low = np.floor(number).astype(int)
        if self.periodic:
            return (low * spots + spot) % views, ((low + 1) * spots + spot) % views, (number - low).astype(np.float32)
        last = (views - 1 - spot) // spots
        low = np.clip(low, 0, last)
        later_share = np.clip(number - low, 0, 1).astype(np.float32)
        return low * spots + spot, np.minimum(low + 1, last) * spots + spot, later_share

    def directions_seen(self, points_mm: np.ndarray) -> np.ndarray:
        """Return the number of the `half_turn` directions from which each point (x, y, z), mm, is seen, (points,).

        A point is seen if its projection is between the centers of the outermost columns and rows (on the row, if there
        is only one), as in the reconstruction.
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
    """Return the spots at each height, and the largest number of spots that interleave."""
    heights = np.round(spots_mm[:, 2] / SAME_MM)
    levels = [np.flatnonzero(heights == height) for height in np.unique(heights)]
    return levels, max(len(np.unique(np.round(spots_mm[spots, 0] / SAME_MM))) for spots in levels)
