"""Consistency of line integrals with each other, for any object: opposite rays, and sums over parallel views.

Line integrals of the same line are equal, whichever end the source is at. The sum over a parallel view is the same for
all directions, and its centroid is a sinusoid about the axis of rotation (D. Ludwig, Commun. Pure Appl. Math. 19, 49,
1966). All hold in the plane of the source only, so cone beams are tested in their middle row.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.optimize import least_squares, minimize_scalar

from ...base.geometry import OrbitGeometry

MARGIN = 4  # views repeated beyond either end of a whole turn
LARGEST_STEP_DEG = 3.0  # between views, up to which rays between views are interpolated
MOST = (90, 256)  # views and columns that are compared
LEAST_PAIRS = 0.2  # share of rays with an opposite ray
WIDEST_SHIFT = 0.05  # shift of the detector that is searched, as a share of the columns
WIDEST_DISTANCE = 0.3  # range of the logarithm of the distance to the detector
# Errors of interpolation between views of 0.5 to 2 degrees: simulated scans of three ellipses were off by up to 0.018
# columns and 0.6 % of the distance.
SHIFT_ERROR, DISTANCE_ERROR = 0.02, 0.006
LARGEST_SATURATION = 0.98  # of the inverse of the largest line integral, at which the correction diverges


@dataclass(frozen=True)
class OppositeRays:
    """Comparison of rays with the rays along the same lines from the opposite side.

    Attributes
    ----------
    shift_px, shift_error : float
        Shift of the detector along its columns, beyond the stated one, and its standard error.
    distance, distance_error : float
        Distance from source to detector relative to the stated one, and its standard error.
    rms, rms_reversed : float
        RMS difference with these, and with the direction of rotation reversed.
    residual : ndarray, shape (views, columns)
        NaN where a ray has no opposite ray.
    """

    shift_px: float
    shift_error: float
    distance: float
    distance_error: float
    rms: float
    rms_reversed: float
    residual: np.ndarray


def opposite_rays(lines: np.ndarray, geometry: OrbitGeometry) -> OppositeRays | None:
    """Compare opposite rays of a fan beam; None if too few rays have one, or views are too far apart.

    Parameters
    ----------
    lines : ndarray, shape (views, columns)
        Line integrals in the plane of the source.
    """
    if geometry.parallel or lines.shape[1] < 8 or _step_deg(geometry) > LARGEST_STEP_DEG:
        return None
    at, pitch, columns = _interpolated(lines, geometry), _pitch(geometry), _columns(geometry)
    steps = [-(-count // most) for count, most in zip(lines.shape, MOST, strict=True)]
    some = tuple(slice(None, None, step) for step in steps)

    def residual(numbers, sign=1.0, part=some):
        shift, scaled = numbers[0], pitch / np.exp(numbers[1])
        here = columns[part[1]] + shift
        views = geometry.angles_rad[part[0]][:, None] + np.pi + sign * 2 * np.arctan(here * scaled)[None]
        opposite = np.broadcast_to(-here - shift, views.shape)
        return lines[part] - at(np.stack([views % (2 * np.pi), opposite], axis=-1))

    if np.isfinite(residual((0.0, 0.0))).mean() < LEAST_PAIRS:
        return None
    shifts = np.linspace(-WIDEST_SHIFT, WIDEST_SHIFT, 21) * lines.shape[1]
    rms = {sign: [float(np.sqrt(np.nanmean(residual((s, 0.0), sign) ** 2))) for s in shifts] for sign in (1.0, -1.0)}
    start = float(shifts[int(np.argmin(rms[1.0]))])
    kept = np.isfinite(residual((start, 0.0)))
    fit = least_squares(
        lambda numbers: np.nan_to_num(residual(numbers))[kept],
        (start, 0.0),
        bounds=([-np.inf, -WIDEST_DISTANCE], [np.inf, WIDEST_DISTANCE]),
        x_scale=(0.1, 0.01),
    )
    mean_square = 2 * fit.cost / fit.fun.size
    shift_error, distance_error = np.sqrt(np.diag(np.linalg.pinv(fit.jac.T @ fit.jac)) * mean_square)
    return OppositeRays(
        shift_px=float(fit.x[0]),
        shift_error=float(np.hypot(shift_error, SHIFT_ERROR)),
        distance=float(np.exp(fit.x[1])),
        distance_error=float(np.hypot(distance_error, DISTANCE_ERROR) * np.exp(fit.x[1])),
        rms=float(np.sqrt(mean_square)),
        rms_reversed=min(rms[-1.0]),
        residual=residual(fit.x, part=(slice(None), slice(None))),
    )


def parallel_views(lines: np.ndarray, geometry: OrbitGeometry, shift_px: float = 0.0) -> np.ndarray | None:
    """Return the views of parallel rays, shape (directions, rays); None if the scan does not have them.

    A fan beam needs a whole turn. Its rays are interpolated.
    """
    if geometry.parallel:
        return lines
    if _step_deg(geometry) > LARGEST_STEP_DEG:
        return None
    positions = _columns(geometry) * geometry.column_pitch_mm / geometry.magnification
    fan = np.arcsin(np.clip(positions / geometry.source_to_isocentre_mm, -1, 1))
    views = (geometry.angles_rad[:, None] - fan[None]) % (2 * np.pi)
    columns = np.broadcast_to(np.tan(fan) / _pitch(geometry) - shift_px, views.shape)
    found = _interpolated(lines, geometry)(np.stack([views, columns], axis=-1))
    inside = np.isfinite(found).all(axis=0)
    return found[:, inside] if inside.mean() > 0.5 else None


@dataclass(frozen=True)
class Sums:
    """Sums over the parallel views of an object that is completely in view.

    Attributes
    ----------
    spread : float
        Standard deviation of the sums over their mean; 0 for line integrals of a static object.
    noise : float
        The same for noise, from differences of successive sums.
    saturation : float
        Line integral p1 at which the measured ones saturate: sums of p / (1 - p / p1) vary least. Infinite if no
        saturation makes them vary less.
    spread_corrected : float
        Their spread after this correction.
    """

    spread: float
    noise: float
    saturation: float
    spread_corrected: float


def sums_of_views(views: np.ndarray) -> Sums:
    """Return the variation of the sums over parallel views."""

    def spread(inverse: float) -> float:
        sums = (views / (1 - inverse * views)).sum(axis=1)
        return float(sums.std() / abs(sums.mean()))

    sums = views.sum(axis=1)
    noise = float(np.diff(sums).std() / np.sqrt(2) / abs(sums.mean())) if len(sums) > 2 else 0.0
    best = minimize_scalar(spread, bounds=(0.0, LARGEST_SATURATION / views.max()), method="bounded")
    alone = spread(0.0)
    if best.fun >= alone:
        return Sums(alone, noise, np.inf, alone)
    return Sums(alone, noise, 1 / float(best.x), float(best.fun))


def centroid_shift(views: np.ndarray, geometry: OrbitGeometry) -> tuple[float, float] | None:
    """Return the shift of the detector along its columns that a parallel beam shows, pixels, and its standard error.

    None for less than a third of a turn, which does not determine the sinusoid.
    """
    if len(views) < 6 or np.ptp(geometry.angles_rad) < 2 * np.pi / 3:
        return None
    centroids = views @ _columns(geometry) / views.sum(axis=1)
    angles = geometry.angles_rad
    terms = np.stack([np.ones_like(angles), np.cos(angles), np.sin(angles)], axis=1)
    found = np.linalg.lstsq(terms, centroids, rcond=None)[0]
    left = centroids - terms @ found
    covariance = np.linalg.inv(terms.T @ terms) * (left**2).sum() / (len(views) - 3)
    return -float(found[0]), float(np.sqrt(covariance[0, 0]))


def _columns(geometry: OrbitGeometry) -> np.ndarray:
    return np.arange(geometry.columns) - (geometry.columns - 1) / 2 + geometry.column_offset_px


def _pitch(geometry: OrbitGeometry) -> float:
    """Return the tangent of the fan angle per column."""
    return geometry.column_pitch_mm / geometry.source_to_detector_mm


def _step_deg(geometry: OrbitGeometry) -> float:
    return float(np.degrees(np.median(np.abs(np.diff(geometry.angles_rad))))) if geometry.views > 1 else np.inf


def _interpolated(lines: np.ndarray, geometry: OrbitGeometry) -> RegularGridInterpolator:
    """Return line integrals as a function of view angle (radians, 0 to 2 pi) and column; NaN where there are none."""
    turned = geometry.angles_rad % (2 * np.pi)
    order = np.argsort(turned)
    angles, values = turned[order], lines[order].astype(float)
    new = np.append(True, np.diff(angles) > 1e-6)  # views along the same direction count once
    angles, values = angles[new], values[new]
    margin = min(MARGIN, len(angles))
    angles = np.concatenate([angles[-margin:] - 2 * np.pi, angles, angles[:margin] + 2 * np.pi])
    values = np.concatenate([values[-margin:], values, values[:margin]])
    # A gap in a short scan is filled with NaN, not interpolated.
    gaps = np.flatnonzero(np.diff(angles) > np.radians(2 * LARGEST_STEP_DEG))
    middles = (angles[gaps] + angles[gaps + 1]) / 2
    edges = np.concatenate([angles[gaps] + 1e-9, middles, angles[gaps + 1] - 1e-9])
    angles = np.concatenate([angles, edges])
    values = np.concatenate([values, np.full((len(edges), lines.shape[1]), np.nan)])
    order = np.argsort(angles)
    return RegularGridInterpolator(
        (angles[order], _columns(geometry)), values[order], bounds_error=False, fill_value=np.nan
    )
