"""Detector offset."""

from dataclasses import replace

from ..effect import Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Shift the detector columns."""
    geometry = state.geometry
    state.geometry = replace(geometry, column_offset_px=geometry.column_offset_px + values["columns_px"])


EFFECT = Effect(
    name="detector_offset",
    physics="The detector is shifted along its columns.",
    equation="u' = u + d",
    source="K. Yang et al., Med. Phys. 33, 1695 (2006)",
    stage="geometry",
    signature="residuals of opposite sign at the left and right edges of the shadow in all views",
    settled_by="scan a needle or ball over a full turn: the center of its track gives the offset",
    parameters=(Parameter("columns_px", "pixels", "shift d along the columns", -5.0, 5.0, 0.0, 0.25),),
    apply=apply,
)
