"""Polychromatic spectrum: beam hardening."""

from ..chain import State
from ..effect import Effect, Parameter
from ..spectra import weighted_spectrum


def apply(state: State, values: dict[str, float]) -> None:
    state.spectrum = weighted_spectrum(values["kvp"], values["filtration_mm"], state.anode)


EFFECT = Effect(
    name="spectrum",
    physics="The beam holds many energies; soft ones are absorbed first, so attenuation per mm falls with depth (beam "
    "hardening).",
    equation="T = sum_E s(E) exp(-sum_m mu_m(E) l_m), s(E) the share of the detector's signal in air",
    source="R. A. Brooks and G. Di Chiro, Phys. Med. Biol. 21, 390 (1976); spectra: G. Poludniowski et al., Med. "
    "Phys. 48, 3630 (2021)",
    stage="spectrum",
    signature="line integrals bend down with path length, alike in all views, columns and rows; more so behind bone",
    settled_by="the same object behind a plate of aluminium or copper: hardening shrinks, scatter grows",
    parameters=(
        Parameter("kvp", "kV", "tube voltage", 30.0, 150.0, 110.0, 120.0, None),
        Parameter("filtration_mm", "mm Al", "filtration, as aluminium", 0.2, 40.0, 6.0, 6.0, None),
    ),
    apply=apply,
)
