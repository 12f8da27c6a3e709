"""Wide Gaussian spreads of signal on the detector."""

from __future__ import annotations

import numpy as np
import scipy

from ..base.geometry import ScanGeometry

TRUNCATED = 3.0  # standard deviations: beyond them a kernel is 0


def spread(
    array: np.ndarray, geometry: ScanGeometry, width_mm: float, reach_mm: tuple[float, float] = (np.inf, np.inf)
) -> np.ndarray:
    """Each view under a Gaussian on the detector.

    A single row stands for a beam that is high enough to look alike from row to row. Beyond the detector there is
    nothing, as scipy.ndimage.gaussian_filter's mode "constant". Kernels as wide as the detector are quicker as matrices
    than tap by tap.

    Parameters
    ----------
    array : ndarray, shape (..., views, rows, columns)
    width_mm : float
        Standard deviation, mm.
    reach_mm : tuple of 2 float, optional
        Along columns and rows, mm: of what comes from so far nothing arrives, of what comes from nearer a share that
        falls linearly.

    Returns
    -------
    ndarray
        Shaped as `array`.
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
    """Half of the kernel sampled at pixels, that of the middle first: all of it would sum up to 1 if all arrived."""
    place = np.arange(int(TRUNCATED * sigma + 0.5) + 1)
    kernel = np.exp(-0.5 * (place / sigma) ** 2)
    kernel /= 2 * kernel.sum() - kernel[0]
    return kernel if np.isinf(reach) else kernel * np.maximum(1 - place / reach, 0)


def _matrix(length: int, kernel: np.ndarray) -> np.ndarray:
    """Symmetric matrix of half a kernel."""
    column = np.zeros(length)
    column[: len(kernel)] = kernel[:length]
    return scipy.linalg.toeplitz(column)
