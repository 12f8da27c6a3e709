"""Noise of one repeat of a scan before anything is fitted, from repeats or from differences of neighbors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...base.errors import InputError
from ...base.pose import Pose
from ...physics.beam.spectra import Anode
from ...physics.chain import Chain
from ..noise.condensed import Blocks
from ..noise.whitening import WHITE, of_state
from ..workload import rays_of
from .observed import PARTS, Scans, mean_squares, observe

MOST_PHOTONS = 1e12  # per pixel; more means data without noise
# Least number of rows to estimate the noise of a single repeat from differences of rows, too. Most objects change
# little from row to row, so a wrong position of the object then adds nothing to the noise estimate.
LEAST_ROWS = 4
# Variance of a sum of squared second differences relative to independent values: neighbors have a correlation of -2/3,
# and second neighbors of 1/6.
SECOND_DIFFERENCES_SHARE = 1 + 2 * ((2 / 3) ** 2 + (1 / 6) ** 2)
SHARE_BY_DISTANCE = {1: SECOND_DIFFERENCES_SHARE, 2: 1 + 2 * (1 / 6) ** 2}  # of the summed views; 1 if farther apart
# Rays, with all rays of a pixel counted. In a larger scan, noise is estimated only from the fitted views and the views
# next to them. 20 million rays take 2 GB.
MOST_RAYS_FOR_NOISE = 2e7


@dataclass(frozen=True)
class FirstNoise:
    """Noise of one repeat.

    The noise of a single repeat is estimated from second differences of neighboring views, and of rows if there are
    enough.

    Attributes
    ----------
    clean : ndarray, shape (views, rows, columns)
        Line integrals of the declared physics.
    photons : float
        Photons per pixel in air.
    reference, variance : ndarray, shape (views, rows, columns)
        Variance of Poisson noise with these photons, and variance of the recording.
    single : bool
        Whether there is a single repeat.
    second_difference : float
        Variance of second differences relative to the variance of a view.
    of_views : tuple of (ndarray, float), or None
        Squared second differences (observed.with_noise_of_views), and the variance of their sum along rows, relative
        to independent values; None for several repeats, or too few rows.
    """

    clean: np.ndarray
    photons: float
    reference: np.ndarray
    variance: np.ndarray
    blocks: Blocks
    single: bool
    second_difference: float
    of_views: tuple[np.ndarray, float] | None


def first_noise(
    taken: Scans, chain: Chain, physics: Mapping[str, Mapping[str, float]], place: Pose, anode: Anode, step: int
) -> tuple[Scans, FirstNoise]:
    """Estimate the noise of a scan, and return every `step`-th view of the scan with its noise.

    Noise is estimated from all views, in large scans from the returned views and their neighbors.

    Parameters
    ----------
    physics : mapping of str to mapping of str to float
        Declared effects before images are made.
    place : Pose
        Expected pose of the object.

    Raises
    ------
    InputError
        If the repeats do not vary.
    """
    single, of_rows = len(taken) == 1, has_rows(taken.usable)
    large = step > 1 and rays_of(chain.geometry.shape, chain.samples) > MOST_RAYS_FOR_NOISE
    residuals = None
    if large:
        if single:
            residuals = _around(taken, chain, step, physics, anode, place)
        taken, chain = taken.every(step), every(chain, step)
    state = chain.state(physics, place, photons=1.0, anode=anode)
    clean = state.line_integrals()
    unit = np.exp(clean)  # variance of one photon per pixel in air
    if physics:  # filters reduce the photons
        unit = unit / state.measured_air
    noise, squares = _noise(taken, clean, residuals)
    photons = 1 / float(np.mean(noise[taken.usable] / unit[taken.usable]))
    second_difference = WHITE.of_second_differences(of_rows)
    if single:
        declared = of_state(chain.state(physics, place, photons=photons, anode=anode), apart=1)
        white, second_difference = second_difference, declared.of_second_differences(of_rows)
        noise, photons = noise * white / second_difference, photons * second_difference / white
    if not np.isfinite(photons) or photons > MOST_PHOTONS:
        raise InputError("the repeats are identical; remove the copies from repeats")
    if step > 1 and not large:
        taken, clean, unit, noise = taken.every(step), clean[::step], unit[::step], noise[::step]
        squares = None if squares is None else squares[::step]
    reference, of_views = unit / photons, None
    blocks = Blocks.of(taken.usable.shape, PARTS)
    if single:
        variance = noise
        if of_rows:
            rows = taken.usable.shape[1]
            of_views = squares / reference, SECOND_DIFFERENCES_SHARE * rows / (rows - 2)
    else:
        variance = reference * blocks.spread(filled(observe(taken, reference, blocks).variance))
    return taken, FirstNoise(clean, photons, reference, variance, blocks, single, second_difference, of_views)


def every(chain: Chain, step: int) -> Chain:
    """Return the chain with every `step`-th view."""
    return chain.copy(chain.geometry.every(step))


def _around(
    taken: Scans, chain: Chain, step: int, stated: Mapping[str, Mapping[str, float]], anode: Anode, place: Pose
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return residuals of a single repeat in every `step`-th view, and in the views before and after it.

    Parameters
    ----------
    stated : mapping of str to mapping of str to float
        Physics of the baseline.

    Returns
    -------
    before, here, after : ndarray, shape (views, rows, columns)
        For the first and the last view of the scan, the residuals around the second and the last but one view.
    """
    middles = np.clip(np.arange(0, chain.geometry.views, step), 1, chain.geometry.views - 2)

    def left(views: np.ndarray) -> np.ndarray:
        lines = chain.copy(chain.geometry.at(views)).state(stated, place, photons=1.0, anode=anode).line_integrals()
        return taken.repeats[0][views] - lines

    return left(middles - 1), left(middles), left(middles + 1)


