"""What a detector's sensor makes of a photon: how probably it is detected, and the energy that it then deposits.

A plane layer as wide as the detector, which photons enter at a right angle. A photon interacts by the photoelectric
effect or by Compton scattering; one that is scattered coherently goes on as before. A photoelectric vacancy in the K
shell may send out a K photon, to any side alike, and Compton scattering a photon by Klein and Nishina's law. What
leaves the layer takes its energy with it [1]_; what is absorbed again adds to the same deposit, and into which pixel it
falls is left to the crosstalk. The light or charge that a deposit brings about is taken to be in proportion to it.
Cross-sections, edges, jump factors, fluorescence yields and radiative rates: xraylib [2]_.

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

# Formula, density in g/cm^3, and a thickness in mm that detectors have. Those of powders or columns are as thick as the
# same mass would be as a solid.
SENSORS = {
    "caesium_iodide": ("CsI", 4.51, 0.6),  # columns on flat panels
    "gadolinium_oxysulfide": ("Gd2O2S", 7.32, 1.4),  # ceramic of CT detectors; screens have 0.1 to 0.3
    "yttrium_gadolinium_oxide": ("Y1.34Gd0.60Eu0.06O3", 5.95, 3.0),  # S. J. Duclos et al., NIM A 505, 68 (2003)
    "cadmium_tungstate": ("CdWO4", 7.9, 2.0),
    "cadmium_telluride": ("CdTe", 5.85, 1.6),  # photon counting: K. Rajendran et al., Radiology 303, 130 (2022)
    "silicon": ("Si", 2.33, 30.0),  # edge-on, counting: H. Bornefalk and M. Danielsson, PMB 55, 1999 (2010)
}
ENERGY, COUNTS = "energy", "counts"  # what is read: the energies deposited, or the number of photons
STATED_SD, TYPICAL_SD, UNKNOWN_SD = 0.05, 0.5, 1.0  # of the logarithm: thickness stated, the material alone, nothing
REST_KEV = 510.999  # of an electron
LINES = (xraylib.KA_LINE, xraylib.KB_LINE)
LEAST_LINE_KEV = 5.0  # softer fluorescence leaves no layer
TABLE_KEV = np.arange(1.0, 160.25, 0.25)  # where cross-sections are taken, linear in between
DEPTHS, ANGLES = (np.polynomial.legendre.leggauss(count) for count in (24, 12))


@dataclass(frozen=True)
class Sensor:
    """Of the detector.

    Attributes
    ----------
    material : str
        Of SENSORS.
    reads : {"energy", "counts"}
        ENERGY: photons count by the energy that they deposit; COUNTS: one each, if they deposit any.
    thickness_mm : float
        That it is expected to have, mm.
    thickness_sd : float
        Of its logarithm: how well it is known.

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
            raise InputError(f"a sensor that reads '{self.reads}' is unknown; use {ENERGY} or {COUNTS}")


def stated(material: str | None = None, thickness_mm: float | None = None, reads: str = ENERGY) -> Sensor:
    """The sensor of a label that says so much, and what is known of the thickness.

    Parameters
    ----------
    material : str, optional
        Of SENSORS; None: not stated.
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
    energies = np.array(energies_kev)
    photo, compton = (np.interp(energies, TABLE_KEV, values) for values in _tables(material)[:2])
    total = photo + compton
    detected = -np.expm1(-total * thickness_mm)
    # Depths that hold equal shares of what interacts, [energy, depth].
    places, weights = (DEPTHS[0] + 1) / 2, DEPTHS[1] / 2
    above = -np.log1p(-places * detected[:, None]) / total[:, None]
    below = thickness_mm - above
    # Photoelectric: all but what a K photon takes away.
    first, second = energies.copy(), energies**2
    for line_kev, probability in _k_photons(material, energies_kev):
        mu = np.interp(line_kev, TABLE_KEV, sum(_tables(material)[:2]))
        escaped = probability * ((scipy.special.expn(2, mu * above) + scipy.special.expn(2, mu * below)) / 2 @ weights)
        first = first - escaped * line_kev
        second = second - escaped * (energies**2 - (energies - line_kev) ** 2)
    # Compton: the electron's energy, and the scattered photon's where it does not leave.
    cosines, weight = ANGLES
    ratio = 1 / (1 + energies[:, None] / REST_KEV * (1 - cosines))
    chance = weight * ratio**2 * (ratio + 1 / ratio - 1 + cosines**2)
    chance /= chance.sum(axis=1, keepdims=True)
    left = energies[:, None] * ratio
    mu = np.interp(left, TABLE_KEV, sum(_tables(material)[:2]))
    way = np.where(cosines[:, None] > 0, below[:, None], above[:, None]) / np.abs(cosines)[:, None]
    escaped = chance * (np.exp(-mu[..., None] * way) @ weights)
    compton_first = energies - (escaped * left).sum(axis=1)
    compton_second = energies**2 - (escaped * (energies[:, None] ** 2 - (energies[:, None] - left) ** 2)).sum(axis=1)
    part = photo / total
    result = detected, part * first + (1 - part) * compton_first, part * second + (1 - part) * compton_second
    for values in result:
        values.setflags(write=False)
    return result


def response(
    material: str, thickness_mm: float, energies_kev: np.ndarray, reads: str = ENERGY
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How probably photons are detected, and what one then adds to the signal.

    Parameters
    ----------
    material : str
        Of SENSORS.
    thickness_mm : float
        mm.
    energies_kev : array_like, shape (energies,)
        keV.
    reads : {"energy", "counts"}, optional

    Returns
    -------
    detected : ndarray, shape (energies,)
        Probability that a photon is detected.
    mean, mean_square : ndarray, shape (energies,)
        Of what a detected one adds: energy in keV, or 1 where photons are counted.

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
    """Photoelectric and Compton attenuation at TABLE_KEV, 1/mm."""
    formula, density, _ = SENSORS[material]
    return tuple(
        np.array([one(formula, energy) for energy in TABLE_KEV.tolist()]) * density / 10
        for one in (xraylib.CS_Photo_CP, xraylib.CS_Compt_CP)
    )


@lru_cache(maxsize=32)
def _k_photons(material: str, energies_kev: tuple[float, ...]) -> list[tuple[float, np.ndarray]]:
    """Energy of each K line, and how many of its photons a photoelectric absorption at every energy sends out."""
    compound = xraylib.CompoundParser(SENSORS[material][0])
    shares = dict(zip(compound["Elements"], compound["massFractions"], strict=True))
    photo = {
        number: share * np.array([xraylib.CS_Photo(number, energy) for energy in energies_kev])
        for number, share in shares.items()
    }
    all_of_it, energies = sum(photo.values()), np.array(energies_kev)
    found = []
    for number, one in photo.items():
        for line in LINES:
            try:
                line_kev = xraylib.LineEnergy(number, line)
            except ValueError:  # the lightest elements have no such line
                continue
            if line_kev < LEAST_LINE_KEV:
                continue
            in_k = np.where(energies > xraylib.EdgeEnergy(number, xraylib.K_SHELL), one / all_of_it, 0)
            in_k = in_k * (1 - 1 / xraylib.JumpFactor(number, xraylib.K_SHELL))
            sent = xraylib.FluorYield(number, xraylib.K_SHELL) * xraylib.RadRate(number, line)
            found.append((line_kev, sent * in_k))
    return found
