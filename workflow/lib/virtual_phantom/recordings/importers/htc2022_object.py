"""Segmentations of the Helsinki Tomography Challenge 2022 to masks of the scanned objects.

The data set's own reconstructions, and so its segmentations, have 512 x 512 pixels of the detector's pitch over the
magnification, row 0 at the top (+y), column 0 at the left (-x), the isocentre in the middle.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from scipy import ndimage
from scipy.io import loadmat

from ...base.errors import InputError
from ...base.geometry import Grid
from ...io.volumes import Volume

VARIABLE = "reconFullFbpSeg"
SMOOTH_PX = 1.0  # standard deviation: evens out the steps of a threshold, shifts an edge of radius r by 1/(2 r) pixels
SLICE_MM = 1.0  # a single slice stands for an object alike along z


def read_object(mat_file: str | Path, scan: dict) -> Volume:
    """The share of every pixel that the object fills.

    A threshold says of every pixel in or out only. Smoothed by a Gaussian, its edge at 1/2 follows the object's to a
    fraction of a pixel; the slope there, 1/(sqrt(2 pi) sigma) per pixel, is steepened to 1 per pixel, that of an edge
    averaged over a pixel. The area stays that of the threshold.

    Parameters
    ----------
    mat_file : str or Path
        A segmentation of the data set.
    scan : dict
        Of the recording.

    Returns
    -------
    Volume
        Shape (1, y, x), float32, 0 to 1.

    Raises
    ------
    InputError
        If the file is missing, broken, or holds no segmentation.
    """
    mat_file = Path(mat_file)
    if not mat_file.is_file():
        raise InputError(f"{mat_file}: no such file; give a segmentation of the HTC 2022 data set (.mat)")
    try:
        content = loadmat(mat_file, variable_names=[VARIABLE])
    except Exception as error:  # scipy raises many types on broken files
        raise InputError(f"{mat_file}: cannot be read as MATLAB v5 ({error}); is the file complete?") from None
    inside = np.asarray(content.get(VARIABLE, ())) > 0
    if inside.ndim != 2 or not inside.any():
        raise InputError(f"{mat_file}: holds no segmentation {VARIABLE}; give a ..._recon_fbp_seg.mat of the data set")
    pixel = scan["column_pitch_mm"] * scan["source_to_isocentre_mm"] / scan["source_to_detector_mm"]
    share = with_partial_pixels(inside)[::-1]
    return Volume(share[None].astype(np.float32), Grid((1, *share.shape), (SLICE_MM, pixel, pixel)))


def with_partial_pixels(inside: np.ndarray) -> np.ndarray:
    """A thresholded mask [row, column] with an edge of one pixel's width along its smoothed outline, 0 to 1."""
    smooth = ndimage.gaussian_filter(inside.astype(float), SMOOTH_PX, mode="nearest")
    return np.clip(0.5 + (smooth - 0.5) * math.sqrt(2 * math.pi) * SMOOTH_PX, 0, 1)
