"""Response of the detector: readings that are not proportional to the signal."""

from ..effect import PER_AIR_PHOTON, Effect, Parameter, Reach
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Set the detector's response."""
    state.response = (values["exponent"], values["loss_per_photon"])


EFFECT = Effect(
    name="detector_saturation",
    physics="Readings are not proportional to the signal: they fall behind where much arrives, or go by a power of it.",
    equation="read ~ N^p / (1 + a N) of the N photons that a pixel counts for, in the air scan too",
    source="roll-off: G. F. Knoll, Radiation Detection and Measurement, 4th ed., Wiley (2010), chapter 4 (dead "
    "time without paralysis); power: IEC 62220-1-1:2015 (conversion function)",
    stage="readout",
    signature="line integrals too low by the same share everywhere (exponent), or most where little is absorbed (loss)",
    settled_by="air scans at several tube currents: their readings over the mAs",
    parameters=(
        Parameter(
            "loss_per_photon",
            "1/photons",
            "share of the reading that is lost, per photon that the pixel counts for",
            0.0,
            1.0,
            0.0,
            5e-8,
            reach=Reach(PER_AIR_PHOTON, 0.0, 0.5, 0.01, 0.05),
        ),
        Parameter("exponent", "1", "power of the signal that is read", 0.5, 2.0, 1.0, 1.0, 1.0),
    ),
    apply=apply,
)
