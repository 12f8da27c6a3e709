"""Wide Gaussian spreads of signal on the detector."""

from __future__ import annotations

import numpy as np
from scipy.linalg import toeplitz

TRUNCATED = 3.0  # standard deviations: beyond them a kernel is 0


def spread(array: np.ndarray, rows_px: float, columns_px: float) -> np.ndarray:
    """Each view of an array [view, row, column] under a Gaussian of these standard deviations in pixels (0: none).

    Beyond the detector there is nothing, as scipy.ndimage.gaussian_filter's mode "constant". Kernels as wide as the
    detector are quicker as matrices than tap by tap.
    """
    if columns_px > 0:
        array = array @ _matrix(array.shape[2], columns_px)
    if rows_px > 0 and array.shape[1] > 1:
        array = _matrix(array.shape[1], rows_px) @ array
    return array


def _matrix(length: int, sigma: float) -> np.ndarray:
    """Symmetric matrix of the kernel sampled at pixels, its sum over all pixels, on the detector or not, 1."""
    reach = int(TRUNCATED * sigma + 0.5)
    kernel = np.exp(-0.5 * (np.arange(reach + 1) / sigma) ** 2)
    kernel /= 2 * kernel.sum() - kernel[0]
    column = np.zeros(length)
    column[: reach + 1] = kernel[:length]
    return toeplitz(column)
