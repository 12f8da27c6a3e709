"""Unreported focal spot jump between views."""

import math

import numpy as np

from ..effect import DIVERGENT_BEAM, SUCCESSIVE_VIEWS, Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Add the source displacement of every view."""
    times = state.geometry.view_times
    odd = np.round(times - times[0]).astype(int) % 2  # parity of the scanner's views, also if only some are used
    side = np.where(odd, 0.5, -0.5)
    along = values["rows_mm"]
    # The spot moves along the anode's inclined surface.
    place = [values["columns_mm"], along, -along / math.tan(math.radians(state.anode.angle_deg))]
    moved = side[:, None] * place
    state.jump_mm = moved if state.jump_mm is None else state.jump_mm + moved


EFFECT = Effect(
    name="focal_spot_wobble",
    physics="The focal spot alternates between two positions from view to view, which the geometry does not state.",
    equation="source_i' = source_i + (-1)^(i+1) j / 2 for view i from 0; j along the columns, or along z on the "
    "inclined anode surface",
    source="M. Kachelriess et al., IEEE Trans. Nucl. Sci. 53, 1238 (2006); T. G. Flohr et al., Med. Phys. 32, 2536 "
    "(2005)",
    stage="focal_spot",
    signature="residuals at edges that change their sign from view to view",
    settled_by="scan a ball near the axis: its track alternates between even and odd views",
    parameters=(
        Parameter("columns_mm", "mm", "jump j along the columns from an even to an odd view", -5.0, 5.0, 0.0, 0.5),
        Parameter("rows_mm", "mm", "jump along z, as seen from the isocenter", -5.0, 5.0, 0.0, 0.0),
    ),
    apply=apply,
    needs=(DIVERGENT_BEAM, SUCCESSIVE_VIEWS),
)
