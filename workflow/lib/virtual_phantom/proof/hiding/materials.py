"""Materials of the scanned objects: elements, mass fractions and densities, for both simulators and the diagnosis."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

NUMBERS = {"H": 1, "C": 6, "N": 7, "O": 8, "F": 9, "Na": 11, "Mg": 12, "Al": 13, "P": 15, "S": 16, "Ca": 20, "Zn": 30}
# Attenuation of a material per mm at the energy of the monochromatic beam.
Attenuation = Callable[[str], float]


@dataclass(frozen=True)
class Material:
    """A material.

    Attributes
    ----------
    density : float
        g/cm3.
    fractions : dict of str to float
        Mass fraction by symbol of the element, with a sum of 1.
    """

    density: float
    fractions: Mapping[str, float]

    def stated(self) -> dict:
        """Return the material as a description of an object states it."""
        return {"mass_fractions": dict(self.fractions), "density_g_per_cm3": self.density}


# Nominal formulas and densities of manufacturers and NIST; cortical bone of ICRP.
MATERIALS = {
    "water": Material(1.0, {"H": 0.111894, "O": 0.888106}),
    "pmma": Material(1.19, {"H": 0.080538, "C": 0.599848, "O": 0.319614}),
    "polyethylene": Material(0.94, {"H": 0.143711, "C": 0.856289}),
    "polystyrene": Material(1.05, {"H": 0.077418, "C": 0.922582}),
    "delrin": Material(1.42, {"H": 0.067135, "C": 0.400017, "O": 0.532848}),
    "teflon": Material(2.16, {"C": 0.240183, "F": 0.759817}),
    "aluminium": Material(2.699, {"Al": 1.0}),
    "bone": Material(
        1.85,
        {
            **{"H": 0.047234, "C": 0.14433, "N": 0.04199, "O": 0.446096, "Mg": 0.0022, "P": 0.10497},
            **{"S": 0.00315, "Ca": 0.20993, "Zn": 0.0001},
        },
    ),
}
IN_LIBRARY = ("water", "pmma", "polyethylene", "aluminium", "bone")  # materials that the library has by this name
SOFT, DENSE, DENSE_FROM_HU = "water", "bone", 150.0  # tissues are water of another density, from here on with bone


def mixed(amounts: Mapping[str, float]) -> Material:
    """Return a mixture of MATERIALS; `amounts` are volume fractions times relative densities."""
    masses: dict[str, float] = {}
    for name, amount in amounts.items():
        for symbol, share in MATERIALS[name].fractions.items():
            masses[symbol] = masses.get(symbol, 0.0) + amount * MATERIALS[name].density * share
    density = sum(masses.values())
    return Material(density, {symbol: mass / density for symbol, mass in masses.items()})


def mixture(mu, start: float, soft: float, dense: float):
    """Return the volume fractions of two materials with attenuation mu: the dense one begins at `start`."""
    amount = np.clip(mu - start, 0, None) / (dense - start)
    return (mu - amount * dense) / soft, amount


def tissue(hu: float, attenuation: Attenuation, mu_water_per_mm: float) -> dict[str, float]:
    """Return the volume fractions of SOFT and DENSE that attenuate as a CT number in HU says."""
    mu, start = (mu_water_per_mm * (1 + value / 1000) for value in (hu, DENSE_FROM_HU))
    amounts = mixture(mu, start, attenuation(SOFT), attenuation(DENSE))
    return {name: float(amount) for name, amount in zip((SOFT, DENSE), amounts, strict=True) if amount > 0}
