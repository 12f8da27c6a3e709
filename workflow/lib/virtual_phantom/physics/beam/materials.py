"""Linear attenuation of materials, and the decomposition of HU into materials.

Cross-sections: xraylib [1]_, total with coherent scattering. Compositions and densities: the NIST compounds in xraylib,
with tissues of ICRP and ICRU, or a Mixture.

References
----------
.. [1] T. Schoonjans et al., Spectrochim. Acta B 66, 776, 2011.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy
import xraylib

from ...base.errors import InputError
from ...base.units import hu_to_attenuation
from .material_names import COMPOUNDS, ELEMENTS, library_name

TEST_KEV = 60.0  # energy at which a composition is checked
FRACTION_TOLERANCE = 0.01  # of the sum of mass fractions: published values are rounded
ENERGIES_KEV = (10.0, 160.0)  # range of the energy of a monochromatic beam


@dataclass(frozen=True)
class Mixture:
    """A material that is not in the library.

    Attributes
    ----------
    compound : str or None
        Chemical formula (C2H4), or name of a compound of xraylib's NIST list.
    mass_fractions : tuple of tuple of (str, float)
        (element symbol, mass fraction) with a sum of 1, if there is no compound.

    Raises
    ------
    InputError
        For a density that is not positive, an unknown compound or element, or fractions that do not add up to 1.
    """

    name: str
    density_g_per_cm3: float
    compound: str | None = None
    mass_fractions: tuple[tuple[str, float], ...] = ()

    def __post_init__(self):
        if not self.density_g_per_cm3 > 0:
            raise InputError(f"material '{self.name}': density {self.density_g_per_cm3} must be positive (g/cm3)")
        if (self.compound is None) == (not self.mass_fractions):
            raise InputError(f"material '{self.name}': give it either a compound or mass_fractions")
        try:
            self.mass_attenuation(TEST_KEV)
        except ValueError:
            what = self.compound or ", ".join(symbol for symbol, _ in self.mass_fractions)
            raise InputError(
                f"material '{self.name}': '{what}' is no chemical formula, element or compound of xraylib's NIST list; "
                "give a formula such as C5H8O2, or mass_fractions of elements by their symbols"
            ) from None
        total = sum(share for _, share in self.mass_fractions)
        if self.mass_fractions and abs(total - 1) > FRACTION_TOLERANCE:
            raise InputError(f"material '{self.name}': mass_fractions add up to {total:g}; make the sum 1")

    def __str__(self) -> str:
        return self.name

    def mass_attenuation(self, energy_kev: float) -> float:
        """Return the total cross-section, cm2/g."""
        if self.compound is not None:
            return xraylib.CS_Total_CP(self.compound, energy_kev)
        return sum(
            share * xraylib.CS_Total(xraylib.SymbolToAtomicNumber(symbol), energy_kev)
            for symbol, share in self.mass_fractions
        )


Material = str | Mixture  # name in COMPOUNDS or ELEMENTS, or another material


def attenuation_per_mm(material: Material, energies_kev: np.ndarray) -> np.ndarray:
    """Return the linear attenuation of a material.

    Parameters
    ----------
    material : str or Mixture
        Name, as `library_name` takes it, or another material.
    energies_kev : array_like, shape (energies,)
        keV.

    Returns
    -------
    ndarray, shape (energies,)
        1/mm; read-only.

    Raises
    ------
    InputError
        For an unknown material.
    """
    return _attenuation(library_name(material), tuple(np.asarray(energies_kev, float).tolist()))


@cache
def _attenuation(material: Material, energies_kev: tuple[float, ...]) -> np.ndarray:
    if isinstance(material, Mixture):
        density, values = material.density_g_per_cm3, [material.mass_attenuation(energy) for energy in energies_kev]
    elif material in COMPOUNDS:
        compound, density = COMPOUNDS[material]
        density = density or xraylib.GetCompoundDataNISTByName(compound)["density"]
        values = [xraylib.CS_Total_CP(compound, energy) for energy in energies_kev]
    elif material in ELEMENTS:
        number, density = ELEMENTS[material]
        values = [xraylib.CS_Total(number, energy) for energy in energies_kev]
    else:
        known = ", ".join([*COMPOUNDS, *ELEMENTS])
        raise InputError(f"material '{material}' is unknown; use one of {known}")
    result = np.array(values) * density / 10
    result.setflags(write=False)
    return result


@cache
def energy_of(material: str, mu_per_mm: float) -> float:
    """Return the energy, keV, at which a material has the given linear attenuation, 1/mm.

    Raises
    ------
    InputError
        If it is not within ENERGIES_KEV.
    """

    def excess(energy):
        return attenuation_per_mm(material, [energy])[0] - mu_per_mm

    low, high = ENERGIES_KEV
    if not excess(low) > 0 > excess(high):
        raise InputError(
            f"{mu_per_mm:g} per mm is not the attenuation of {material} at any energy from {low:g} to {high:g} keV"
        )
    return float(scipy.optimize.brentq(excess, low, high, xtol=1e-6))


@dataclass(frozen=True)
class Segmentation:
    """Decomposition of HU into two materials.

    Attributes
    ----------
    soft : str
        Material of voxels up to dense_from_hu, with a density in proportion to their attenuation.
    dense : str or None
        Material whose volume fraction increases above dense_from_hu, up to 1; None: all voxels are `soft`.
    """

    soft: str = "water"
    dense: str | None = "bone"
    dense_from_hu: float = 150.0

    @property
    def materials(self) -> tuple[str, ...]:
        """Names of the materials."""
        return (self.soft,) if self.dense is None else (self.soft, self.dense)

    def fractions(self, hu: np.ndarray, mu_water_per_mm: float) -> np.ndarray:
        """Return the amount of each material relative to its listed density.

        At the energy at which water has the attenuation mu_water_per_mm, sum of amounts times attenuation is exactly
        the attenuation of the HU. Line integrals at this energy are therefore those of the baseline.

        Returns
        -------
        ndarray of float32, shape (materials, ...)

        Raises
        ------
        InputError
            If the attenuation of the dense material is below dense_from_hu.
        """
        energy = energy_of("water", mu_water_per_mm)
        mu = hu_to_attenuation(np.asarray(hu, np.float32), mu_water_per_mm)
        soft_mu = attenuation_per_mm(self.soft, [energy])[0]
        if self.dense is None:
            return (mu / np.float32(soft_mu))[None]
        dense_mu = attenuation_per_mm(self.dense, [energy])[0]
        limit = (self.dense_from_hu / 1000 + 1) * mu_water_per_mm
        if not dense_mu > limit:
            raise InputError(
                f"materials: {self.dense} attenuates less than {self.dense_from_hu:g} HU; lower dense_from_hu"
            )
        volume_fraction = np.clip((mu - limit) / (dense_mu - limit), 0, 1)
        dense = np.where(mu > dense_mu, mu / dense_mu, volume_fraction)
        soft = (mu - dense * dense_mu) / soft_mu
        return np.stack([soft, dense]).astype(np.float32)
