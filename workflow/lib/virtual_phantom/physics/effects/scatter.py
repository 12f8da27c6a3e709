"""Scattered radiation."""

import math

import numpy as np

from ...base.geometry import ScanGeometry
from ..effect import OF_PROTOCOL, Effect, Parameter
from ..spread import spread
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Add scattered photons to signal and noise."""
    transmission = state.signal / state.air
    # What leaves the primary beam: most where about 1/e of it is left.
    source = -transmission * np.log(np.clip(transmission, 1e-12, 1)) * state.air
    reach_mm = _through(state.grid, state.geometry)
    if state.noise is state.signal:  # photons that all count alike
        state.signal = state.noise = state.signal + values["amount"] * spread(
            source, state.geometry, values["width_mm"], reach_mm
        )
        return
    noise = np.divide(source * state.noise, state.signal, out=np.zeros_like(source), where=state.signal > 0)
    more = values["amount"] * spread(np.stack([source, noise]), state.geometry, values["width_mm"], reach_mm)
    state.signal, state.noise = state.signal + more[0], state.noise + more[1]


def _through(grid: tuple[float, float], geometry: ScanGeometry) -> tuple[float, float]:
    """How far from where it comes scatter of the object's middle arrives behind a grid, along columns and rows, mm."""
    away_mm = geometry.source_to_detector_mm - geometry.source_to_isocentre_mm
    return tuple(away_mm / ratio if ratio else math.inf for ratio in grid)


EFFECT = Effect(
    name="scatter",
    physics="Photons scattered in the object reach the detector from other directions and add a smooth haze.",
    equation="S' = S + a G_w * (S ln(S_air / S)), G_w a Gaussian of SD w on the detector",
    source="M. Sun and J. Star-Lack, Phys. Med. Biol. 55, 6695 (2010), with one kernel",
    stage="scatter",
    signature="line integrals too low, most behind the thickest parts; smooth on the detector",
    settled_by="the same scan with the beam collimated to a few rows: scatter falls with the beam's height",
    parameters=(
        Parameter(
            "amount",
            "1",
            "scattered share of what the primary beam loses",
            0.0,
            0.6,
            0.03,
            0.05,
            belongs_to=OF_PROTOCOL,  # of its collimation, and of the energies
        ),
        Parameter("width_mm", "mm", "width of the kernel at the detector", 10.0, 200.0, 60.0, 60.0, None, kernel=True),
    ),
    apply=apply,
    removed_by=("scatter",),
)
