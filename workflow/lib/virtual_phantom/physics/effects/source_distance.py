"""Errors of the distances."""

from dataclasses import replace

from ...base.geometry import orbit_of
from ..effect import DIVERGENT_BEAM, Effect, Parameter
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
    physics="The source is nearer or farther from isocentre and detector than stated.",
    equation="R' = R + r, D' = D + d",
    source="F. Noo et al., Phys. Med. Biol. 45, 3489 (2000)",
    stage="geometry",
    signature="shadow too large or too small, alike in all views",
    settled_by="two balls at a known distance",
    parameters=(
        Parameter("isocentre_mm", "mm", "error of the distance to the isocentre", -40.0, 40.0, 0.0, 4.0),
        Parameter("detector_mm", "mm", "error of the distance to the detector", -80.0, 80.0, 0.0, 0.0),
    ),
    apply=apply,
    needs=(DIVERGENT_BEAM,),
)
