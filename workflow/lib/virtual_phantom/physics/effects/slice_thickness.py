"""Slices thicker than their spacing."""

import numpy as np
import scipy

from ...reconstruction.slices import overlaps
from ..effect import DIFFERENT_SLICES, Effect, Parameter
from ..image_state import ImageState


def apply(state: ImageState, values: dict[str, float]) -> None:
    """Average over the thickness of a slice."""
    half = values["thickness_mm"] / state.spacing_mm[0] / 2  # in slices
    reach = int(np.ceil(half + 0.5))
    offsets = np.arange(-reach, reach + 1)
    kernel = overlaps(offsets, half)
    if half <= 0.5:  # thinner than the spacing: no averaging
        return
    state.hu = scipy.ndimage.convolve1d(state.hu, kernel / kernel.sum(), axis=0, mode="nearest")


EFFECT = Effect(
    name="slice_thickness",
    physics="Slices are thicker than their spacing, so each slice contains a part of its neighbors.",
    equation="image'(z) = mean of image over z - t/2 to z + t/2",
    source="IEC 61223-3-5:2019 (slice thickness); W. A. Kalender, Computed Tomography, 3rd ed., Publicis (2011)",
    stage="image",
    signature="edges along z are wider, and noise of neighboring slices is correlated",
    settled_by="measure the slice sensitivity profile with a ramp or bead phantom",
    parameters=(Parameter("thickness_mm", "mm", "full width t of the profile", 0.0, 20.0, 3.0, 4.0),),
    needs=(DIFFERENT_SLICES,),
    apply=apply,
)
