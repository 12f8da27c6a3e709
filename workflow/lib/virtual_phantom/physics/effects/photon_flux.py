"""Photon flux: another dose than stated."""

from ..effect import NOMINAL_PHOTONS, Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Scale the number of photons."""
    state.photons = state.photons * values["factor"]


EFFECT = Effect(
    name="photon_flux",
    physics="The tube gives more or fewer photons than stated.",
    equation="I0' = f I0",
    source="Flouris et al., Sci. Rep. (2022): A = 1/I0",
    stage="noise",
    signature="all variances scaled alike; the mean stays. Without stated photons it is aligned, not tested",
    settled_by="the tube's output measured with a dosemeter",
    parameters=(Parameter("factor", "1", "photons over those stated", 0.02, 50.0, 1.0, 0.7, 1.0),),
    apply=apply,
    needs=(NOMINAL_PHOTONS,),
    of_one_scan=True,
)
