"""Reconstruction kernel: apodization of the image, with or without a boost of middle frequencies."""

import numpy as np
import scipy

from ..effect import LOGARITHM, Effect, Parameter
from ..image_state import ImageState


def mtf(cycles_per_mm: np.ndarray, values: dict[str, float]) -> np.ndarray:
    """Return the factor of the MTF at in-plane frequencies."""
    square = (cycles_per_mm * 10 / values["boost_per_cm"]) ** 2
    boost = 1 + values["boost"] * square * np.exp(1 - square)
    return np.exp(-2 * (np.pi * values["sigma_mm"] * cycles_per_mm) ** 2) * boost


def apply(state: ImageState, values: dict[str, float]) -> None:
    """Filter the image in the plane."""
    if not values["sigma_mm"] and not values["boost"]:
        return
    # The cosine transform implies mirrored boundaries. A sampled kernel narrower than a voxel would have no effect.
    plane = zip(state.hu.shape[1:], state.spacing_mm[1:], strict=True)
    rows, columns = (np.arange(n) / (2 * n * pixel) for n, pixel in plane)
    factor = mtf(np.hypot(rows[:, None], columns), values).astype(state.hu.dtype)
    state.hu = scipy.fft.idctn(scipy.fft.dctn(state.hu, axes=(1, 2)) * factor, axes=(1, 2))


EFFECT = Effect(
    name="reconstruction_kernel",
    physics="The kernel attenuates high in-plane frequencies: lower resolution, and less and coarser noise. "
    "Edge-enhancing kernels amplify middle frequencies, so edges overshoot.",
    equation="MTF'(f) = MTF(f) exp(-2 (pi s f)^2) (1 + b q exp(1 - q)) with q = (f / f_b)^2, f the in-plane frequency",
    source="J. Hsieh, Computed Tomography, 3rd ed., SPIE (2015), reconstruction filters; here a Gaussian. Boost: S. N. "
    "Friedman et al., Med. Phys. 40, 051907 (2013), measured transfer functions",
    stage="image",
    signature="in-plane edges are wider or overshoot, and the noise texture changes, equally everywhere",
    settled_by="measure the MTF with a wire or edge phantom",
    parameters=(
        Parameter("sigma_mm", "mm", "standard deviation s of the blur", 0.0, 5.0, 0.5, 0.6, power=2),
        Parameter("boost", "1", "b: increase of the MTF at f_b", 0.0, 2.0, 0.0, 0.0),
        Parameter(
            "boost_per_cm", "1/cm", "f_b: frequency of the boost", 0.3, 10.0, 3.0, 3.0, None, LOGARITHM, title="peak"
        ),
    ),
    apply=apply,
)
