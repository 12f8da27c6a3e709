"""The maker's correction for beam hardening in water."""

from ..effect import Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Set the polynomial."""
    state.correction = (values["quadratic"], values["cubic"])


EFFECT = Effect(
    name="water_correction",
    physics="Before they are stored, line integrals are put through a polynomial that straightens those of water. It "
    "leaves the hardening of bone and metal, and of water what it does not meet.",
    equation="p' = p + a p^2 + b p^3, from p = 10 on a straight line; noise by its slope",
    source="G. T. Herman, Phys. Med. Biol. 24, 81 (1979); what it leaves: P. M. Joseph and R. D. Spital, J. Comput. "
    "Assist. Tomogr. 2, 100 (1978)",
    stage="readout",
    signature="line integrals bend up with path length, alike behind all materials; noise grows with the slope",
    settled_by="a step wedge or water phantoms of several diameters: line integrals over path lengths",
    parameters=(
        Parameter("quadratic", "1", "a", -0.03, 0.1, 0.02, 0.02),
        Parameter("cubic", "1", "b", -0.001, 0.005, 0.0, 0.0),
    ),
    apply=apply,
    correction="beam_hardening",
)
