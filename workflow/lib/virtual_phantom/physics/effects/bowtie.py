"""Bowtie filter."""

import numpy as np

from ...base.geometry import orbit_of
from ..effect import DIVERGENT_BEAM, OF_PROTOCOL, Effect, Parameter
from ..state import State

REFERENCE_DEG = 20.0  # fan angle at which the thickness is stated; inside the fan of every body scanner


def apply(state: State, values: dict[str, float]) -> None:
    """Add the filter, which is thicker toward the outer columns."""
    geometry = orbit_of(state.geometry, "bowtie")
    fan_deg = np.abs(np.rad2deg(geometry.fan_angles_rad()))
    exponent, width_deg = values["exponent"], values["levels_off_deg"]
    thickness = values["at_20deg_mm"] * _profile(fan_deg / REFERENCE_DEG, exponent, width_deg / REFERENCE_DEG)
    state.filters = (*state.filters, ("aluminium", thickness[None, :]))


def _profile(fan: np.ndarray, exponent: float, width: float) -> np.ndarray:
    """Return the thickness relative to the reference angle; fan and width are in units of that angle."""
    if not width:
        return fan**exponent
    return np.expm1(-((fan / width) ** exponent)) / np.expm1(-(width**-exponent))


THICKNESS = {"belongs_to": OF_PROTOCOL, "title": "thickness at 20 degrees"}  # scanners have several bowties

EFFECT = Effect(
    name="bowtie",
    physics="A shaped filter attenuates the beam toward its edges and, with a spectrum, hardens it there.",
    equation="fluence(g, E) = exp(-mu_Al(E) t f(g) / f(20 deg)) at the fan angle g; f = |g|^n, or 1 - exp(-(|g| / "
    "w)^n) for a profile that levels off at w. The central thickness is part of the spectrum filtration",
    source="J. Hsieh, Computed Tomography, 3rd ed., SPIE (2015), bowtie filters. XCIST's filters (M. Wu et al., Phys. "
    "Med. Biol. 67, 194002, 2022) are reproduced within 1.1 mm by t, n and w: large 31.8 mm, 3.54, 14.9 deg; medium "
    "32.7 mm, 3.27, 13.0 deg; small 32.7 mm, 2.82, 10.8 deg. Their centers are 2.6, 0.9 and 1.1 mm thick",
    stage="fluence",
    signature="the white field decreases and noise increases toward both edges; with a spectrum, line integrals are "
    "too low behind the outer columns",
    settled_by="measure the white field, or an air scan without the filter",
    parameters=(
        Parameter(
            "at_20deg_mm", "mm Al", "thickness t at a fan angle of 20 degrees", 0.0, 100.0, 10.0, 30.0, **THICKNESS
        ),
        Parameter("exponent", "1", "n: exponent of the fan angle", 1.0, 6.0, 2.0, 2.0, None, stated=True),
        Parameter(
            "levels_off_deg", "degrees", "w: angle of leveling off; 0: none", 0.0, 60.0, 0.0, 0.0, None, stated=True
        ),
    ),
    apply=apply,
    needs=(DIVERGENT_BEAM,),
)
