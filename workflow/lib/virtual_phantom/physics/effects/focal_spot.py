"""Finite focal spot."""

import itertools
import math

from ..effect import DIVERGENT_BEAM, Effect, Parameter
from ..scenes.sampling import points
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Set the points of the focal spot."""
    geometry, width, length = state.geometry, values["width_mm"], values["length_mm"]
    # Line focus: the length is the projection of a spot on an inclined anode, whose ends differ in distance.
    away = -length / math.tan(math.radians(state.anode.angle_deg))
    blur = geometry.magnification - 1
    across = points(width, blur * width / geometry.column_pitch_mm, state.fewest_points)
    of_rows = blur * length / geometry.row_pitch_mm if geometry.rows > 1 else 0.0
    along = points(length, of_rows, state.fewest_points)
    state.sources = tuple(
        (u * width, v * length, v * away, one * other) for (u, one), (v, other) in itertools.product(across, along)
    )


EFFECT = Effect(
    name="focal_spot",
    physics="The source has a finite size. Edges in the projections are blurred, more so far from the detector.",
    equation="T = mean of T(source point) over a rectangle on the anode inclined by a: w wide along the columns, l "
    "long along z and l / tan(a) deep",
    source="IEC 60336:2020; line focus: J. T. Bushberg et al., The Essential Physics of Medical Imaging (2012), "
    "chapter 6",
    stage="focal_spot",
    signature="residuals of both signs at edges, wider for parts near the source; noise stays white",
    settled_by="scan an edge or wire near the source and near the detector: focal-spot blur follows the "
    "magnification, crosstalk does not",
    parameters=(
        Parameter("width_mm", "mm", "width w along the columns", 0.0, 4.0, 1.0, 1.0, power=2),
        Parameter("length_mm", "mm", "length l along z, as seen from the isocenter", 0.0, 4.0, 1.0, 1.0, power=2),
    ),
    apply=apply,
    needs=(DIVERGENT_BEAM,),
)