def _noise(
    taken: Scans, clean: np.ndarray, residuals: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the variance of every ray of one repeat.

    The variance comes from the spread over repeats. For a single repeat, it comes from second differences over views,
    and over rows if there are enough. Noise is assumed to be independent.

    Parameters
    ----------
    clean : ndarray, shape (views, rows, columns)
        Line integrals of the baseline.
    residuals : tuple of 3 ndarray, shape (views, rows, columns), optional
        Result of `_around` for a single repeat; None: the views are consecutive.

    Returns
    -------
    variance : ndarray, shape (views, rows, columns)
    squares : ndarray, shape (views, rows, columns), or None
        Squared second differences, scaled so that their mean is the variance; NaN without a signal. None for several
        repeats.
    """
    if len(taken) > 1:
        return taken.repeats.var(axis=0, ddof=1, dtype=np.float64) + 1e-30, None
    if residuals is None:
        second = _second_differences(taken.repeats[0] - clean, 0)
    else:
        before, here, after = residuals
        second = before - 2 * here + after
    if of_rows := has_rows(taken.usable):
        second = _second_differences(second, 1)
    blocks = Blocks.of(second.shape, PARTS)
    squares = np.where(taken.usable, second**2, np.nan) / WHITE.of_second_differences(of_rows)
    level, _ = mean_squares(squares * np.exp(-clean), blocks)
    return blocks.spread(np.maximum(level, 1e-30)) * np.exp(clean), squares


def has_rows(usable: np.ndarray) -> bool:
    """Return whether a scan has enough rows for their differences."""
    return usable.shape[1] >= LEAST_ROWS


def _second_differences(array: np.ndarray, axis: int) -> np.ndarray:
    """Return second differences along an axis; both ends repeat their neighbors."""
    array = np.moveaxis(array, axis, 0)
    found = np.empty_like(array)
    found[1:-1] = array[:-2] - 2 * array[1:-1] + array[2:]
    found[0], found[-1] = found[1], found[-2]
    return np.moveaxis(found, 0, axis)


def filled(values: np.ndarray) -> np.ndarray:
    """Fill blocks without a usable ray with the median; their rays are not used."""
    return np.where(np.isfinite(values), values, np.nanmedian(values))
