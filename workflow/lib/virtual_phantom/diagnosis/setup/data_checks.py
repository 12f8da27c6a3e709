"""Checks of the data themselves: copied repeats, repeats of another scan, white field, and noise of one repeat."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import numpy as np
from scipy import ndimage, optimize

from ...base.geometry import OrbitGeometry
from ...physics.chain import EVEN, SOLID_ANGLE
from ..noise.condensed import Blocks
from ..projections.observed import MEDIAN_SQUARE, PARTS

OTHER_SCAN = 50.0  # mean square of block means relative to noise, from which a repeat is of another scan
TIMES = 20.0  # ratio to the mean squares of the other repeats among themselves
LEAST_RAYS = 16  # of a block

# Tolerance of the exponent of the solid angle about 0 or 1. Bowties and heel effect give other exponents.
NEAR = 0.15
LEAST_SPAN = 0.01  # of the logarithm of the solid angle over the detector: a smaller span shows nothing
# Bins of the transmission, for noise against signal: at most 12, with 100 rays on average. Bins with a hundredth of all
# rays are used.
BINS, RAYS_PER_BIN, FEWEST_IN_BIN = 12, 100, 100
SMOOTH = 5  # views and columns over which the signal is averaged
SECOND_DIFFERENCE = 6.0  # variance of a second difference of independent values, relative to theirs
EXPLAINED = 0.5  # least share of the variance of the white field, by the solid angle and a slope along either axis


def copied_repeats(lines: np.ndarray) -> dict[int, int]:
    """Return {copy: first repeat with identical numbers}, from an array of shape (repeats, views, rows, columns)."""
    found: dict[int, int] = {}
    for first, copy in combinations(range(len(lines)), 2):
        if copy not in found and np.array_equal(lines[first], lines[copy]):
            found[copy] = first
    return found


def outlying_repeat(lines: np.ndarray, usable: np.ndarray) -> int | None:
    """Return the repeat that differs from the mean of the others by more than noise, a scale and an offset.

    The result is None if no repeat differs. With two repeats, the other one may be the outlier.

    Parameters
    ----------
    lines : ndarray, shape (repeats, views, rows, columns)
    usable : ndarray of bool, shape (views, rows, columns)
    """
    count = len(lines)
    if count < 2:
        return None
    blocks = Blocks.of(usable.shape, PARTS)
    squares = [_mean_square(lines, k, usable, blocks) for k in range(count)]
    worst = int(np.argmax(squares))
    rest = np.delete(lines, worst, axis=0)
    # An outlier shifts the mean that all others are compared with, so the others are compared without it.
    others = [_mean_square(rest, k, usable, blocks) for k in range(count - 1)] if count > 2 else [1.0]
    outlying = squares[worst] > OTHER_SCAN and squares[worst] > TIMES * max(float(np.median(others)), 1.0)
    return worst if outlying else None


def _mean_square(lines: np.ndarray, which: int, usable: np.ndarray, blocks: Blocks) -> float:
    """Return the mean square of block means of a repeat's difference from the others, relative to noise."""
    mean = np.delete(lines, which, axis=0).mean(axis=0, dtype=np.float64)
    scale, offset = np.polyfit(mean[usable], lines[which][usable].astype(np.float64), 1)
    difference = np.where(usable, lines[which] - scale * mean - offset, 0.0)
    rays = blocks.sum(usable)
    full = rays >= LEAST_RAYS
    if not full.any():
        return 0.0
    sums, squares, rays = blocks.sum(difference)[full], blocks.sum(difference**2)[full], rays[full]
    variance = (squares - sums**2 / rays) / (rays - 1)
    return float(np.mean(sums**2 / rays / np.maximum(variance, 1e-300)))


