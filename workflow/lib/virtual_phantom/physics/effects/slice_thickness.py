"""Slices thicker than their spacing."""

import numpy as np
import scipy

from ...reconstruction.slices import overlaps
from ..effect import DIFFERENT_SLICES, Effect, Parameter
from ..image_state import ImageState

SHIFTS = 32  # of a rectangle, whose mean is a trapezoid


def apply(state: ImageState, values: dict[str, float]) -> None:
    """Average over the profile of a slice."""
    half = values["thickness_mm"] / state.spacing_mm[0] / 2  # in slices
    if half * (1 + values["slope"]) <= 0.5:  # thinner than the spacing: no averaging
        return
    reach = int(np.ceil(half * (1 + values["slope"]) + 0.5))
    shifts = ((np.arange(SHIFTS) + 0.5) / SHIFTS * 2 - 1) * values["slope"] * half
    profile = overlaps(np.arange(-reach, reach + 1) - shifts[:, None], half).mean(axis=0)
    state.hu = scipy.ndimage.convolve1d(state.hu, profile / profile.sum(), axis=0, mode="nearest")


EFFECT = Effect(
    name="slice_thickness",
    physics="Slices are thicker than their spacing, so each slice contains a part of its neighbors. Interpolation "
    "along z rounds the profile.",
    equation="image'(z) = image convolved with rectangles of widths t and g t",
    source="IEC 61223-3-5:2019 (slice thickness); W. A. Kalender, Computed Tomography, 3rd ed., Publicis (2011): "
    "rectangular profiles of sequential scans, triangular ones of interpolated helical scans",
    stage="image",
    signature="edges along z are wider, and noise of neighboring slices is correlated",
    settled_by="measure the slice sensitivity profile with a ramp or bead phantom",
    parameters=(
        Parameter("thickness_mm", "mm", "full width t of the profile at half its maximum", 0.0, 20.0, 3.0, 4.0),
        Parameter("slope", "1", "g: 0 for a rectangular, 1 for a triangular profile", 0.0, 1.0, 0.3, 0.0, None),
    ),
    needs=(DIFFERENT_SLICES,),
    apply=apply,
)
