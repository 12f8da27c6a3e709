"""Filtered back-projection of circular and helical cone-beam scans, ramp filter."""

from __future__ import annotations

import numpy as np
from scipy import fft

from .errors import InputError
from .geometry import ScanGeometry

# Rows of the detector, as a share from its middle, that count fully where views of one direction overlap.
FULL_ROWS = 0.6


def fbp(projector, line_integrals: np.ndarray, *, normalise: str = "coverage") -> np.ndarray:
    """Linear attenuation in 1/mm [lane, z, y, x] from line integrals [lane, view, row, column].

    projector   the CPU engine's
    normalise   "coverage": rays are rebinned to parallel ones, and each voxel takes every direction (mod half a turn)
                once, in the ratio of the row weights of the views that see it: weighted filtered back-projection, K.
                Stierstorfer et al., Phys. Med. Biol. 49, 2209 (2004). Air outside the field of view.
                "none": FDK (Feldkamp, Davis and Kress, J. Opt. Soc. Am. A 1, 612, 1984) that takes all views for one
                turn. Right for one circular turn; on a helix every voxel comes out scaled by the share of views that
                see it, as with ASTRA's FDK_CUDA.

    Raises InputError for another word.
    """
    if normalise == "none":
        return _fdk(projector, line_integrals)
    if normalise == "coverage":
        return _weighted(projector, line_integrals)
    raise InputError(f"fbp: normalise '{normalise}' is unknown; use 'coverage' or 'none'")


def _fdk(projector, line_integrals):
    geometry = projector.geometry
    u, v = geometry.column_positions_mm(), geometry.row_positions_mm()
    distance = geometry.source_to_detector_mm
    cosine = (distance / np.sqrt(distance**2 + u[None, :] ** 2 + v[:, None] ** 2)).astype(np.float32)
    filtered = np.empty(line_integrals.shape, dtype=np.float32)
    for lane, stack in enumerate(line_integrals):
        filtered[lane] = ramp_filter(stack * cosine, geometry.column_pitch_mm / geometry.magnification)
    volume = projector.back(projector.pack_projections(filtered), distance_weight=True)
    # Half of the integral over one turn of views: each ray is met twice.
    volume *= np.float32(np.pi / geometry.views)
    return projector.unpack_volume(volume)


def _weighted(projector, line_integrals):
    geometry = projector.geometry
    rays = ParallelRays.of(geometry)
    u, v = geometry.column_positions_mm(), geometry.row_positions_mm()
    flat = geometry.source_to_detector_mm**2 + u[None, :] ** 2
    cosine = np.sqrt(flat / (flat + v[:, None] ** 2)).astype(np.float32)
    packed = projector.back_parallel_stack(rays)
    for lane, stack in enumerate(line_integrals):
        for i, image in enumerate(rays.rebin(stack * cosine)):
            packed[i, 1:-1, 1:-1, lane] = ramp_filter(image, rays.t_pitch_mm).T
    volume = projector.back_parallel(packed, rays, FULL_ROWS)
    # What some views miss has no trustworthy value: air, as scanners show it.
    _, y, x = projector.grid.axes_mm()
    inside = np.hypot(y[:, None], x[None, :]) <= geometry.field_of_view_radius_mm
    volume[1:-1, 1:-1] *= (np.pi * inside).astype(np.float32)[..., None, None]
    return projector.unpack_volume(volume)


def ramp_filter(rows: np.ndarray, pitch_mm: float) -> np.ndarray:
    """Ramp filter along the last axis, samples `pitch_mm` apart; result per mm.

    The ramp is made from its band-limited impulse response (Kak and Slaney, Principles of Computerized Tomographic
    Imaging, 1988, eq. 3.61), so that the mean is kept.
    """
    samples = rows.shape[-1]
    n = fft.next_fast_len(2 * samples, real=True)
    offset = np.minimum(np.arange(n), n - np.arange(n))
    response = np.where(offset % 2 == 1, -1 / (np.pi * np.maximum(offset, 1) * pitch_mm) ** 2, 0.0)
    response[0] = 1 / (4 * pitch_mm**2)
    ramp = (fft.rfft(response).real * pitch_mm).astype(np.float32)
    return fft.irfft(fft.rfft(rows.astype(np.float32, copy=False), n, axis=-1) * ramp, n, axis=-1)[..., :samples]


class ParallelRays:
    """Fan rays sorted into parallel ones: ray (t, angle) leaves the source of view angle b = angle - asin(t / R).

    angles_rad      ray directions (sin, -cos), half_turn of them per pi
    t_mm            signed distances of the rays from the isocentre's axis
    view_of_angle   fractional view of the central ray of each angle
    """

    def __init__(self, geometry: ScanGeometry, angles_rad, half_turn, t_mm, view_step, periodic):
        self.geometry, self.angles_rad, self.half_turn, self.t_mm = geometry, angles_rad, half_turn, t_mm
        self.view_step, self.periodic = view_step, periodic
        self.t_pitch_mm = float(t_mm[1] - t_mm[0])
        self.view_of_angle = (angles_rad - geometry.angles_rad[0]) / view_step

    @classmethod
    def of(cls, geometry: ScanGeometry) -> ParallelRays:
        """As many angles per half turn as the scan has views, and rays as dense as the detector's columns."""
        if geometry.views < 2 or geometry.columns < 2:
            raise InputError("fbp: a scan of one view or one column cannot be reconstructed; give it more")
        view_step = float(geometry.angles_rad[1] - geometry.angles_rad[0])
        half_turn = max(1, round(geometry.views_per_rotation / 2))
        pitch = geometry.column_pitch_mm / geometry.magnification
        t = (np.arange(geometry.columns) - (geometry.columns - 1) / 2 + geometry.column_offset_px) * pitch
        turns = geometry.views / geometry.views_per_rotation
        # Whole turns in one plane close on themselves: the ray between the last and the first view is known.
        periodic = geometry.feed_per_rotation_mm == 0 and abs(turns - round(turns)) < 1e-9
        step = np.copysign(np.pi / half_turn, view_step)
        if periodic:
            count, start = 2 * half_turn, 0.0
        else:
            # Angles that only the outermost rays reach lie before the first and after the last view.
            fan = np.arctan(np.abs(geometry.column_positions_mm()).max() / geometry.source_to_detector_mm)
            before = int(np.ceil(fan / abs(step)))
            count = int(np.ceil((geometry.views - 1) * abs(view_step / step))) + 1 + 2 * before
            start = -before * step
        return cls(
            geometry, geometry.angles_rad[0] + start + step * np.arange(count), half_turn, t, view_step, periodic
        )

    def rebin(self, stack: np.ndarray):
        """Yield, angle by angle, [row, t] of projections [view, row, column], linearly interpolated; 0 if unknown."""
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
                low, high, valid = low % geometry.views, (low + 1) % geometry.views, known
            else:
                valid = known & (view >= 0) & (view <= geometry.views - 1)
                low = np.clip(low, 0, geometry.views - 1)
                high = np.minimum(low + 1, geometry.views - 1)
            earlier = stack[low, :, left] * (1 - right_share)[:, None] + stack[low, :, left + 1] * right_share[:, None]
            later = stack[high, :, left] * (1 - right_share)[:, None] + stack[high, :, left + 1] * right_share[:, None]
            rows = earlier * (1 - later_share)[:, None] + later * later_share[:, None]
            yield np.where(valid[:, None], rows, np.float32(0)).T
