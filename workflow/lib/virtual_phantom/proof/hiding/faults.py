"""Faults of detector and read-out that the library has no effect for, each from an equation of its own."""

from __future__ import annotations

import numpy as np

from ...base.streams import branch, generator
from .xcist import Acquired, Scan


def faulty(taken: Acquired, scan: Scan, random: np.random.Generator) -> Acquired:
    """The readings with the faults that are concealed.

    Parameters
    ----------
    random : numpy.random.Generator
        Draws which quanta share their charge.
    """
    settings, readings, air = scan.settings, taken.readings, taken.air
    if share := settings.get("charge_share", 0.0):
        # Of the air scan, which has no noise, the mean.
        readings, air = charge_shared(readings, share, scan.kev, random), air + share * _from_beside(air)
    if rise := settings.get("warming", 0.0):
        readings = readings * warmed(scan.views, scan.columns, rise, settings["warming_turns"])[:, None]
    if share := settings.get("dim_share", 0.0):
        readings = readings.copy()
        readings[:, chosen(scan.views, settings["dim_views"], settings["dim_seed"])] *= 1 - share
    if many := settings.get("lost_views", 0.0):
        readings = readings.copy()
        for view in chosen(scan.views, many, settings["lost_seed"]):
            readings[:, view] = readings[:, view - 1]
    return Acquired(readings.astype(np.float32), air.astype(np.float32), current=taken.current)


def chosen(views: int, share: float, seed: int) -> np.ndarray:
    """Some views, in order, one at least and never the first.

    Parameters
    ----------
    share : float
        Of them.
    """
    count = max(1, round(share * views))
    return np.sort(1 + generator(branch(seed, 0)).choice(views - 1, count, replace=False))


def warmed(views: int, columns: int, rise: float, turns: float) -> np.ndarray:
    """Gains of a detector that warms up: ends that lie farther from the fan gain more, towards a limit.

    Parameters
    ----------
    rise : float
        Of the last column in the end, and with the other sign of the first one.
    turns : float
        In which a part 1 - 1/e of that is reached.

    Returns
    -------
    ndarray, shape (views, columns)
        The mean of a view is 1.
    """
    time = (np.arange(views) + 0.5) / views
    return 1 + rise * -np.expm1(-time / turns)[:, None] * np.linspace(-1, 1, columns)


def charge_shared(readings: np.ndarray, share: float, kev: float, random: np.random.Generator) -> np.ndarray:
    """Quanta near an edge of their pixel are counted in the pixel beside it too.

    Parameters
    ----------
    readings : ndarray, shape (..., columns)
        Energies, keV.
    share : float
        Of all quanta, to either side alike.
    kev : float
        Of one quantum.

    Returns
    -------
    ndarray
        Shaped as `readings`, keV. What crosses the detector's edge is lost.
    """
    quanta = np.rint(np.maximum(readings, 0) / kev).astype(np.int64)
    crossing = random.binomial(quanta, share)
    right = random.binomial(crossing, 0.5)
    more = np.zeros(quanta.shape)
    more[..., 1:] += right[..., :-1]
    more[..., :-1] += (crossing - right)[..., 1:]
    return readings + kev * more


def _from_beside(values: np.ndarray) -> np.ndarray:
    """Half of what each neighbour along the columns holds."""
    found = np.zeros(values.shape)
    found[..., 1:] += values[..., :-1] / 2
    found[..., :-1] += values[..., 1:] / 2
    return found


def refracted(photons: np.ndarray, amount: float) -> np.ndarray:
    """Photons that refraction at edges has moved to the brighter side of them.

    Free propagation through one material: I' = I - k Laplacian of I [1]_, a divergence, so that no photon is lost.

    Parameters
    ----------
    photons : ndarray, shape (columns, rows, energies)
        Means, before they are counted.
    amount : float
        k, in squares of a pixel.

    Returns
    -------
    ndarray
        Shaped as `photons`.

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
    """A tile of the detector beside its place: its cells see what lies farther along the columns.

    Parameters
    ----------
    transmission : ndarray, shape (columns, ...)
    first, last : float
        Where the tile begins and ends, shares of the columns.
    shift : float
        Columns, by linear interpolation.

    Returns
    -------
    ndarray
        Shaped as `transmission`.
    """
    columns = len(transmission)
    inside = np.arange(round(first * columns), round(last * columns))
    place = np.clip(inside + shift, 0, columns - 1)
    low = np.minimum(place.astype(int), columns - 2)
    rest = (place - low).reshape(-1, *[1] * (transmission.ndim - 1))
    result = transmission.copy()
    result[inside] = (1 - rest) * transmission[low] + rest * transmission[low + 1]
    return result
