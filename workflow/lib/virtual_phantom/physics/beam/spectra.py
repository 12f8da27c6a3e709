"""Tube spectra weighted by the detector response.

SpekPy [1]_ computes the spectrum of the tube, `sensors` the detected part. Filters use the cross-sections of xraylib,
so that their thickness can vary continuously.

References
----------
.. [1] G. Poludniowski et al., Med. Phys. 48, 3630, 2021.
"""

from __future__ import annotations

import contextlib
import os
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path

import numpy as np

from ...base.cache_folders import temporary_cache, user_cache
from ...base.errors import InputError
from ...io.files import check_unchanged, replacing
from .materials import attenuation_per_mm
from .sensors import Sensor, response

BINS = 24  # energies of a reduced spectrum
STEP_KEV = 0.5  # energy step of tube spectra, SpekPy's default
KVP = {"W": (30.0, 150.0), "Mo": (20.0, 50.0), "Rh": (20.0, 50.0)}  # range of SpekPy's tables


@dataclass(frozen=True)
class Anode:
    """Anode of an X-ray tube.

    Attributes
    ----------
    angle_deg : float
        Angle of its surface to the plane through source and detector columns, degrees. It is negative if the +z end of
        the focal spot is farther from the isocenter than the -z end.
    """

    target: str = "W"
    angle_deg: float = 12.0


TUNGSTEN, SENSOR = Anode(), Sensor()
Filters = tuple[tuple[str, np.ndarray], ...]  # materials, and thicknesses in mm


@dataclass(frozen=True)
class Spectrum:
    """Detected spectrum without an object.

    Attributes
    ----------
    signal : ndarray, shape (energies,) or (energies, rows, columns)
        Share of each energy in the mean signal, with a sum of 1 before additional filters. Rows and columns have length
        1 where a filter is constant.
    noise : ndarray, same shape as `signal`
        Share of each energy in the quantum variance of the signal, with a sum of 1 before additional filters. For
        deposits of mean e1 and mean square e2, signal is proportional to e1 and variance to e2 [1]_.
    finer : tuple of 3 ndarray, or None
        Energies before binning, keV, (finer,), and their contributions to the signal and to the noise of each bin,
        (energies, finer).

    References
    ----------
    .. [1] B. R. Whiting et al., Med. Phys. 33, 3290, 2006.
    """

    energies_kev: np.ndarray
    signal: np.ndarray
    noise: np.ndarray
    finer: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None

    @property
    def key(self) -> tuple:
        """Hashable content."""
        return tuple((array.shape, array.tobytes()) for array in (self.energies_kev, self.signal, self.noise))

    def filtered(self, filters: Filters) -> Spectrum:
        """Return the spectrum behind filters. Finer energies resolve K edges within bins."""
        energies, *parts = self.finer or (self.energies_kev, np.diag(self.signal), np.diag(self.noise))
        transmission = filter_transmission(filters, energies)
        return Spectrum(self.energies_kev, *(np.tensordot(part, transmission, 1) for part in parts))


def filter_transmission(filters: Filters, energies_kev: np.ndarray) -> np.ndarray:
    """Return the transmission of filters at each energy.

    Parameters
    ----------
    filters : tuple of tuple of str and ndarray
        At least one: materials and thicknesses in mm, broadcastable to (rows, columns).

    Returns
    -------
    ndarray, shape (energies, rows, columns)
    """
    depths = [np.multiply.outer(attenuation_per_mm(material, energies_kev), mm) for material, mm in filters]
    return np.exp(-sum(depths))


def cache_folder() -> Path | None:
    """Return the cache folder of spectra; None if there is neither a home nor a temporary folder.

    Fits of a voltage need dozens of spectra, and SpekPy takes half a second for each.
    """
    base = user_cache() or temporary_cache()
    return base and base / f"spekpy-{version('spekpy')}"


@lru_cache(maxsize=64)
def _tube(kvp: float, anode: Anode) -> tuple[np.ndarray, np.ndarray]:
    angle = abs(anode.angle_deg)
    folder = cache_folder() or Path(os.devnull)  # in which no file can exist
    cached = folder / f"{anode.target}_{kvp:g}kV_{angle:g}deg_{STEP_KEV:g}keV.npy"
    with contextlib.suppress(Exception):  # a missing or broken file is computed again
        check_unchanged(cached)
        energies, fluence = np.load(cached, allow_pickle=False)
        return energies, fluence
    import spekpy  # takes a second to load, and most jobs need no spectrum

    spectrum = spekpy.Spek(kvp=kvp, th=angle, dk=STEP_KEV, targ=anode.target)
    energies, fluence = spectrum.get_spectrum(edges=False)
    # Without write access the cache is skipped.
    with contextlib.suppress(OSError, InputError), replacing(cached) as temporary:
        np.save(temporary, np.stack([energies, fluence]))
    return energies, fluence


def tube_spectrum(kvp: float, anode: Anode = TUNGSTEN) -> tuple[np.ndarray, np.ndarray]:
    """Return the spectrum of an unfiltered tube, interpolated linearly between whole kilovolts.

    Returns
    -------
    energies : ndarray, shape (energies,)
        keV.
    fluence : ndarray, shape (energies,)
        Relative, per bin.

    Raises
    ------
    InputError
        If SpekPy has no tables for the anode or voltage.
    """
    if anode.target not in KVP:
        raise InputError(f"anode '{anode.target}' is unknown; use one of {', '.join(KVP)}")
    low, high = KVP[anode.target]
    if not low <= kvp <= high:
        raise InputError(f"tube voltage {kvp:g} kV: spectra of a {anode.target} anode go from {low:g} to {high:g} kV")
    below = min(np.floor(kvp), high - 1)
    part = kvp - below
    energies, more = _tube(float(below + 1), anode)
    lower_energies, less = _tube(float(below), anode)
    fluence = part * more
    fluence[: len(less)] += (1 - part) * less
    return energies, fluence


def weighted_spectrum(
    kvp: float,
    filtration_mm: float,
    anode: Anode = TUNGSTEN,
    sensor: Sensor = SENSOR,
    sensor_mm: float = SENSOR.thickness_mm,
) -> Spectrum:
    """Return the detected spectrum of a tube with an aluminum filter in BINS energies.

    Bins have equal shares of the signal, and their mean energies.

    Parameters
    ----------
    sensor : Sensor, optional
        Its own thickness is ignored.

    Raises
    ------
    InputError
        As tube_spectrum.
    """
    energies, fluence = tube_spectrum(kvp, anode)
    detected, first, second = response(sensor.material, sensor_mm, energies, sensor.reads)
    photons = fluence * np.exp(-attenuation_per_mm("aluminium", energies) * filtration_mm) * detected
    signal, noise = (photons * moment / (photons * moment).sum() for moment in (first, second))
    # Bin edges are quantiles of the signal. An energy at an edge is divided, so that bins change smoothly with kvp.
    edges, ends = np.linspace(0, 1, BINS + 1)[:, None], np.cumsum(signal)
    within = np.clip(np.minimum(ends, edges[1:]) - np.maximum(ends - signal, edges[:-1]), 0, None)
    within = np.divide(within, signal, out=np.zeros_like(within), where=signal > 0)  # share of each energy in each bin
    finer = energies, within * signal, within * noise
    signals, noises = (part.sum(axis=1) for part in finer[1:])
    return Spectrum(finer[1] @ energies / signals, signals, noises, finer)
