"""Polychromatic spectrum: beam hardening."""

from ..beam.spectra import weighted_spectrum
from ..effect import LOGARITHM, OF_PROTOCOL, SENSOR_THICKNESS, TUBE_VOLTAGE, Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Set the spectrum."""
    state.spectrum = weighted_spectrum(
        values["kvp"], values["filtration_mm"], state.anode, state.sensor, values["sensor_mm"]
    )


VOLTAGE = {"belongs_to": OF_PROTOCOL, "nominal": TUBE_VOLTAGE, "title": "tube voltage"}
SENSOR = {"nominal": SENSOR_THICKNESS, "title": "sensor thickness"}

EFFECT = Effect(
    name="spectrum",
    physics="The beam has many energies, and low energies are absorbed first. Attenuation per mm therefore falls with "
    "depth.",
    equation="T = sum_E s(E) exp(-sum_m mu_m(E) l_m); variance of the signal: sum_E q(E) exp(-sum_m mu_m(E) l_m) / "
    "I0; s and q: shares of the photon deposits and of their squares",
    source="R. A. Brooks and G. Di Chiro, Phys. Med. Biol. 21, 390 (1976); noise: B. R. Whiting et al., Med. Phys. 33, "
    "3290 (2006); spectra: G. Poludniowski et al., Med. Phys. 48, 3630 (2021); deposits: R. K. Swank, J. Appl. Phys. "
    "44, 4199 (1973)",
    stage="spectrum",
    signature="line integrals fall below proportionality with path length, equally everywhere, and more behind bone",
    settled_by="scan the object behind a plate of aluminum or copper: hardening shrinks, scatter grows",
    parameters=(
        Parameter("kvp", "kV", "tube voltage", 30.0, 150.0, 110.0, 120.0, None, **VOLTAGE),
        Parameter(
            "filtration_mm", "mm Al", "filtration, as aluminum", 0.2, 40.0, 6.0, 6.0, None, belongs_to=OF_PROTOCOL
        ),
        Parameter(
            "sensor_mm", "mm", "thickness of the detector sensor", 0.01, 100.0, 0.6, 0.6, None, LOGARITHM, **SENSOR
        ),
    ),
    apply=apply,
    removed_by=("beam_hardening",),
    absolute_attenuation=True,
    if_absent="The stated tube voltage is {tube_kvp:g} kV, but the data show no beam hardening: they may have been "
    "corrected for it already.",
)
