"""Heel effect of the anode."""

import numpy as np

from ...base.geometry import orbit_of
from ..effect import DIVERGENT_BEAM, Effect, Parameter
from ..state import State

MATERIALS = {"W": "tungsten", "Mo": "molybdenum", "Rh": "rhodium"}
LEAST_ANGLE_DEG = 1.0  # smallest take-off angle; flatter rays are treated alike, almost fully absorbed


def apply(state: State, values: dict[str, float]) -> None:
    """Add the target material as a filter, thicker from row to row."""
    geometry, depth_mm = orbit_of(state.geometry, "heel"), values["depth_um"] / 1000
    cone = np.arctan2(geometry.row_positions_mm(), geometry.source_to_detector_mm)
    anode = abs(np.deg2rad(state.anode.angle_deg))
    # The end of the focal spot nearer to the isocenter is on the anode side, where rays leave at a flat angle.
    leaving = anode - np.sign(depth_mm * state.anode.angle_deg) * cone
    longer = 1 / np.sin(np.maximum(leaving, np.deg2rad(LEAST_ANGLE_DEG))) - 1 / np.sin(anode)
    state.filters = (*state.filters, (MATERIALS[state.anode.target], (abs(depth_mm) * longer)[:, None]))


DEPTH = "depth d in the target at which photons are produced; negative: anode on the side opposite to its angle"

EFFECT = Effect(
    name="heel",
    physics="The anode absorbs part of its own beam: the fluence falls toward the anode side along the rows and, with "
    "a spectrum, the beam hardens.",
    equation="fluence(v, E) = exp(-mu(E) d (1 / sin(a - c) - 1 / sin a)), tan c = v / D; a: anode angle",
    source="J. Beutel, H. L. Kundel and R. L. Van Metter, Handbook of Medical Imaging 1, SPIE (2000), chapter 1",
    stage="fluence",
    signature="the white field and noise change monotonically along the rows; with a spectrum, line integrals fall "
    "toward the anode side",
    settled_by="measure the white field",
    parameters=(Parameter("depth_um", "um", DEPTH, -40.0, 40.0, 5.0, 5.0),),
    apply=apply,
    removed_by=("flat",),
    needs=(DIVERGENT_BEAM,),
)
