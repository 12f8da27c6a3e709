"""Images of the blind validation: Feldkamp reconstruction along the rays of each voxel [1]_, with cubic splines.

It differs from the library's reconstruction, which rebins to parallel rays and interpolates linearly.

References
----------
.. [1] L. A. Feldkamp, L. C. Davis and J. W. Kress, J. Opt. Soc. Am. A 1, 612, 1984.
"""

from __future__ import annotations

import numpy as np
from scipy import fft, ndimage

from ...base.geometry import Grid
from .xcist import Scan

SPLINE = 3


def images_hu(lines: np.ndarray, scan: Scan, grid: Grid, mu_water_per_mm: float, blur_mm: float = 0.0) -> np.ndarray:
    """Reconstruct the line integrals of a full circle.

    Parameters
    ----------
    lines : ndarray, shape (views, rows, columns)
        The source of the first view is at +y.
    blur_mm : float, optional
        Standard deviation of the Gaussian that apodizes the ramp, mm.

    Returns
    -------
    ndarray of float32, shape (z, y, x)
        HU.
    """
    radius, distance = scan.source_to_isocentre_mm, scan.source_to_detector_mm
    u = (np.arange(scan.columns) - (scan.columns - 1) / 2) * scan.column_pitch_mm
    v = (np.arange(scan.rows) - (scan.rows - 1) / 2) * scan.row_pitch_mm
    weighted = lines * distance / np.sqrt(distance**2 + u**2 + v[:, None] ** 2)
    filtered = ramp(weighted, scan.column_pitch_mm * radius / distance, blur_mm)
    z, y, x = grid.axes_mm()
    mu = np.zeros(grid.shape)
    for angle, view in zip(2 * np.pi * np.arange(scan.views) / scan.views, filtered, strict=True):
        depth = (
            radius + x * np.sin(angle) - (y * np.cos(angle))[:, None]
        )  # distance from the source along the central ray
        column = distance / depth * (x * np.cos(angle) + (y * np.sin(angle))[:, None]) / scan.column_pitch_mm
        row = distance / depth * z[:, None, None] / scan.row_pitch_mm
        positions = [row + (scan.rows - 1) / 2, np.broadcast_to(column + (scan.columns - 1) / 2, grid.shape)]
        mu += (radius / depth) ** 2 * ndimage.map_coordinates(view, positions, order=SPLINE, mode="nearest")
    mu *= np.pi / scan.views
    return (1000 * (mu / mu_water_per_mm - 1)).astype(np.float32)


def ramp(rows: np.ndarray, pitch_mm: float, blur_mm: float) -> np.ndarray:
    """Apply the band-limited ramp filter along the last axis [1]_, times exp(-2 (pi s f)^2).

    Parameters
    ----------
    rows : ndarray, shape (..., columns)
    pitch_mm : float
        Pitch of the columns, mm.
    blur_mm : float
        s, mm.

    Returns
    -------
    ndarray, shape (..., columns)
        1/mm.

    References
    ----------
    .. [1] A. C. Kak and M. Slaney, Principles of Computerized Tomographic Imaging, 1988, equation 61 of chapter 3.
    """
    samples = rows.shape[-1]
    n = fft.next_fast_len(3 * samples)
    offset = np.fft.fftfreq(n, 1 / n)
    odd = offset % 2 == 1
    kernel = np.zeros(n)
    kernel[odd] = -1 / (np.pi * offset[odd] * pitch_mm) ** 2
    kernel[0] = 1 / (4 * pitch_mm**2)
    window = np.exp(-2 * (np.pi * blur_mm * np.fft.rfftfreq(n, pitch_mm)) ** 2)
    return pitch_mm * fft.irfft(fft.rfft(rows, n) * fft.rfft(kernel) * window, n)[..., :samples]
