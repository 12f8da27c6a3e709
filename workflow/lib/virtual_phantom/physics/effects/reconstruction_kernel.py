"""Reconstruction kernel: apodization of the reconstruction filter, with or without a boost of middle frequencies."""

import numpy as np

from ..effect import LOGARITHM, Effect, Parameter
from ..image_state import ImageState

GAUSSIAN = 1e-4  # absolute shape below which the window is computed as a Gaussian


def mtf(cycles_per_mm: np.ndarray, values: dict[str, float]) -> np.ndarray:
    """Return the factor of the MTF at in-plane frequencies."""
    shape, angle = values["shape"], 2 * np.pi * values["sigma_mm"] * cycles_per_mm
    if abs(shape) < GAUSSIAN:
        window = np.exp(-(angle**2) / 2)
    elif shape > 0:
        window = np.cos(np.minimum(np.sqrt(shape) * angle, np.pi / 2)) ** (1 / shape)
    else:
        window = np.cosh(np.sqrt(-shape) * angle) ** (1 / shape)
    square = (cycles_per_mm * 10 / values["boost_per_cm"]) ** 2
    return window * (1 + values["boost"] * square * np.exp(1 - square))


def apply(state: ImageState, values: dict[str, float]) -> None:
    """Filter the image in the plane."""
    if values["sigma_mm"] or values["boost"]:
        state.filter(lambda cycles_per_mm: mtf(cycles_per_mm, values))


EFFECT = Effect(
    name="reconstruction_kernel",
    physics="The kernel attenuates high in-plane frequencies: lower resolution, and less and coarser noise. "
    "Edge-enhancing kernels amplify middle frequencies, so edges overshoot. Filtered back-projection applies it to "
    "projections, other images are filtered.",
    equation="MTF'(f) = MTF(f) cos(2 pi s f sqrt(k))^(1/k) (1 + b q exp(1 - q)) with q = (f / f_b)^2, f the in-plane "
    "frequency; 0 beyond the first zero. k = 0: Gaussian, 1/2: Hann, 1: cosine window; k < 0: cosh, longer tails",
    source="F. J. Harris, Proc. IEEE 66, 51 (1978), powers of cosines. Boost: S. N. Friedman et al., Med. Phys. 40, "
    "051907 (2013), measured transfer functions",
    stage="image",
    signature="in-plane edges are wider or overshoot, and the noise texture changes, equally everywhere",
    settled_by="measure the MTF with a wire or edge phantom",
    parameters=(
        Parameter("sigma_mm", "mm", "standard deviation s of the blur", 0.0, 5.0, 0.5, 0.6, power=2),
        Parameter("shape", "1", "k: shape of the window", -2.0, 2.0, 0.5, 0.0, None, kernel=True, kernel_error=0.0),
        Parameter("boost", "1", "b: increase of the MTF at f_b", 0.0, 2.0, 0.0, 0.0),
        Parameter(
            "boost_per_cm", "1/cm", "f_b: frequency of the boost", 0.3, 10.0, 3.0, 3.0, None, LOGARITHM, title="peak"
        ),
    ),
    apply=apply,
    mtf=mtf,
)
