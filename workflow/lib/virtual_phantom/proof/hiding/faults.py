"""Faults of detector and readout for which the library has no effect, from equations of this package."""

from __future__ import annotations

import numpy as np

from ...base.streams import branch, generator
from .xcist import Acquired, Scan


def faulty(taken: Acquired, scan: Scan, random: np.random.Generator) -> Acquired:
    """Return the readings with the hidden faults; `random` selects the quanta that share their charge."""
    settings, readings, air = scan.settings, taken.readings, taken.air
    if share := settings.get("charge_share", 0.0):
        # The air scan has no noise, so the expected value is added.
        readings, air = charge_shared(readings, share, scan.kev, random), air + share * _mean_of_neighbors(air)
    if rise := settings.get("warming", 0.0):
        readings = readings * warmed(scan.views, scan.columns, rise, settings["warming_turns"])[:, None]
    if share := settings.get("dim_share", 0.0):
        readings = readings.copy()
        readings[:, chosen(scan.views, settings["dim_views"], settings["dim_seed"])] *= 1 - share
    if lost := settings.get("lost_views", 0.0):
        readings = readings.copy()
        for view in chosen(scan.views, lost, settings["lost_seed"]):
            readings[:, view] = readings[:, view - 1]
    return Acquired(readings.astype(np.float32), air.astype(np.float32), current=taken.current)


def chosen(views: int, share: float, seed: int) -> np.ndarray:
    """Return the sorted numbers of a share of the views: at least one view, never the first."""
    count = max(1, round(share * views))
    return np.sort(1 + generator(branch(seed, 0)).choice(views - 1, count, replace=False))


def warmed(views: int, columns: int, rise: float, turns: float) -> np.ndarray:
    """Return the gains of a detector that warms up, shape (views, columns), with a mean of 1 in every view.

    The relative change approaches a limit exponentially, with the time constant `turns`. The limit is linear along the
    columns, from -`rise` in the first to `rise` in the last column.
    """
    time = (np.arange(views) + 0.5) / views
    return 1 + rise * -np.expm1(-time / turns)[:, None] * np.linspace(-1, 1, columns)


def charge_shared(readings: np.ndarray, share: float, kev: float, random: np.random.Generator) -> np.ndarray:
    """Count quanta near the edge of their pixel also in the adjacent pixel.

    Second counts outside of the detector are lost.

    Parameters
    ----------
    readings : ndarray, shape (..., columns)
        Energies, keV, like the result.
    share : float
        Share of all quanta that are counted twice, half of them on either side.
    kev : float
        Energy of one quantum.
    """
    quanta = np.rint(np.maximum(readings, 0) / kev).astype(np.int64)
    crossing = random.binomial(quanta, share)
    right = random.binomial(crossing, 0.5)
    added = np.zeros(quanta.shape)
    added[..., 1:] += right[..., :-1]
    added[..., :-1] += (crossing - right)[..., 1:]
    return readings + kev * added


def _mean_of_neighbors(values: np.ndarray) -> np.ndarray:
    """Return half of the sum of the two neighbors along the columns."""
    found = np.zeros(values.shape)
    found[..., 1:] += values[..., :-1] / 2
    found[..., :-1] += values[..., 1:] / 2
    return found


def refracted(photons: np.ndarray, amount: float) -> np.ndarray:
    """Move photons at edges to the brighter side, as refraction does.

    Free propagation through one material: I' = I - k Laplacian of I [1]_, a divergence, so that no photon is lost.

    Parameters
    ----------
    photons : ndarray, shape (columns, rows, energies)
        Means of the Poisson counts.
    amount : float
        k, pixels squared.

    References
    ----------
    .. [1] D. Paganin et al., J. Microsc. 206, 33, 2002.
    """
    moved = photons.copy()
    for axis in (0, 1):
        flow = amount * np.diff(photons, axis=axis)
        first, last = ([slice(None)] * photons.ndim for _ in range(2))
        first[axis], last[axis] = slice(None, -1), slice(1, None)
        moved[tuple(first)] -= flow
        moved[tuple(last)] += flow
    return moved


def displaced_tile(transmission: np.ndarray, first: float, last: float, shift: float) -> np.ndarray:
    """Displace a tile of the detector along the columns, by linear interpolation.

    Parameters
    ----------
    transmission : ndarray, shape (columns, ...)
    first, last : float
        Limits of the tile, shares of the columns.
    shift : float
        Columns.
    """
    columns = len(transmission)
    inside = np.arange(round(first * columns), round(last * columns))
    position = np.clip(inside + shift, 0, columns - 1)
    low = np.minimum(position.astype(int), columns - 2)
    rest = (position - low).reshape(-1, *[1] * (transmission.ndim - 1))
    result = transmission.copy()
    result[inside] = (1 - rest) * transmission[low] + rest * transmission[low + 1]
    return result
