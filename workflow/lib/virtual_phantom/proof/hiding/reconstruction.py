"""Images of the proof: filtered back-projection of every voxel's own rays [1]_, by cubic splines.

The library's own reconstruction, which the fits use, rebins rays to parallel ones and interpolates linearly.

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
    """Images of the line integrals of a full circle.

    Parameters
    ----------
    lines : ndarray, shape (views, rows, columns)
        The first view from +y.
    mu_water_per_mm : float
        1/mm.
    blur_mm : float, optional
        Standard deviation of the Gaussian that apodises the ramp, mm.

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
        away = radius + x * np.sin(angle) - (y * np.cos(angle))[:, None]  # from the source, along the central ray
        column = distance / away * (x * np.cos(angle) + (y * np.sin(angle))[:, None]) / scan.column_pitch_mm
        row = distance / away * z[:, None, None] / scan.row_pitch_mm
        places = [row + (scan.rows - 1) / 2, np.broadcast_to(column + (scan.columns - 1) / 2, grid.shape)]
        mu += (radius / away) ** 2 * ndimage.map_coordinates(view, places, order=SPLINE, mode="nearest")
    mu *= np.pi / scan.views
    return (1000 * (mu / mu_water_per_mm - 1)).astype(np.float32)


def ramp(rows: np.ndarray, pitch_mm: float, blur_mm: float) -> np.ndarray:
    """Band-limited ramp along the last axis [1]_, times exp(-2 (pi s f)^2).

    Parameters
    ----------
    rows : ndarray, shape (..., columns)
    pitch_mm : float
        Of the columns, mm.
    blur_mm : float
        s, mm.

    Returns
    -------
    ndarray, shape (..., columns)
        Per mm.

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
