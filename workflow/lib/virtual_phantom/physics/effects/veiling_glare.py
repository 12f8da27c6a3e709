"""Veiling glare: light that spreads far within the detector."""

import math

from ..effect import PER_PIXEL, Effect, Parameter, Reach
from ..spread import long_tailed_spread
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Spread part of the signal, also in the air scan."""
    share = values["share"]

    def veiled(signal):
        spread = long_tailed_spread(signal, state.geometry, values["width_mm"], values["beyond"])
        return (1 - share) * signal + share * spread

    # Light that spreads over thousands of pixels adds no noise to a single one.
    state.noise = (1 - share) ** 2 * state.noise
    state.signal, state.air = veiled(state.signal), veiled(state.air)


WIDTH = "SD w of the spread along each axis"
BEYOND_NEIGHBORS = Reach(PER_PIXEL, 2.0, math.inf)  # A narrower spread is crosstalk.
BEYOND = "signal b beyond the detector, relative to that at its edges"

EFFECT = Effect(
    name="veiling_glare",
    physics="Light and fluorescence spread far within the detector, so every pixel shows a little of its wide "
    "surroundings.",
    equation="S' = (1 - g) S + g K_w * S, also in the air scan; K_w = exp(-r/w) / (2 pi w r), as a sum of Gaussians. "
    "Beyond the detector, S is b times its value at the edge. The variance is multiplied by (1 - g)^2",
    source="J. A. Seibert, O. Nalcioglu and W. W. Roeck, Med. Phys. 11, 172 (1984)",
    stage="crosstalk",
    signature="line integrals are too low behind the object and above 0 next to it; the white field falls off at the "
    "edges",
    settled_by="scan a lead disc: the signal behind it grows with the open field around it",
    parameters=(
        Parameter("share", "1", "share g of the signal that spreads", 0.0, 0.3, 0.02, 0.03),
        Parameter("width_mm", "mm", WIDTH, 5.0, 200.0, 40.0, 40.0, None, reach=BEYOND_NEIGHBORS, kernel=True),
        Parameter("beyond", "1", BEYOND, 0.0, 1.0, 0.5, 0.0, None, fraction=True),
    ),
    apply=apply,
)
