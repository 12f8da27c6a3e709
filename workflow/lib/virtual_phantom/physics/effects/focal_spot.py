"""Finite focal spot."""

import itertools
import math

import numpy as np

from ..effect import Effect, Parameter
from ..state import State

# Points per side: their shadows, of what lies at the isocentre, are no farther apart than a pixel is wide. Against 96
# points per side, the peak of a ball as wide as a pixel is then right to 6 % (three points of pixels a quarter as wide
# as the blur: to 32 %).
LEAST, MOST = 3, 7


def apply(state: State, values: dict[str, float]) -> None:
    """Set the points of the focal spot."""
    geometry, width, length = state.geometry, values["width_mm"], values["length_mm"]
    # The length is what the detector sees of a spot on an inclined anode, whose ends are not equally far (line focus).
    away = -length / math.tan(math.radians(state.anode.angle_deg))
    blur = geometry.magnification - 1
    across = points(width, blur * width / geometry.column_pitch_mm)
    along = points(length, blur * length / geometry.row_pitch_mm if geometry.rows > 1 else 0.0)
    state.sources = tuple(
        (u * width, v * length, v * away, one * other) for (u, one), (v, other) in itertools.product(across, along)
    )


def points(side_mm: float, blurred_px: float) -> list[tuple[float, float]]:
    """Places along a side of 1 from its middle, and their weights: Gauss and Legendre's, none of which is negative.

    Parameters
    ----------
    side_mm : float
        0: a point.
    blurred_px : float
        Width of the blur that the side makes of what lies at the isocentre, pixels.

    Returns
    -------
    list of tuple of 2 float
        (place, weight).
    """
    if not side_mm:
        return [(0.0, 1.0)]
    nodes, weights = np.polynomial.legendre.leggauss(min(max(LEAST, math.ceil(blurred_px) + 1), MOST))
    return [(float(node) / 2, float(weight) / 2) for node, weight in zip(nodes, weights, strict=True)]


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
