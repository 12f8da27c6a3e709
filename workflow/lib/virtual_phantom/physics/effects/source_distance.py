"""Errors of the source distances."""

from dataclasses import replace

from ...base.geometry import orbit_of
from ..effect import Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Change both distances of the source."""
    geometry = orbit_of(state.geometry, "source_distance")
    state.geometry = replace(
        geometry,
        source_to_isocentre_mm=geometry.source_to_isocentre_mm + values["isocentre_mm"],
        source_to_detector_mm=geometry.source_to_detector_mm + values["detector_mm"],
    )


EFFECT = Effect(
    name="source_distance",
    physics="The distances from source to isocenter and to detector differ from the stated ones.",
    equation="R' = R + r, D' = D + d",
    source="F. Noo et al., Phys. Med. Biol. 45, 3489 (2000)",
    stage="geometry",
    signature="the shadow is too large or too small, equally in all views",
    settled_by="scan two balls at a known distance",
    parameters=(
        Parameter("isocentre_mm", "mm", "error r of the distance to the isocenter", -40.0, 40.0, 0.0, 4.0),
        Parameter("detector_mm", "mm", "error d of the distance to the detector", -80.0, 80.0, 0.0, 0.0),
    ),
    apply=apply,
)
