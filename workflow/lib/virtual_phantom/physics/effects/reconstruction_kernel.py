"""Reconstruction kernel: apodization of the image."""

import numpy as np
import scipy

from ..effect import Effect, Parameter
from ..image_state import ImageState


def apply(state: ImageState, values: dict[str, float]) -> None:
    """Blur the image in the plane."""
    if not values["sigma_mm"]:
        return
    # The cosine transform implies mirrored boundaries. A sampled kernel narrower than a voxel would have no effect.
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
    physics="The kernel attenuates high in-plane frequencies: lower resolution, and less and coarser noise.",
    equation="image' = G_s * image in x and y; MTF'(f) = MTF(f) exp(-2 (pi s f)^2)",
    source="J. Hsieh, Computed Tomography, 3rd ed., SPIE (2015), reconstruction filters; here a Gaussian",
    stage="image",
    signature="in-plane edges are wider and noise is coarser, equally everywhere",
    settled_by="measure the MTF with a wire or edge phantom",
    parameters=(Parameter("sigma_mm", "mm", "standard deviation s of the blur", 0.0, 5.0, 0.5, 0.6, power=2),),
    apply=apply,
)
