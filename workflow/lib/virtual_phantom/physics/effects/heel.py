"""Heel effect of the anode."""

import numpy as np

from ...base.geometry import orbit_of
from ..effect import DIVERGENT_BEAM, Effect, Parameter
from ..state import State

MATERIALS = {"W": "tungsten", "Mo": "molybdenum", "Rh": "rhodium"}
LEAST_ANGLE_DEG = 1.0  # of a ray to the anode's surface: flatter ones are taken to leave as these, all but absorbed


def apply(state: State, values: dict[str, float]) -> None:
    """Add the anode's own material as a filter, thicker from row to row."""
    geometry, depth_mm = orbit_of(state.geometry, "heel"), values["depth_um"] / 1000
    cone = np.arctan2(geometry.row_positions_mm(), geometry.source_to_detector_mm)
    anode = abs(np.deg2rad(state.anode.angle_deg))
    # The end of the focal spot that is nearer to the isocentre is the anode's: rays to that side leave at a flat angle.
    leaving = anode - np.sign(depth_mm * state.anode.angle_deg) * cone
    longer = 1 / np.sin(np.maximum(leaving, np.deg2rad(LEAST_ANGLE_DEG))) - 1 / np.sin(anode)
    state.filters = (*state.filters, (MATERIALS[state.anode.target], (abs(depth_mm) * longer)[:, None]))


EFFECT = Effect(
    name="heel",
    physics="The anode absorbs part of its own beam: fluence falls towards its side, along the rows, and hardens "
    "beside a spectrum.",
    equation="fluence(v, E) = exp(-mu(E) d (1 / sin(a - c) - 1 / sin a)), tan c = v / D; a: inclination of the anode",
    source="J. Beutel, H. L. Kundel and R. L. Van Metter, Handbook of Medical Imaging 1, SPIE (2000), chapter 1",
    stage="fluence",
    signature="white field and noise change steadily from row to row; with a spectrum, line integrals fall towards "
    "the anode's side",
    settled_by="the white field",
    parameters=(
        Parameter(
            "depth_um",
            "um",
            "depth in the target from which photons come; negative: the anode is on the other side than its angle says",
            -40.0,
            40.0,
            5.0,
            5.0,
        ),
    ),
    apply=apply,
    removed_by=("flat",),
    needs=(DIVERGENT_BEAM,),
)
