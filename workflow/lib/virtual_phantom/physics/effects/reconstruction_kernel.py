"""Reconstruction kernel: apodisation of the image."""

import numpy as np
import scipy

from ..effect import Effect, Parameter
from ..image_state import ImageState


def apply(state: ImageState, values: dict[str, float]) -> None:
    """Blur the image in the plane."""
    if not values["sigma_mm"]:
        return
    # Cosines take the image to go on as in a mirror. Sampled, a Gaussian narrower than a voxel would do nothing at all.
    fft = scipy.fft
    for axis, spacing in ((1, state.spacing_mm[1]), (2, state.spacing_mm[2])):
        count = state.hu.shape[axis]
        cycles_per_mm = np.arange(count) / (2 * count * spacing)
        damped = np.exp(-2 * (np.pi * values["sigma_mm"] * cycles_per_mm) ** 2)
        shape = [1, 1, 1]
        shape[axis] = count
        state.hu = fft.idct(fft.dct(state.hu, axis=axis) * damped.reshape(shape).astype(state.hu.dtype), axis=axis)


EFFECT = Effect(
    name="reconstruction_kernel",
    physics="The kernel damps high frequencies in the plane: less resolution, less and coarser noise.",
    equation="image' = G_s * image in x and y; MTF'(f) = MTF(f) exp(-2 (pi s f)^2)",
    source="J. Hsieh, Computed Tomography, 3rd ed., SPIE (2015), reconstruction filters; here a Gaussian",
    stage="image",
    signature="edges in the plane are wider and noise is coarser, alike everywhere",
    settled_by="a wire or edge phantom: its MTF",
    parameters=(Parameter("sigma_mm", "mm", "standard deviation of the blur", 0.0, 5.0, 0.5, 0.6, power=2),),
    apply=apply,
)
