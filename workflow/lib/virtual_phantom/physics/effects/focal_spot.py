"""Finite focal spot."""

import math

from ..chain import State
from ..effect import Effect, Parameter


def apply(state: State, values: dict[str, float]) -> None:
    # Three points of Gauss-Legendre per direction: exact to the fifth order of a uniform spot. The two directions add
    # up to second order, as their blurs do.
    width, length = values["width_mm"], values["length_mm"]
    node = math.sqrt(3 / 5) / 2
    points = {(0.0, 0.0): 1.0}
    for column, row in ((width, 0.0), (0.0, length)):
        if not column and not row:
            continue
        points[(0.0, 0.0)] += 8 / 18 - 1
        for sign in (-1, 1):
            points[(sign * node * column, sign * node * row)] = 5 / 18
    state.sources = tuple((*point, weight) for point, weight in points.items())


EFFECT = Effect(
    name="focal_spot",
    physics="The source is not a point: edges in the projections are blurred, more so far from the detector.",
    equation="T = mean of T(source point) over a uniform rectangle, w wide along the columns and l long along z",
    source="IEC 60336:2020, X-ray tube assemblies: focal spot dimensions",
    stage="focal_spot",
    signature="residuals of both signs at edges, wider for what is near the source; noise stays white",
    settled_by="an edge or wire scanned near the source and near the detector: focal-spot blur follows the "
    "magnification, crosstalk does not",
    parameters=(
        Parameter("width_mm", "mm", "width along the columns", 0.0, 4.0, 1.0, 1.0, power=2),
        Parameter("length_mm", "mm", "length along z", 0.0, 4.0, 1.0, 1.0, power=2),
    ),
    apply=apply,
)
