"""Off-focal radiation."""

import numpy as np

from ...base.geometry import orbit_of
from ..effect import DIVERGENT_BEAM, Effect, Parameter
from ..scenes.sampling import points
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Add points of the anode around the focal spot, as each pixel sees them through the collimator."""
    geometry, share, width = orbit_of(state.geometry, "off_focal_radiation"), values["share"], values["width_mm"]
    if not share:
        return
    to_detector, collimator = geometry.source_to_detector_mm, values["collimator_mm"]
    columns = to_detector * np.tan(geometry.fan_angles_rad())  # on the plane through the detector center
    # The collimator just passes the beam of the focal spot. It blocks a point next to the spot if the ray from that
    # point to the pixel passes outside of the opening.
    edge = np.array([columns[0], columns[-1]]) + np.array([-0.5, 0.5]) * geometry.column_pitch_mm
    blur = (geometry.magnification - 1) * width / geometry.column_pitch_mm
    pixel = geometry.column_pitch_mm
    beside = []
    for place, weight in points(width, blur):
        passes = columns + place * width * (to_detector - collimator) / collimator  # scaled to the detector
        seen = np.clip(np.minimum(passes - edge[0], edge[1] - passes) / pixel + 0.5, 0, 1)  # smoothed over one pixel
        beside.append((place * width, 0.0, 0.0, share * weight * seen))
    spot = tuple((*place, (1 - share) * weight) for *place, weight in state.sources)
    state.sources = (*spot, *beside)


# In six scans (benchmarks/intervals.py, seeds 71 and 72), fits found 41 to 74 % of the true share. The missing part has
# an RMS of 1.1 times the share found; the model error represents it by a source of half the width.
KERNEL = {"kernel": True, "kernel_error": 1.0}
COLLIMATOR = "distance c of the pre-patient collimator from the focal spot; not fitted"

EFFECT = Effect(
    name="off_focal_radiation",
    title="off-focal radiation",
    physics="Backscattered electrons strike the anode around the focal spot and form a faint, wide source.",
    equation="T = (1 - s) T(spot) + s mean of h T(x) over x from -w/2 to w/2 along the columns, also in the air scan. "
    "Here h = 1 if the ray from x passes the pre-patient collimator (at distance c, as wide as the beam), else 0",
    source="R. Birch, Br. J. Radiol. 49, 951 (1976); J. Hsieh, Computed Tomography, 3rd ed., SPIE (2015), off-focal "
    "radiation",
    stage="focal_spot",
    signature="a faint shadow next to the edges of the object: line integrals are too low inside and above 0 outside; "
    "the white field falls at both ends of the rows",
    settled_by="scan a lead edge or slit near the source and near the detector: the width of its faint shadow follows "
    "the magnification, glare does not",
    parameters=(
        Parameter("share", "1", "share s of the radiation from outside the focal spot", 0.0, 0.3, 0.02, 0.05),
        Parameter(
            "width_mm", "mm", "full width w of the source along the columns", 5.0, 100.0, 40.0, 40.0, None, **KERNEL
        ),
        Parameter("collimator_mm", "mm", COLLIMATOR, 50.0, 400.0, 200.0, 200.0, None, stated=True),
    ),
    apply=apply,
    needs=(DIVERGENT_BEAM,),
)
