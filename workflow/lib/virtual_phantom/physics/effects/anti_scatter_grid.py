"""Anti-scatter grid."""

from ..effect import DIVERGENT_BEAM, Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Set the grid."""
    state.anti_scatter_ratio = (values["ratio"], values["ratio_along_rows"])


EFFECT = Effect(
    name="anti_scatter_grid",
    title="anti-scatter grid",
    physics="Septa focused on the focal spot absorb oblique radiation, which reduces scatter and its range. Their "
    "absorption of the primary beam is part of the stated photons.",
    equation="scatter from a distance d on the detector is transmitted by max(0, 1 - r d / L); L: distance from "
    "isocenter to detector",
    source="G. J. Day and D. R. Dance, Phys. Med. Biol. 28, 1429 (1983), for thin, fully absorbing septa; grid ratio: "
    "IEC 60627:2013",
    stage="scatter",  # acts before scatter: effects of one stage are sorted by name
    signature="scatter follows the shadow of the object more closely across the septa than along them",
    settled_by="repeat the scan without the grid, and measure the signal behind a lead disc",
    parameters=(
        Parameter("ratio", "1", "grid ratio r across the columns: septa height over gap", 0.0, 40.0, 5.0, 10.0),
        Parameter(
            "ratio_along_rows", "1", "grid ratio across the rows, for a two-dimensional grid", 0.0, 40.0, 0.0, 0.0
        ),
    ),
    apply=apply,
    needs=(DIVERGENT_BEAM,),
    beside="scatter",
)
