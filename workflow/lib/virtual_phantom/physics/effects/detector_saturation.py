"""Nonlinear detector response."""

from ..effect import PER_AIR_PHOTON, Effect, Parameter, Reach
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Set the detector response."""
    state.response = (values["exponent"], values["loss_per_photon"])


LOSS, OF_FLUX = "a: relative loss of the reading per photon equivalent", Reach(PER_AIR_PHOTON, 0.0, 0.5, 0.01, 0.05)

EFFECT = Effect(
    name="detector_saturation",
    physics="Readings are not proportional to the signal: they fall short at high signal, or follow a power of it.",
    equation="read ~ N^p / (1 + a N) for N photon equivalents in a pixel, also in the air scan",
    source="roll-off: G. F. Knoll, Radiation Detection and Measurement, 4th ed., Wiley (2010), chapter 4 "
    "(nonparalyzable dead time); power: IEC 62220-1-1:2015 (conversion function)",
    stage="readout",
    signature="line integrals are too low by a constant factor (exponent), or most at low attenuation (loss)",
    settled_by="make air scans at several tube currents and plot readings against mAs",
    parameters=(
        Parameter("loss_per_photon", "1/photons", LOSS, 0.0, 1.0, 0.0, 5e-8, reach=OF_FLUX),
        Parameter("exponent", "1", "p: exponent of the signal", 0.5, 2.0, 1.0, 1.0, 1.0),
    ),
    apply=apply,
)
