"""Noisy acquisitions: Poisson counts per detector pixel, or the noise of the chain."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..base.counts import Counts
from ..base.errors import InputError
from ..base.streams import Stream, acquisition, common_acquisition, generator
from ..physics.noise.poisson import poisson_counts

if TYPE_CHECKING:
    from ..physics.state import State

MODELS = ("astra", "physical")
INDEPENDENT, COMMON = "independent", "common"


def simulate_counts(line_integrals: np.ndarray, noise_level: float, model: str, stream: Stream) -> Counts:
    """Simulate one noisy acquisition of noise-free line integrals.

    Parameters
    ----------
    line_integrals : ndarray, shape (views, rows, columns)
        Dimensionless.
    noise_level : float
        A = 1 / I0, where I0 is the mean number of photons per pixel without an object.
    model : {"physical", "astra"}
        "physical": counts ~ Poisson(I0 exp(-p)) [1]_.
        "astra": counts ~ Poisson(I0 exp(-p / p_max)) with the largest line integral p_max of the scan. This is ASTRA's
        add_noise_to_sino, which the paper names as its implementation.

    Raises
    ------
    InputError
        For an unknown model. For a noise level that is infinite or below 1e-9 (counters would overflow). For line
        integrals that are not finite, or nowhere positive in the "astra" model.

    References
    ----------
    .. [1] Flouris et al., Sci. Rep. 12, 2022.
    """
    if model not in MODELS:
        raise InputError(f"noise.model '{model}' is unknown; use one of {', '.join(MODELS)}")
    if not 1e-9 <= noise_level < np.inf:
        raise InputError(f"noise level {noise_level}: A = 1/I0 must be at least 1e-9")
    if not np.isfinite(line_integrals).all():
        raise InputError("the projections hold NaN or infinite values; check the phantom and its materials")
    scale = float(line_integrals.max()) if model == "astra" else 1.0
    if scale <= 0:
        raise InputError("the projections are empty: the phantom attenuates no ray; check the phantom and the grid")
    white, random = 1 / noise_level, generator(stream)
    counts = np.empty(line_integrals.shape, np.uint32)
    for view, lines in enumerate(line_integrals):  # a whole scan in double precision would take gigabytes
        counts[view] = poisson_counts(white * np.exp(-lines.astype(np.float64) / scale), random)
    kind = np.uint16 if counts.max(initial=0) < 2**16 else np.uint32
    return Counts(counts.astype(kind, copy=False), white, scale)


def acquire(
    line_integrals: np.ndarray,
    *,
    geometry: str,
    noise: str,
    noise_level: float,
    seed: int,
    model: str,
    study_seed: int,
    draws: str = INDEPENDENT,
    state: State | None = None,
) -> Counts:
    """Simulate one noisy acquisition of a study.

    Parameters
    ----------
    line_integrals : ndarray, shape (views, rows, columns)
        Dimensionless.
    geometry, noise : str
        Labels of the scan geometry and of the noise level.
    noise_level : float
        A = 1 / I0.
    seed : int
        Number of the repeat.
    model : {"physical", "astra"}
        As simulate_counts takes it.
    draws : {"independent", "common"}, optional
        "independent": the random stream depends on all labels. "common": it depends only on the repeat. The same pixel
        then has the same uniform number, and the same quantile of its counts, in all scans with the same shape.
    state : State, optional
        State of the chain, in which `photons` is relative to 1/A; None: baseline.

    Raises
    ------
    InputError
        As `simulate_counts`.
    ValueError
        For other `draws`.
    """
    if draws not in (INDEPENDENT, COMMON):
        raise ValueError(f"draws '{draws}': use {INDEPENDENT} or {COMMON}")
    common = draws == COMMON
    stream = common_acquisition(study_seed, seed) if common else acquisition(study_seed, geometry, noise, seed)
    if state is None:
        return simulate_counts(line_integrals, noise_level, model, stream)
    state = replace(state, photons=state.photons / noise_level)
    air = state.measured_air
    white = air.mean(axis=0)
    # With tube current modulation, scanners normalize every view by the reading of a monitor.
    data = state.counts(generator(stream)) * (white / air)
    return Counts(data.astype(np.float32), (white * state.photons).astype(np.float32), 1.0)
