"""Wide Gaussian blur on the detector, for scatter and veiling glare."""

from __future__ import annotations

import numpy as np
import scipy

from ..base.geometry import ScanGeometry

TRUNCATED = 3.0  # standard deviations beyond which a kernel is 0


def spread(
    array: np.ndarray, geometry: ScanGeometry, width_mm: float, reach_mm: tuple[float, float] = (np.inf, np.inf)
) -> np.ndarray:
    """Return views blurred by a Gaussian on the detector.

    With one detector row, the beam is assumed to be constant along z. Outside of the detector the signal is 0, as with
    mode "constant" of scipy.ndimage.gaussian_filter. Matrix products are faster than filters for kernels as wide as the
    detector.

    Parameters
    ----------
    array : ndarray, shape (..., views, rows, columns)
    reach_mm : tuple of 2 float, optional
        Distance along columns and rows, mm, over which a factor of the kernel falls linearly from 1 to 0.
    """
    columns, rows = (
        _kernel(width_mm / pitch, reach / pitch)
        for pitch, reach in zip((geometry.column_pitch_mm, geometry.row_pitch_mm), reach_mm, strict=True)
    )
    array = array @ _matrix(geometry.columns, columns)
    if geometry.rows > 1:
        return _matrix(geometry.rows, rows) @ array
    return array * (2 * rows.sum() - rows[0]) if np.isfinite(reach_mm[1]) else array


def _kernel(sigma: float, reach: float) -> np.ndarray:
    """Return half of the kernel, starting at its center. Its sum is 1 before the factor of `reach`."""
    distance = np.arange(int(TRUNCATED * sigma + 0.5) + 1)
    kernel = np.exp(-0.5 * (distance / sigma) ** 2)
    kernel /= 2 * kernel.sum() - kernel[0]
    return kernel if np.isinf(reach) else kernel * np.maximum(1 - distance / reach, 0)


def _matrix(length: int, kernel: np.ndarray) -> np.ndarray:
    """Return the symmetric convolution matrix of half a kernel."""
    column = np.zeros(length)
    column[: len(kernel)] = kernel[:length]
    return scipy.linalg.toeplitz(column)
