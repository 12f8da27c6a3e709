"""Crescent: shading on one side, as of a displaced bowtie or flat field."""

import numpy as np

from ..effect import LOGARITHM, Effect, Parameter
from ..image_state import ImageState

POWER = 4  # of the rise from the isocenter; the crescent is about a third of its radius wide


def apply(state: ImageState, values: dict[str, float]) -> None:
    """Add the shading."""
    y, x = state.y_mm[:, None] / values["radius_mm"], state.x_mm / values["radius_mm"]
    square = x**2 + y**2
    profile = square ** ((POWER - 1) / 2) * np.exp(POWER / 2 * (1 - square))
    state.hu = state.hu + (profile * (values["x_hu"] * x + values["y_hu"] * y)).astype(state.hu.dtype)


EFFECT = Effect(
    name="crescent",
    physics="Bowtie filter or flat field are displaced against the air scan, by an amount that changes with the gantry "
    "angle. One side is brighter and the opposite side darker.",
    equation="HU' = HU + (a cos phi + b sin phi) q^4 exp(2 - 2 q^2) with q = r / R, about the isocenter",
    source="W. Giles et al., Med. Phys. 38, 2116 (2011), crescents of cone-beam CT; here one harmonic of the angle",
    stage="image",
    signature="HU change as a cosine of the angle about the isocenter, at one distance",
    settled_by="repeat the air scan, or scan a water phantom turned by 180 degrees",
    parameters=(
        Parameter("x_hu", "HU", "a: change on the side of positive x", -200.0, 200.0, 0.0, 10.0),
        Parameter("y_hu", "HU", "b: change on the side of positive y", -200.0, 200.0, 0.0, 10.0),
        Parameter("radius_mm", "mm", "R: distance of the crescent", 10.0, 300.0, 80.0, 80.0, None, LOGARITHM),
    ),
    apply=apply,
    rank=-1,
)
