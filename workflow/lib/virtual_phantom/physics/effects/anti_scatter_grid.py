"""Anti-scatter grid."""

from ..effect import Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Set the grid."""
    state.grid = (values["ratio"], values["ratio_along_rows"])


EFFECT = Effect(
    name="anti_scatter_grid",
    title="anti-scatter grid",
    physics="Septa that point at the focal spot stop what comes from the side: there is less scatter, and it comes "
    "from nearer. What they stop of the beam itself is in the photons already.",
    equation="scatter from a place d beside, on the detector, arrives with the share max(0, 1 - r d / L); L: from the "
    "isocentre to the detector",
    source="G. J. Day and D. R. Dance, Phys. Med. Biol. 28, 1429 (1983), thin septa that absorb all; grid ratio: IEC "
    "60627:2013",
    stage="scatter",  # before the scatter, by its name
    signature="scatter follows the object's shadow more closely across the septa than along them",
    settled_by="the same scan without the grid, and a lead disc in the beam: the signal behind it",
    parameters=(
        Parameter("ratio", "1", "height of the septa over their gap, across the columns", 0.0, 40.0, 5.0, 10.0),
        Parameter(
            "ratio_along_rows", "1", "the same across the rows, of a grid in two dimensions", 0.0, 40.0, 0.0, 0.0
        ),
    ),
    apply=apply,
    beside="scatter",
)
