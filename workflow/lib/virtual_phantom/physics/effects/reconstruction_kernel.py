"""Reconstruction kernel: apodisation of the image."""

from scipy import ndimage

from ..effect import Effect, Parameter
from ..image import ImageState


def apply(state: ImageState, values: dict[str, float]) -> None:
    _, dy, dx = state.spacing_mm
    sigma = (0.0, values["sigma_mm"] / dy, values["sigma_mm"] / dx)
    state.hu = ndimage.gaussian_filter(state.hu, sigma, mode="nearest", truncate=6)


EFFECT = Effect(
    name="reconstruction_kernel",
    physics="The kernel damps high frequencies in the plane: less resolution, less and coarser noise.",
    equation="image' = G_s * image in x and y; MTF'(f) = MTF(f) exp(-2 (pi s f)^2)",
    source="J. Hsieh, Computed Tomography, 3rd ed., SPIE (2015), section on reconstruction filters; here a Gaussian",
    stage="image",
    signature="edges in the plane are wider and noise is coarser, alike everywhere",
    settled_by="a wire or edge phantom: its MTF",
    parameters=(Parameter("sigma_mm", "mm", "standard deviation of the blur", 0.0, 5.0, 0.5, 0.6),),
    apply=apply,
)
