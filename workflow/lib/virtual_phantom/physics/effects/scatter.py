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
    # Source of scatter: the primary signal times its line integral, -T ln T, largest at a transmission T of 1/e.
    scatter_source = -transmission * np.log(np.clip(transmission, 1e-12, 1)) * state.air
    reach_mm = _grid_reach_mm(state.anti_scatter_ratio, state.geometry)
    # If all photons have the same weight, the quantum variance equals the signal, and both are the same array.
    if state.noise is state.signal:
        state.signal = state.noise = state.signal + values["amount"] * spread(
            scatter_source, state.geometry, values["width_mm"], reach_mm
        )
        return
    noise_source = np.divide(
        scatter_source * state.noise, state.signal, out=np.zeros_like(scatter_source), where=state.signal > 0
    )
    sources = np.stack([scatter_source, noise_source])
    scatter_signal, scatter_noise = values["amount"] * spread(sources, state.geometry, values["width_mm"], reach_mm)
    state.signal, state.noise = state.signal + scatter_signal, state.noise + scatter_noise


def _grid_reach_mm(anti_scatter_ratio: tuple[float, float], geometry: ScanGeometry) -> tuple[float, float]:
    """Return the distance on the detector beyond which an anti-scatter grid stops scatter from the isocenter.

    Along columns and rows, mm; infinite without a grid.
    """
    isocentre_to_detector_mm = geometry.source_to_detector_mm - geometry.source_to_isocentre_mm
    return tuple(isocentre_to_detector_mm / ratio if ratio else math.inf for ratio in anti_scatter_ratio)


AMOUNT = "a: scattered signal as a share of the primary signal times its line integral"

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
