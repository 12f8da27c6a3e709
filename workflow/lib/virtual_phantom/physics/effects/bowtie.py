"""Bowtie filter."""

import numpy as np

from ..chain import State
from ..effect import Effect, Parameter
from ..materials import attenuation_per_mm

ENERGY_KEV = 60.0  # at which the filter's attenuation is taken where no spectrum is switched on


def apply(state: State, values: dict[str, float]) -> None:
    position = state.geometry.column_positions_mm()
    thickness = values["edge_mm"] * (position / np.abs(position).max()) ** 2
    energies = [ENERGY_KEV] if state.spectrum is None else state.spectrum[0]
    shares = [1.0] if state.spectrum is None else state.spectrum[1]
    mu = attenuation_per_mm("aluminium", np.asarray(energies))
    profile = (np.exp(-np.outer(thickness, mu)) * shares).sum(axis=1)
    state.fluence = state.fluence * profile[None, None, :]


EFFECT = Effect(
    name="bowtie",
    physics="A shaped filter thins the beam towards its edges.",
    equation="fluence(u) = exp(-mu_Al t (u / u_max)^2)",
    source="J. Hsieh, Computed Tomography, 3rd ed., SPIE (2015), section on bowtie filters; parabolic profile",
    stage="fluence",
    signature="white field falls to both edges, and noise grows there; the mean of the line integrals stays",
    settled_by="the white field, or an air scan without the filter",
    parameters=(Parameter("edge_mm", "mm Al", "thickness at the detector's edge", 0.0, 60.0, 5.0, 15.0),),
    apply=apply,
)
