"""Electronic noise of the read-out."""

from ..effect import DARK_NOISE, Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Set the standard deviation of electronic noise."""
    state.electronic = values["photons"]


EFFECT = Effect(
    name="electronic_noise",
    physics="The read-out adds noise that does not depend on the signal.",
    equation="variance(read) = quantum variance + sigma^2, in photons",
    source="B. R. Whiting et al., Med. Phys. 33, 3290 (2006)",
    stage="noise",
    signature="more variance where few photons arrive; the mean stays",
    settled_by="dark scans: their variance is that of the electronics",
    parameters=(Parameter("photons", "photons", "standard deviation", 0.0, 1000.0, 30.0, 30.0, dark=DARK_NOISE),),
    apply=apply,
)
