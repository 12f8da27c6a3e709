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
    # Loss of the primary beam, largest at a transmission of 1/e.
    source = -transmission * np.log(np.clip(transmission, 1e-12, 1)) * state.air
    reach_mm = _through(state.grid, state.geometry)
    if state.noise is state.signal:  # all photons count equally
        state.signal = state.noise = state.signal + values["amount"] * spread(
            source, state.geometry, values["width_mm"], reach_mm
        )
        return
    noise = np.divide(source * state.noise, state.signal, out=np.zeros_like(source), where=state.signal > 0)
    more = values["amount"] * spread(np.stack([source, noise]), state.geometry, values["width_mm"], reach_mm)
    state.signal, state.noise = state.signal + more[0], state.noise + more[1]


def _through(grid: tuple[float, float], geometry: ScanGeometry) -> tuple[float, float]:
    """Return the reach behind a grid of scatter from the object center, along columns and rows, mm."""
    away_mm = geometry.source_to_detector_mm - geometry.source_to_isocentre_mm
    return tuple(away_mm / ratio if ratio else math.inf for ratio in grid)


AMOUNT = "a: scattered share of the loss of the primary beam"

EFFECT = Effect(
    name="scatter",
    physics="Photons scattered in the object reach the detector from other directions and add a smooth background.",
    equation="S' = S + a G_w * (S ln(S_air / S)), G_w: Gaussian of SD w on the detector",
    source="M. Sun and J. Star-Lack, Phys. Med. Biol. 55, 6695 (2010), with one kernel",
    stage="scatter",
    signature="line integrals are too low, most behind the thickest parts, and smooth over the detector",
    settled_by="repeat the scan with the beam collimated to a few rows: scatter falls with the beam height",
    parameters=(
        # The amount depends on collimation and energy.
        Parameter("amount", "1", AMOUNT, 0.0, 0.6, 0.03, 0.05, belongs_to=OF_PROTOCOL),
        Parameter(
            "width_mm", "mm", "width w of the kernel at the detector", 10.0, 200.0, 60.0, 60.0, None, kernel=True
        ),
    ),
    apply=apply,
    removed_by=("scatter",),
)
