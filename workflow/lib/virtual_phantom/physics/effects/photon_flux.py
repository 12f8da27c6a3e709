"""Photon flux that differs from the stated one."""

from ..effect import Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Scale the number of photons."""
    state.photons = state.photons * values["factor"]


EFFECT = Effect(
    name="photon_flux",
    physics="The tube emits more or fewer photons than stated.",
    equation="I0' = f I0",
    source="Flouris et al., Sci. Rep. (2022): A = 1/I0",
    stage="noise",
    signature="all variances are scaled equally and the mean does not change. Without stated photons, the flux is a "
    "nuisance parameter and is not tested",
    settled_by="measure the tube output with a dosimeter",
    parameters=(Parameter("factor", "1", "f: photons relative to the stated number", 0.02, 50.0, 1.0, 0.7, 1.0),),
    apply=apply,
)
