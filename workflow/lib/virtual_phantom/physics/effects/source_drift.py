"""Drift of the source during the scan."""

from ..displacement import PATH, moved_mm, parameters
from ..effect import DIVERGENT_BEAM, Effect
from ..state import State

FASTEST = 20.0  # mm/s
FARTHEST_MM = 5.0  # over the scan, as for focal_spot_wobble
DIRECTIONS = {"columns": "along the columns", "rows": "along the rows", "away": "away from the detector"}


def apply(state: State, values: dict[str, float]) -> None:
    """Move the source from view to view about the middle of the scan, with a fixed detector."""
    moved = moved_mm(state.geometry, values, DIRECTIONS)
    state.jump_mm = moved if state.jump_mm is None else state.jump_mm + moved


EFFECT = Effect(
    name="source_drift",
    physics="The focal spot drifts while the tube warms up, at a velocity that may change uniformly. The detector does "
    "not move.",
    equation=f"source_i' = source_i + {PATH}; v and a along columns, rows and away from the detector",
    source="M. Ferrucci et al., Meas. Sci. Technol. 26, 092003 (2015)",
    stage="focal_spot",
    signature="shadows shift from the first view to the last, more for parts near the source; with a drift away from "
    "the detector, they shrink",
    settled_by="repeat the first view at the end of the scan with one part near the source and one near the detector: "
    "a moving object shifts both equally",
    parameters=parameters(DIRECTIONS, FASTEST, FARTHEST_MM, typical_mm=0.5),
    apply=apply,
    needs=(DIVERGENT_BEAM,),
)
