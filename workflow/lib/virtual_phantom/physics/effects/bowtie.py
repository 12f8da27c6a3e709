"""Bowtie filter."""

import numpy as np

from ...base.geometry import orbit_of
from ..effect import Effect, Parameter
from ..state import State

REFERENCE_DEG = 20.0  # fan angle at which the thickness is stated: inside every body scanner's fan


def apply(state: State, values: dict[str, float]) -> None:
    """Add the filter, thicker from column to column."""
    geometry = orbit_of(state.geometry, "bowtie")
    fan_deg = np.rad2deg(geometry.fan_angles_rad())
    thickness = values["at_20deg_mm"] * (fan_deg / REFERENCE_DEG) ** 2
    state.filters = (*state.filters, ("aluminium", thickness[None, :]))


EFFECT = Effect(
    name="bowtie",
    physics="A shaped filter thins the beam towards its edges, and hardens it there beside a spectrum.",
    equation="fluence(u, E) = exp(-mu_Al(E) t (g / 20 deg)^2), tan g = u / D",
    source="J. Hsieh, Computed Tomography, 3rd ed., SPIE (2015), bowtie filters; parabolic profile. XCIST's "
    "three (M. Wu et al., Phys. Med. Biol. 67, 194002, 2022) have 33 to 34 mm at 20 deg",
    stage="fluence",
    signature="white field falls to both edges, and noise grows there; with a spectrum, line integrals fall behind "
    "the outer columns",
    settled_by="the white field, or an air scan without the filter",
    parameters=(Parameter("at_20deg_mm", "mm Al", "thickness at a fan angle of 20 degrees", 0.0, 100.0, 10.0, 30.0),),
    apply=apply,
)
