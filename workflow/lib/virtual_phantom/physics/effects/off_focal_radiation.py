"""Off-focal radiation."""

import numpy as np

from ...base.geometry import orbit_of
from ..effect import Effect, Parameter
from ..scenes.sampling import points
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Add points of the anode around the focal spot, as the collimator lets each pixel see them."""
    geometry, share, width = orbit_of(state.geometry, "off_focal_radiation"), values["share"], values["width_mm"]
    if not share:
        return
    to_detector, collimator = geometry.source_to_detector_mm, values["collimator_mm"]
    columns = to_detector * np.tan(geometry.fan_angles_rad())  # on the flat through the detector's middle
    # A collimator that the beam of the focal spot just fits through hides, of what lies beside that spot, all whose ray
    # to the pixel passes it farther out.
    edge = np.array([columns[0], columns[-1]]) + np.array([-0.5, 0.5]) * geometry.column_pitch_mm
    blur = (geometry.magnification - 1) * width / geometry.column_pitch_mm
    pixel = geometry.column_pitch_mm
    beside = []
    for place, weight in points(width, blur):
        passes = columns + place * width * (to_detector - collimator) / collimator  # scaled to the detector
        seen = np.clip(np.minimum(passes - edge[0], edge[1] - passes) / pixel + 0.5, 0, 1)  # over a pixel's width
        beside.append((place * width, 0.0, 0.0, share * weight * seen))
    spot = tuple((*place, (1 - share) * weight) for *place, weight in state.sources)
    state.sources = (*spot, *beside)


EFFECT = Effect(
    name="off_focal_radiation",
    title="off-focal radiation",
    physics="Electrons scattered back strike the anode around the focal spot: a faint, wide source.",
    equation="T = (1 - s) T(spot) + s mean of h T(x) over x from -w/2 to w/2 along the columns, in the air scan "
    "too; h = 1 where the ray from x passes the pre-patient collimator (at c, as wide as the beam), else "
    "0",
    source="R. Birch, Br. J. Radiol. 49, 951 (1976); J. Hsieh, Computed Tomography, 3rd ed., SPIE (2015), "
    "off-focal radiation",
    stage="focal_spot",
    signature="a faint shadow beside the object's edges: line integrals too low inside and above 0 outside; the "
    "white field falls at both ends of the rows",
    settled_by="a lead edge or slit near the source and near the detector: its faint shadow's width follows the "
    "magnification, glare's does not",
    parameters=(
        Parameter("share", "1", "share of the radiation that comes from beside the spot", 0.0, 0.3, 0.02, 0.05),
        Parameter(
            "width_mm",
            "mm",
            "how far it reaches along the columns, in all",
            5.0,
            100.0,
            40.0,
            40.0,
            None,
            kernel=True,
        ),
        Parameter(
            "collimator_mm",
            "mm",
            "pre-patient collimator, from the focal spot; a fit does not vary it",
            50.0,
            400.0,
            200.0,
            200.0,
            None,
            stated=True,
        ),
    ),
    apply=apply,
)
