"""Wide blur on the detector, for scatter and veiling glare."""

from __future__ import annotations

import numpy as np
import scipy

from ..base.geometry import ScanGeometry

TRUNCATED = 3.0  # standard deviations beyond which a kernel is 0
GAUSSIANS = 5  # The transfer function of a long-tailed kernel is wrong by 0.02 at most, with 7 Gaussians by 0.01.


def spread(
    array: np.ndarray,
    geometry: ScanGeometry,
    width_mm: float,
    reach_mm: tuple[float, float] = (np.inf, np.inf),
    beyond: float = 0.0,
) -> np.ndarray:
    """Return views blurred by a Gaussian on the detector.

    With one detector row, the beam is assumed to be constant along z. Matrix products are faster than filters for
    kernels as wide as the detector.

    Parameters
    ----------
    array : ndarray, shape (..., views, rows, columns)
    reach_mm : tuple of 2 float, optional
        Distance along columns and rows, mm, over which a factor of the kernel falls linearly from 1 to 0.
    beyond : float, optional
        Signal beyond the detector, relative to that at its edges. With 0 and 1, the result is that of modes "constant"
        and "nearest" of scipy.ndimage.gaussian_filter.
    """
    columns, rows = (
        _kernel(width_mm / pitch, reach / pitch)
        for pitch, reach in zip((geometry.column_pitch_mm, geometry.row_pitch_mm), reach_mm, strict=True)
    )
    array = _along_columns(array, _matrix(geometry.columns, columns, beyond))
    if geometry.rows > 1:
        return _matrix(geometry.rows, rows, beyond).T @ array
    return array * (2 * rows.sum() - rows[0]) if np.isfinite(reach_mm[1]) else array


def long_tailed_spread(array: np.ndarray, geometry: ScanGeometry, width_mm: float, beyond: float = 0.0) -> np.ndarray:
    """Return views convolved with exp(-r / w) / (2 pi w r) on the detector.

    This kernel is the mean of Gaussians whose standard deviation is half-normally distributed with scale w, here
    replaced by a few Gaussians (Gauss-Legendre quadrature over quantiles). Its standard deviation along each axis is w.

    Parameters
    ----------
    array : ndarray, shape (..., views, rows, columns)
    beyond : float, optional
        As for `spread`.
    """
    nodes, shares = np.polynomial.legendre.leggauss(GAUSSIANS)
    widths = width_mm * np.sqrt(2) * scipy.special.erfinv((nodes + 1) / 2)
    gaussians = [(float(share) / 2, float(width)) for share, width in zip(shares, widths, strict=True)]
    if geometry.rows == 1:  # one product instead of one for each Gaussian
        kernels = ((share, _kernel(width / geometry.column_pitch_mm, np.inf)) for share, width in gaussians)
        matrix = sum(share * _matrix(geometry.columns, kernel, beyond) for share, kernel in kernels)
        return _along_columns(array, matrix)
    return sum(share * spread(array, geometry, width, beyond=beyond) for share, width in gaussians)


def _along_columns(array: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Return array @ matrix, by one product of two matrices instead of one product for each view."""
    return (array.reshape(-1, len(matrix)) @ matrix).reshape(array.shape)


def _kernel(sigma: float, reach: float) -> np.ndarray:
    """Return half of the kernel, starting at its center. Its sum is 1 before the factor of `reach`."""
    distance = np.arange(int(TRUNCATED * sigma + 0.5) + 1)
    kernel = np.exp(-0.5 * (distance / sigma) ** 2)
    kernel /= 2 * kernel.sum() - kernel[0]
    return kernel if np.isinf(reach) else kernel * np.maximum(1 - distance / reach, 0)


def _matrix(length: int, kernel: np.ndarray, beyond: float) -> np.ndarray:
    """Return the matrix that convolves a row of `length` pixels with half a kernel."""
    column, tail = np.zeros((2, length))
    column[: len(kernel)] = kernel[:length]
    matrix = scipy.linalg.toeplitz(column)
    outside = (kernel.sum() - kernel.cumsum())[:length]  # share of the kernel farther away than each pixel
    tail[: len(outside)] = beyond * outside
    matrix[0] += tail
    matrix[-1] += tail[::-1]
    return matrix
