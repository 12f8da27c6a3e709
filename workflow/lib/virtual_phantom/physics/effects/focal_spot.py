"""Finite focal spot."""

import math

from ..chain import State
from ..effect import Effect, Parameter


def apply(state: State, values: dict[str, float]) -> None:
    # Three points of Gauss-Legendre per direction: exact to the fifth order of a uniform spot. The two directions add
    # up to second order, as their blurs do.
    width, length = values["width_mm"], values["length_mm"]
    node = math.sqrt(3 / 5) / 2
    middle, points = 1.0, []
    # The length is what the detector sees of a spot on an inclined anode, whose ends are not equally far (line focus).
    away = -length / math.tan(math.radians(state.anode.angle_deg))
    for ends in ((width, 0.0, 0.0), (0.0, length, away)):
        if any(ends):
            middle += 8 / 18 - 1
            points += [(*(sign * node * end for end in ends), 5 / 18) for sign in (-1, 1)]
    state.sources = ((0.0, 0.0, 0.0, middle), *points)


EFFECT = Effect(
    name="focal_spot",
    physics="The source is not a point: edges in the projections are blurred, more so far from the detector.",
    equation="T = mean of T(source point) over a uniform rectangle on the anode, inclined by a: w wide along the "
    "columns, l long along z and so l / tan(a) deep",
    source="IEC 60336:2020, X-ray tube assemblies: focal spot dimensions; line focus: J. T. Bushberg et al., The "
    "Essential Physics of Medical Imaging (2012), chapter 6",
    stage="focal_spot",
    signature="residuals of both signs at edges, wider for what is near the source; noise stays white",
    settled_by="an edge or wire scanned near the source and near the detector: focal-spot blur follows the "
    "magnification, crosstalk does not",
    parameters=(
        Parameter("width_mm", "mm", "width along the columns", 0.0, 4.0, 1.0, 1.0, power=2),
        Parameter("length_mm", "mm", "length along z, as seen from the isocentre", 0.0, 4.0, 1.0, 1.0, power=2),
    ),
    apply=apply,
)
