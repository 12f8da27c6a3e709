"""Changes of the readings after the detection, from equations of this package: glare, saturation, drifts, gains."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.signal import fftconvolve

from .hidden_effect import MODULE_SHARE, READOUT_KEV
from .unsteady import settling
from .xcist import Acquired

DARK_SPREAD = 0.2  # relative standard deviation of the dark current of pixels
MODULE_COLUMNS = 16  # of a detector module, whose amplifiers have a common gain error
GLARE_REACH = 4.0  # radius of the kernel, in units of the range


def read_out(
    taken: Acquired, settings: Mapping, pitch_mm: tuple[float, float], duration_s: float, random: np.random.Generator
) -> Acquired:
    """Return the readings with the hidden effects of the readout.

    Parameters
    ----------
    settings : mapping
        Hidden settings, as Scan.settings.
    pitch_mm : tuple of 2 float
        Pitch of columns and rows, mm.
    duration_s : float
        Duration of the scan, s.
    random : numpy.random.Generator
        Draws the gains and dark currents of the pixels.
    """
    readings, air = taken.readings, taken.air
    # The readout sees the modulated current; the monitor corrects it afterwards.
    current = 1.0 if taken.current is None else taken.current[:, None, None]
    readings = readings * current
    if share := settings.get("glare_share", 0.0):
        spread = glare(settings["glare_range_mm"], pitch_mm)
        readings, air = ((1 - share) * signal + share * wide(signal, spread) for signal in (readings, air))
    if loss := settings.get("saturation_per_photon", 0.0) / READOUT_KEV:
        # Loss in proportion to the signal: S' = S (1 - a S), also in the air scan.
        readings, air = (signal * (1 - loss * signal) for signal in (readings, air))
    if rms := settings.get("gain_rms", 0.0):
        readings = readings * gains(rms, air.shape, random)
    level, drift = (settings.get(key, 0.0) * READOUT_KEV for key in ("dark_photons", "dark_photons_per_s"))
    if level or drift:
        views, pixels = readings.shape[1], 1 + DARK_SPREAD * random.uniform(-np.sqrt(3), np.sqrt(3), air.shape)
        # The detector warms up exponentially.
        warming = drift * duration_s * np.array([settling((view + 0.5) / views) for view in range(views)])
        readings = readings + (level + warming[:, None, None]) * pixels
        air = air + level * pixels
    return Acquired((readings / current).astype(np.float32), air.astype(np.float32))


def gains(rms: float, shape: tuple[int, int], random: np.random.Generator) -> np.ndarray:
    """Return the gains of pixels, (rows, columns): MODULE_SHARE of the variance is common to the columns of a module.

    Errors of pixels are uniformly distributed.
    """
    modules = random.normal(0, 1, -(-shape[1] // MODULE_COLUMNS)).repeat(MODULE_COLUMNS)[: shape[1]]
    pixels = random.uniform(-np.sqrt(3), np.sqrt(3), shape)
    return 1 + rms * (np.sqrt(MODULE_SHARE) * modules + np.sqrt(1 - MODULE_SHARE) * pixels)


def glare(range_mm: float, pitch_mm: tuple[float, float]) -> np.ndarray:
    """Return the point spread function exp(-r / k) / r of veiling glare [1]_.

    The central pixel has the mean over a disc of the same area.

    Parameters
    ----------
    range_mm : float
        k, mm.
    pitch_mm : tuple of 2 float
        Pitch of columns and rows, mm.

    Returns
    -------
    ndarray, shape (rows, columns)
        The sum is 1.

    References
    ----------
    .. [1] J. A. Seibert et al., Med. Phys. 11, 172, 1984.
    """
    column, row = pitch_mm
    columns, rows = (int(np.ceil(GLARE_REACH * range_mm / step)) for step in (column, row))
    x, y = np.arange(-columns, columns + 1) * column, np.arange(-rows, rows + 1) * row
    distance = np.hypot(x, y[:, None])
    radius = np.sqrt(column * row / np.pi)
    distance[rows, columns] = radius / 2  # mean of 1 / r over the disc is 2 / R
    spread = np.exp(-distance / range_mm) / distance
    return spread / spread.sum()


def wide(array: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Convolve the last two axes with the spread; edge values continue beyond the detector."""
    rows, columns = (n // 2 for n in spread.shape)
    around = [(0, 0)] * (array.ndim - 2) + [(rows, rows), (columns, columns)]
    padded = np.pad(array, around, mode="edge")
    return fftconvolve(padded, spread.reshape((1,) * (array.ndim - 2) + spread.shape), mode="valid", axes=(-2, -1))
