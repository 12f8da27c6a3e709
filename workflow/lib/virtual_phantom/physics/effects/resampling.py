"""Interpolation from another matrix."""

import numpy as np
import scipy

from ..effect import Effect, Parameter
from ..image_state import ImageState

LEAST = 0.05  # pixels of the image; a finer matrix makes no difference


def apply(state: ImageState, values: dict[str, float]) -> None:
    """Sample the image on another matrix and interpolate it back."""
    pixel = values["pixel_mm"]
    if pixel < LEAST * min(state.spacing_mm[1:]):
        return
    for axis, coordinates in ((1, state.y_mm), (2, state.x_mm)):
        last = np.ceil(max(-coordinates[0], coordinates[-1]) / pixel + 0.5)
        matrix = pixel * (np.arange(-last, last) + 0.5)  # pixels on both sides of the center
        inside = np.clip(matrix, coordinates[0], coordinates[-1])
        sampled = scipy.interpolate.make_interp_spline(coordinates, state.hu, 3, axis=axis)(inside)
        linear = scipy.interpolate.make_interp_spline(matrix, sampled, 1, axis=axis)
        state.hu = linear(coordinates).astype(state.hu.dtype)


EFFECT = Effect(
    name="resampling",
    physics="The images were interpolated linearly from a matrix with other pixels. The blur changes periodically over "
    "the image, as pixels of both matrices coincide or not.",
    equation="image' = sum over the pixels p of the other matrix of image(p) max(0, 1 - |x - p| / d), in x and y",
    source="P. Thevenaz, T. Blu and M. Unser, IEEE Trans. Med. Imaging 19, 739 (2000)",
    stage="image",
    signature="as the reconstruction kernel, with a periodic pattern of noise and sharpness",
    settled_by="export the images in the matrix of the reconstruction",
    parameters=(
        Parameter("pixel_mm", "mm", "pixel size d of the other matrix", 0.0, 5.0, 0.8, 1.0, power=2, periodic=True),
    ),
    apply=apply,
)