def wrong_illumination(white: np.ndarray | None, geometry: OrbitGeometry, scan: Mapping) -> str | None:
    """Return the illumination that the white field shows, if it is not the stated one.

    The result is EVEN, SOLID_ANGLE, or None if the statement may be right or cannot be tested.

    Parameters
    ----------
    white : ndarray, shape (rows, columns), or None
        Counts without an object.
    scan : mapping
        Section `scan` of recording.yaml.
    """
    if white is None:
        return None
    good = white > 0
    angle = np.log(np.broadcast_to(geometry.solid_angles()[0], white.shape))
    if np.ptp(angle) < LEAST_SPAN or good.mean() < 0.5:
        return None
    rows, columns = np.meshgrid(*(np.linspace(-1, 1, n) if n > 1 else np.zeros(1) for n in white.shape), indexing="ij")
    terms = np.stack([np.ones_like(angle), rows, columns, angle])[:, good]
    field = np.log(white[good])
    found = np.linalg.lstsq(terms.T, field, rcond=1e-9)[0]
    explained = 1 - np.var(field - found @ terms) / max(np.var(field), 1e-300)
    stated = scan.get("illumination", EVEN)
    exponent = float(found[-1])
    if stated == EVEN and abs(exponent - 1) < NEAR and explained > EXPLAINED:
        return SOLID_ANGLE
    flat = np.std(field) < NEAR * np.std(angle) or explained > EXPLAINED
    if stated == SOLID_ANGLE and abs(exponent) < NEAR and flat:
        return EVEN
    return None


def smooth_transmission(lines: np.ndarray, good: np.ndarray) -> np.ndarray:
    """Return the transmission of line integrals, shape (views, rows, columns), averaged over neighbors.

    Single values would sort rays by the sign of their noise.
    """
    filled = np.where(good, lines, np.median(lines[good]))
    return np.exp(-ndimage.uniform_filter(filled, (SMOOTH, 1, SMOOTH)))


def noise_by_transmission(
    differences: np.ndarray, transmission: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float, float] | None:
    """Fit the noise variance of transmissions t by floor + slope * t.

    Medians in bins of the transmission exclude edges of the object.

    Parameters
    ----------
    differences : ndarray
        Differences of line integrals, scaled to the noise of one ray; NaN without a signal.

    Returns
    -------
    transmission, variance : ndarray, shape (bins,)
    floor, slope : float
        The result is None for too few rays, or without noise.
    """
    keep = np.isfinite(differences)
    count = min(BINS, np.count_nonzero(keep) // RAYS_PER_BIN)
    if count < 2:
        return None
    noise, transmission = (differences * transmission)[keep], transmission[keep]
    edges = np.linspace(transmission.min(), transmission.max(), count + 1)
    which = np.clip(np.searchsorted(edges, transmission, side="right") - 1, 0, count - 1)
    rays = np.bincount(which, minlength=count)
    bins = np.flatnonzero(rays > rays.sum() / FEWEST_IN_BIN)
    signal, variance = (
        np.array([np.median(part[which == k]) for k in bins]) for part in (transmission, noise**2 / MEDIAN_SQUARE)
    )
    noisy = variance > 0
    if not noisy.any():
        return None
    bins, signal, variance = bins[noisy], signal[noisy], variance[noisy]
    weights = np.sqrt(rays[bins]) / variance
    terms = np.stack([np.ones_like(signal), signal], axis=1)
    floor, slope = optimize.nnls(terms * weights[:, None], variance * weights)[0]
    return signal, variance, float(floor), float(slope)


def variance_of_one_repeat(lines: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Return the noise variance of line integrals, shape (views, rows, columns), from differences between views.

    Views have independent noise, and neighboring pixels may not. The variance is 0 if it cannot be estimated.
    """
    good = usable[:-2] & usable[1:-1] & usable[2:]
    if not good.any():
        return np.zeros(lines.shape)
    transmission = smooth_transmission(lines, usable)
    second = (lines[:-2] - 2 * lines[1:-1] + lines[2:]) / np.sqrt(SECOND_DIFFERENCE)
    found = noise_by_transmission(np.where(good, second, np.nan), transmission[1:-1])
    if found is None:
        return np.zeros(lines.shape)
    *_, floor, slope = found
    return (floor / transmission + slope) / transmission
