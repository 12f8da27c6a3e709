"""Bowtie filter."""

import numpy as np

from ...base.geometry import orbit_of
from ..effect import OF_PROTOCOL, Effect, Parameter
from ..state import State

REFERENCE_DEG = 20.0  # fan angle at which the thickness is stated: inside every body scanner's fan


def apply(state: State, values: dict[str, float]) -> None:
    """Add the filter, thicker from column to column."""
    geometry = orbit_of(state.geometry, "bowtie")
    fan_deg = np.abs(np.rad2deg(geometry.fan_angles_rad()))
    exponent, width_deg = values["exponent"], values["levels_off_deg"]
    thickness = values["at_20deg_mm"] * _profile(fan_deg / REFERENCE_DEG, exponent, width_deg / REFERENCE_DEG)
    state.filters = (*state.filters, ("aluminium", thickness[None, :]))


def _profile(fan: np.ndarray, exponent: float, width: float) -> np.ndarray:
    """Thickness over that at the reference, of fan angles over the reference's."""
    if not width:
        return fan**exponent
    return np.expm1(-((fan / width) ** exponent)) / np.expm1(-(width**-exponent))


EFFECT = Effect(
    name="bowtie",
    physics="A shaped filter thins the beam towards its edges, and hardens it there beside a spectrum.",
    equation="fluence(g, E) = exp(-mu_Al(E) t f(g) / f(20 deg)) at the fan angle g; f = |g|^n, or 1 - exp(-(|g| / w)^n)"
    " where it levels off at w; what the middle has belongs to the spectrum's filtration",
    source="J. Hsieh, Computed Tomography, 3rd ed., SPIE (2015), bowtie filters. Of XCIST's (M. Wu et al., Phys. Med. "
    "Biol. 67, 194002, 2022), t, n and w within 1.1 mm: large 31.8 mm, 3.54, 14.9 deg; medium 32.7, 3.27, 13.0; small "
    "32.7, 2.82, 10.8. Their middles have 2.6, 0.9 and 1.1 mm more",
    stage="fluence",
    signature="white field falls to both edges, and noise grows there; with a spectrum, line integrals fall behind "
    "the outer columns",
    settled_by="the white field, or an air scan without the filter",
    parameters=(
        Parameter(
            "at_20deg_mm",
            "mm Al",
            "thickness at a fan angle of 20 degrees",
            0.0,
            100.0,
            10.0,
            30.0,
            belongs_to=OF_PROTOCOL,  # scanners have several bowties
            title="thickness at 20 degrees",
        ),
        Parameter("exponent", "1", "n: power of the angle by which it grows", 1.0, 6.0, 2.0, 2.0, None, stated=True),
        Parameter("levels_off_deg", "degrees", "w; 0: it grows on and on", 0.0, 60.0, 0.0, 0.0, None, stated=True),
    ),
    apply=apply,
)
