"""Drift of the source during the scan."""

from ..effect import DIVERGENT_BEAM, PER_SCAN, Effect, Parameter, Reach
from ..slowing import POSITION, SLOWING, constant_velocity_times
from ..state import State

FASTEST = 20.0  # mm/s
FARTHEST_MM = 5.0  # over the scan, as for focal_spot_wobble


def _reach(typical_mm: float) -> Reach:
    return Reach(PER_SCAN, -FARTHEST_MM, FARTHEST_MM, 0.0, typical_mm)


def apply(state: State, values: dict[str, float]) -> None:
    """Move the source from view to view about the middle of the scan, with a fixed detector."""
    velocity = [values[f"{axis}_mm_per_s"] for axis in ("columns", "rows", "away")]
    moved = constant_velocity_times(state.geometry.times_s, values["slowing"])[:, None] * velocity
    state.jump_mm = moved if state.jump_mm is None else state.jump_mm + moved


EFFECT = Effect(
    name="source_drift",
    physics="The focal spot drifts along a line while the tube warms up, at a velocity that may change uniformly. The "
    "detector does not move.",
    equation=f"source_i' = source_i + {POSITION}; v along columns, rows and away from the detector, t_i = "
    "(i + 1/2 - N/2) dt from the middle of the scan",
    source="M. Ferrucci et al., Meas. Sci. Technol. 26, 092003 (2015)",
    stage="focal_spot",
    signature="shadows shift from the first view to the last, more for parts near the source; with a drift away from "
    "the detector, they shrink",
    settled_by="repeat the first view at the end of the scan with one part near the source and one near the detector: "
    "a moving object shifts both equally",
    parameters=(
        Parameter(
            "columns_mm_per_s", "mm/s", "velocity along the columns", -FASTEST, FASTEST, 0.0, 0.5, reach=_reach(0.5)
        ),
        Parameter("rows_mm_per_s", "mm/s", "velocity along the rows", -FASTEST, FASTEST, 0.0, 0.0, reach=_reach(0.0)),
        Parameter(
            "away_mm_per_s", "mm/s", "velocity away from the detector", -FASTEST, FASTEST, 0.0, 0.0, reach=_reach(0.0)
        ),
        SLOWING,
    ),
    apply=apply,
    needs=(DIVERGENT_BEAM,),
)
