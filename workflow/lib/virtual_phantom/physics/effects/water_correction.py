"""Water beam-hardening correction by the manufacturer."""

from ..effect import Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Set the polynomial of the manufacturer's correction."""
    state.correction = (values["quadratic"], values["cubic"])


EFFECT = Effect(
    name="water_correction",
    physics="Line integrals are passed through a polynomial before storage that linearizes water. Beam "
    "hardening by bone and metal remains, and also by water if the polynomial does not match the beam.",
    equation="p' = p + a p^2 + b p^3, linear from p = 10 on; noise is multiplied by the slope",
    source="G. T. Herman, Phys. Med. Biol. 24, 81 (1979); residual artifacts: P. M. Joseph and R. D. Spital, J. "
    "Comput. Assist. Tomogr. 2, 100 (1978)",
    stage="readout",
    signature="line integrals rise above proportionality with path length, equally behind all materials; noise grows "
    "with the slope",
    settled_by="scan a step wedge or water phantoms of several diameters and plot line integrals against path lengths",
    parameters=(
        Parameter("quadratic", "1", "a: quadratic coefficient", -0.03, 0.1, 0.02, 0.02),
        Parameter("cubic", "1", "b: cubic coefficient", -0.001, 0.005, 0.0, 0.0),
    ),
    apply=apply,
    correction="beam_hardening",
)
