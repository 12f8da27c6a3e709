"""Response of a detector sensor: detection probability of a photon, and the energy that it deposits.

The sensor is an infinite plane layer that photons enter perpendicularly. Photons interact by the photoelectric effect
or by Compton scattering; coherent scattering is ignored. A vacancy in the K shell may emit a K photon isotropically,
and Compton scattering emits a photon by the Klein-Nishina formula. Secondary photons that leave the layer carry their
energy away [1]_. Photons that are absorbed again add to the same deposit; the pixel in which they are absorbed is part
of the crosstalk. Light or charge is proportional to the deposited energy. Cross-sections, edges, jump factors,
fluorescence yields and radiative rates: xraylib [2]_.

References
----------
.. [1] R. K. Swank, J. Appl. Phys. 44, 4199, 1973.
.. [2] T. Schoonjans et al., Spectrochim. Acta B 66, 776, 2011.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
import scipy
import xraylib

from ...base.errors import InputError

# Formula, density in g/cm^3, and a typical thickness in mm. The thickness of powders and columns is that of a solid
# with the same mass per area.
SENSORS = {
    "caesium_iodide": ("CsI", 4.51, 0.6),  # columns on flat panels
    "gadolinium_oxysulfide": ("Gd2O2S", 7.32, 1.4),  # ceramic of CT detectors; screens have 0.1 to 0.3
    "yttrium_gadolinium_oxide": ("Y1.34Gd0.60Eu0.06O3", 5.95, 3.0),  # S. J. Duclos et al., NIM A 505, 68 (2003)
    "cadmium_tungstate": ("CdWO4", 7.9, 2.0),
    "cadmium_telluride": ("CdTe", 5.85, 1.6),  # photon counting: K. Rajendran et al., Radiology 303, 130 (2022)
    "silicon": ("Si", 2.33, 30.0),  # edge-on, counting: H. Bornefalk and M. Danielsson, PMB 55, 1999 (2010)
}
ENERGY, COUNTS = "energy", "counts"  # signal: deposited energy, or number of photons
# Standard deviation of the logarithm of the thickness, if thickness, only material, or nothing is stated.
STATED_SD, TYPICAL_SD, UNKNOWN_SD = 0.05, 0.5, 1.0
REST_KEV = 510.999  # rest energy of an electron
LINES = (xraylib.KA_LINE, xraylib.KB_LINE)
MIN_LINE_KEV = 5.0  # softer fluorescence does not leave the layer
TABLE_KEV = np.arange(1.0, 160.25, 0.25)  # energies of tabulated cross-sections, with linear interpolation
DEPTHS, ANGLES = (np.polynomial.legendre.leggauss(count) for count in (24, 12))


@dataclass(frozen=True)
class Sensor:
    """Sensor of a detector.

    Attributes
    ----------
    material : str
        Name in SENSORS.
    reads : {"energy", "counts"}
        ENERGY: the signal is the deposited energy; COUNTS: the number of photons that deposit any energy.
    thickness_sd : float
        Standard deviation of the logarithm of the thickness.

    Raises
    ------
    InputError
        For an unknown material or reading.
    """

    material: str = "caesium_iodide"
    reads: str = ENERGY
    thickness_mm: float = SENSORS["caesium_iodide"][2]
    thickness_sd: float = UNKNOWN_SD

    def __post_init__(self):
        if self.material not in SENSORS:
            raise InputError(f"sensor '{self.material}' is unknown; use one of {', '.join(SENSORS)}")
        if self.reads not in (ENERGY, COUNTS):
            raise InputError(f"sensor signal '{self.reads}' is unknown; use {ENERGY} or {COUNTS}")


def sensor_from_label(material: str | None = None, thickness_mm: float | None = None, reads: str = ENERGY) -> Sensor:
    """Return the sensor of a detector label, with the uncertainty of its thickness.

    Parameters
    ----------
    material : str, optional
        Name in SENSORS; None: not stated.
    thickness_mm : float, optional
        mm; None: not stated.
    reads : {"energy", "counts"}, optional

    Raises
    ------
    InputError
        For an unknown material.
    """
    known = Sensor(material or Sensor.material, reads)
    typical = SENSORS[known.material][2]
    if thickness_mm is not None:
        return Sensor(known.material, reads, thickness_mm, STATED_SD)
    return Sensor(known.material, reads, typical, UNKNOWN_SD if material is None else TYPICAL_SD)


@lru_cache(maxsize=32)
def _response(material: str, thickness_mm: float, energies_kev: tuple[float, ...]) -> tuple[np.ndarray, ...]:
    """Return `response` for ENERGY, read-only."""
    energies = np.array(energies_kev)
    photo, compton = (np.interp(energies, TABLE_KEV, values) for values in _tables(material)[:2])
    total = photo + compton
    detected = -np.expm1(-total * thickness_mm)
    # Depth z of the interaction by inversion of its distribution: z = -ln(1 - q detected) / mu at quantiles q.
    quantiles, weights = (DEPTHS[0] + 1) / 2, DEPTHS[1] / 2
    above = -np.log1p(-quantiles * detected[:, None]) / total[:, None]
    below = thickness_mm - above
    # Photoelectric effect: photon energy minus K photons that escape. An isotropic photon escapes from a depth z with
    # probability E_2(mu z) / 2 through a surface.
    first, second = energies.copy(), energies**2
    for line_kev, probability in _k_photons(material, energies_kev):
        mu = np.interp(line_kev, TABLE_KEV, sum(_tables(material)[:2]))
        escaped = probability * ((scipy.special.expn(2, mu * above) + scipy.special.expn(2, mu * below)) / 2 @ weights)
        first = first - escaped * line_kev
        second = second - escaped * (energies**2 - (energies - line_kev) ** 2)
    # Compton scattering: photon energy minus scattered photons that escape. Klein-Nishina formula with r = E'/E:
    # d(sigma) ~ r^2 (r + 1/r - sin^2).
    cosines, weight = ANGLES
    ratio = 1 / (1 + energies[:, None] / REST_KEV * (1 - cosines))
    probability = weight * ratio**2 * (ratio + 1 / ratio - 1 + cosines**2)
    probability /= probability.sum(axis=1, keepdims=True)
    scattered = energies[:, None] * ratio
    mu = np.interp(scattered, TABLE_KEV, sum(_tables(material)[:2]))
    path = np.where(cosines[:, None] > 0, below[:, None], above[:, None]) / np.abs(cosines)[:, None]
    escaped = probability * (np.exp(-mu[..., None] * path) @ weights)
    compton_first = energies - (escaped * scattered).sum(axis=1)
    lost_squares = energies[:, None] ** 2 - (energies[:, None] - scattered) ** 2
    compton_second = energies**2 - (escaped * lost_squares).sum(axis=1)
    part = photo / total
    result = detected, part * first + (1 - part) * compton_first, part * second + (1 - part) * compton_second
    for values in result:
        values.setflags(write=False)
    return result


def response(
    material: str, thickness_mm: float, energies_kev: np.ndarray, reads: str = ENERGY
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the detection probability of photons, and the moments of the signal of a detected photon.

    Parameters
    ----------
    material : str
        Name in SENSORS.
    energies_kev : array_like, shape (energies,)
        keV.
    reads : {"energy", "counts"}, optional

    Returns
    -------
    detected : ndarray, shape (energies,)
        Probability that a photon is detected.
    mean, mean_square : ndarray, shape (energies,)
        Moments of the signal: energy in keV, or 1 for COUNTS.

    Raises
    ------
    InputError
        For an unknown material.
    """
    Sensor(material, reads)
    detected, first, second = _response(material, float(thickness_mm), tuple(np.asarray(energies_kev, float).tolist()))
    if reads == COUNTS:
        return detected, np.ones_like(first), np.ones_like(second)
    return detected, first, second


