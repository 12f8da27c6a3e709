"""Tube spectra as the detector weighs them.

SpekPy [1]_ makes the tube's spectrum; filters attenuate it by xraylib's cross-sections, so that their thickness can be
varied continuously; `sensors` says what is detected of it.

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

from ...base.caches import temporary_cache, user_cache
from ...base.errors import InputError
from ...io.files import check_unchanged, replacing
from .materials import attenuation_per_mm
from .sensors import Sensor, response

BINS = 24  # energies that a spectrum is reduced to
STEP_KEV = 0.5  # of tube spectra as SpekPy makes them: its own default
KVP = {"W": (30.0, 150.0), "Mo": (20.0, 50.0), "Rh": (20.0, 50.0)}  # what SpekPy's tables cover


@dataclass(frozen=True)
class Anode:
    """Of the tube.

    Attributes
    ----------
    target : str
        Its element.
    angle_deg : float
        By which its surface is inclined to the plane through source and detector's columns, degrees; negative if the
        end of the focal spot at +z lies farther from the isocentre than that at -z.
    """

    target: str = "W"
    angle_deg: float = 12.0


TUNGSTEN, SENSOR = Anode(), Sensor()


Filters = tuple[tuple[str, np.ndarray], ...]


@dataclass(frozen=True)
class Spectrum:
    """What is read out of a beam without an object, energy by energy.

    Attributes
    ----------
    energies_kev : ndarray, shape (energies,)
        Of the photons, keV.
    signal : ndarray, shape (energies,) or (energies, rows, columns)
        Share of each in the mean signal; before filters their sum is 1. Behind filters as far as rows and columns
        differ.
    noise : ndarray, shaped as `signal`
        Share of each in the signal's quantum variance; before filters their sum is 1. Photons whose deposits have the
        mean e1 and the mean square e2 have signals in proportion to e1 and variances to e2 [1]_.
    finer : tuple of 3 ndarray, or None
        More energies in keV, (finer,), and what of signal and noise each of them has, (energies, finer); None: there
        are none.

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
        """Equal for equal spectra, and hashable."""
        return tuple((one.shape, one.tobytes()) for one in (self.energies_kev, self.signal, self.noise))

    def behind(self, filters: Filters) -> Spectrum:
        """What filters leave of it, by its finer energies where there are any: edges of absorption lie within few."""
        energies, *parts = self.finer or (self.energies_kev, np.diag(self.signal), np.diag(self.noise))
        left = passing(filters, energies)
        return Spectrum(self.energies_kev, *(np.tensordot(one, left, 1) for one in parts))


def passing(filters: Filters, energies_kev: np.ndarray) -> np.ndarray:
    """Share of the photons of each energy that pass filters.

    Parameters
    ----------
    filters : tuple of tuple of str and ndarray
        At least one: materials and thicknesses in mm, broadcastable to (rows, columns).
    energies_kev : ndarray, shape (energies,)
        keV.

    Returns
    -------
    ndarray, shape (energies, rows, columns)
    """
    depths = [np.multiply.outer(attenuation_per_mm(material, energies_kev), mm) for material, mm in filters]
    return np.exp(-sum(depths))


def cache_folder() -> Path | None:
    """Where spectra are kept from one process to the next.

    Fits of a voltage need dozens, and each takes SpekPy half a second.

    Returns
    -------
    Path or None
        None if there is neither a home folder nor one for temporary files.
    """
    base = user_cache() or temporary_cache()
    return base and base / f"spekpy-{version('spekpy')}"


@lru_cache(maxsize=64)
def _tube(kvp: float, anode: Anode) -> tuple[np.ndarray, np.ndarray]:
    angle = abs(anode.angle_deg)
    folder = cache_folder() or Path(os.devnull)  # below which there is no file, and none can be made
    kept = folder / f"{anode.target}_{kvp:g}kV_{angle:g}deg_{STEP_KEV:g}keV.npy"
    with contextlib.suppress(Exception):  # missing, or broken by another program: made again
        check_unchanged(kept)
        energies, fluence = np.load(kept, allow_pickle=False)
        return energies, fluence
    import spekpy  # takes a second to load, and most jobs need no spectrum

    spectrum = spekpy.Spek(kvp=kvp, th=angle, dk=STEP_KEV, targ=anode.target)
    energies, fluence = spectrum.get_spectrum(edges=False)
    # A home that cannot be written to costs time only.
    with contextlib.suppress(OSError, InputError), replacing(kept) as temporary:
        np.save(temporary, np.stack([energies, fluence]))
    return energies, fluence


def tube_spectrum(kvp: float, anode: Anode = TUNGSTEN) -> tuple[np.ndarray, np.ndarray]:
    """The spectrum of an unfiltered tube, linear between whole kilovolts.

    Parameters
    ----------
    kvp : float
        Tube voltage, kV.

    Returns
    -------
    energies : ndarray, shape (energies,)
        keV.
    fluence : ndarray, shape (energies,)
        Relative, per bin.

    Raises
    ------
    InputError
        For an anode or voltage that SpekPy has no tables for.
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
    filter_material: str = "aluminium",
) -> Spectrum:
    """What a sensor of this thickness reads of a filtered tube, in BINS energies.

    Bins hold equal shares of the signal, at their mean energies.

    Parameters
    ----------
    kvp : float
        Tube voltage, kV.
    filtration_mm : float
        Thickness of the filter, mm.
    sensor : Sensor, optional
        Its own thickness is not looked at.
    sensor_mm : float, optional
        Thickness of the sensor, mm.
    filter_material : str, optional
        Of materials.COMPOUNDS or ELEMENTS.

    Raises
    ------
    InputError
        As tube_spectrum.
    """
    energies, fluence = tube_spectrum(kvp, anode)
    detected, first, second = response(sensor.material, sensor_mm, energies, sensor.reads)
    photons = fluence * np.exp(-attenuation_per_mm(filter_material, energies) * filtration_mm) * detected
    signal, noise = (photons * moment / (photons * moment).sum() for moment in (first, second))
    # Equal shares: edges in the cumulative signal, so that few bins follow a spectrum of any shape smoothly.
    edges, ends = np.linspace(0, 1, BINS + 1)[:, None], np.cumsum(signal)
    within = np.clip(np.minimum(ends, edges[1:]) - np.maximum(ends - signal, edges[:-1]), 0, None)
    within = np.divide(within, signal, out=np.zeros_like(within), where=signal > 0)  # share of each energy in each bin
    finer = energies, within * signal, within * noise
    shares, noises = (one.sum(axis=1) for one in finer[1:])
    return Spectrum(finer[1] @ energies / shares, shares, noises, finer)
