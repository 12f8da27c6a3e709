"""Wide Gaussian spreads of signal on the detector."""

from __future__ import annotations

import numpy as np
import scipy

from ..base.geometry import ScanGeometry

TRUNCATED = 3.0  # standard deviations: beyond them a kernel is 0


def spread(array: np.ndarray, geometry: ScanGeometry, width_mm: float) -> np.ndarray:
    """Each view under a Gaussian on the detector.

    A single row stands for a beam that is high enough to look alike from row to row. Beyond the detector there is
    nothing, as scipy.ndimage.gaussian_filter's mode "constant". Kernels as wide as the detector are quicker as matrices
    than tap by tap.

    Parameters
    ----------
    array : ndarray, shape (..., views, rows, columns)
    geometry : ScanGeometry
    width_mm : float
        Standard deviation, mm.

    Returns
    -------
    ndarray
        Shaped as `array`.
    """
    array = array @ _matrix(geometry.columns, width_mm / geometry.column_pitch_mm)
    if geometry.rows > 1:
        array = _matrix(geometry.rows, width_mm / geometry.row_pitch_mm) @ array
    return array


def _matrix(length: int, sigma: float) -> np.ndarray:
    """Symmetric matrix of the kernel sampled at pixels, its sum over all pixels, on the detector or not, 1."""
    reach = int(TRUNCATED * sigma + 0.5)
    kernel = np.exp(-0.5 * (np.arange(reach + 1) / sigma) ** 2)
    kernel /= 2 * kernel.sum() - kernel[0]
    column = np.zeros(length)
    column[: reach + 1] = kernel[:length]
    return scipy.linalg.toeplitz(column)
