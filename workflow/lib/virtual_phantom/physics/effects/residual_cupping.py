"""Cupping that a water beam-hardening correction leaves.

Effect `water_correction` is the polynomial of recorded line integrals. This one acts on images, whose line integrals
are not known. Only the error of the polynomial is visible. For round objects it depends on the distance alone.
"""

from ..effect import Effect, Parameter
from ..image_state import ImageState

UNIT_MM = 100.0  # distance from the isocenter at which the parameters are the change of water


def apply(state: ImageState, values: dict[str, float]) -> None:
    """Change the attenuation by a polynomial of the distance from the isocenter."""
    square = (state.radius_mm / UNIT_MM) ** 2
    change = values["quadratic_hu"] * square + values["quartic_hu"] * square**2
    state.hu = state.hu + (1 + state.hu / 1000) * change.astype(state.hu.dtype)


EFFECT = Effect(
    name="residual_cupping",
    physics="The manufacturer's water correction does not match the beam, so a water phantom is brighter or darker at "
    "the edge than in the center.",
    equation="HU' = HU + (1 + HU / 1000) (a r^2 + b r^4), r the distance from the isocenter in units of 100 mm",
    source="G. T. Herman, Phys. Med. Biol. 24, 81 (1979). In a disc of radius R, an error e p^3 of line integrals p "
    "gives 6 e mu^3 (R^2 - r^2)",
    stage="image",
    signature="HU change smoothly with the distance from the isocenter, in proportion to the density",
    settled_by="scan a centered water phantom",
    parameters=(
        Parameter("quadratic_hu", "HU", "a: change of water at 100 mm; positive: cupping", -100.0, 100.0, 0.0, 5.0),
        Parameter("quartic_hu", "HU", "b: further change at 100 mm", -50.0, 50.0, 0.0, 0.0),
    ),
    apply=apply,
    rank=-1,
)