@cache
def _tables(material: str) -> tuple[np.ndarray, np.ndarray]:
    """Return photoelectric and Compton attenuation at TABLE_KEV, 1/mm."""
    formula, density, _ = SENSORS[material]
    return tuple(
        np.array([cross_section(formula, energy) for energy in TABLE_KEV.tolist()]) * density / 10
        for cross_section in (xraylib.CS_Photo_CP, xraylib.CS_Compt_CP)
    )


@lru_cache(maxsize=32)
def _k_photons(material: str, energies_kev: tuple[float, ...]) -> list[tuple[float, np.ndarray]]:
    """Return the energy of each K line, and its photons per photoelectric absorption at every energy."""
    compound = xraylib.CompoundParser(SENSORS[material][0])
    shares = dict(zip(compound["Elements"], compound["massFractions"], strict=True))
    photo = {
        number: share * np.array([xraylib.CS_Photo(number, energy) for energy in energies_kev])
        for number, share in shares.items()
    }
    total, energies = sum(photo.values()), np.array(energies_kev)
    found = []
    for number, absorption in photo.items():
        for line in LINES:
            try:
                line_kev = xraylib.LineEnergy(number, line)
            except ValueError:  # the lightest elements have no such line
                continue
            if line_kev < MIN_LINE_KEV:
                continue
            in_k = np.where(energies > xraylib.EdgeEnergy(number, xraylib.K_SHELL), absorption / total, 0)
            in_k = in_k * (1 - 1 / xraylib.JumpFactor(number, xraylib.K_SHELL))
            emitted = xraylib.FluorYield(number, xraylib.K_SHELL) * xraylib.RadRate(number, line)
            found.append((line_kev, emitted * in_k))
    return found
