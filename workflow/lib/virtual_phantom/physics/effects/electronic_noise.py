"""Electronic noise of the readout."""

from ..effect import DARK_NOISE, NOISE_LEVEL, Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Set the standard deviation of the electronic noise."""
    state.electronic = values["photons"]


EFFECT = Effect(
    name="electronic_noise",
    physics="The readout adds noise that does not depend on the signal.",
    equation="variance(read) = quantum variance + sigma^2, in photons",
    source="B. R. Whiting et al., Med. Phys. 33, 3290 (2006)",
    stage="noise",
    signature="the variance is too high at low counts and the mean does not change",
    settled_by="make dark scans: their variance is the electronic noise",
    parameters=(Parameter("photons", "photons", "standard deviation sigma", 0.0, 1000.0, 30.0, 30.0, dark=DARK_NOISE),),
    needs=(NOISE_LEVEL,),
    apply=apply,
)
