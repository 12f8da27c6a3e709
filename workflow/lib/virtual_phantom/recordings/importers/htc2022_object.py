"""Masks of the scanned objects from the segmentations of the Helsinki Tomography Challenge 2022.

Reconstructions and segmentations of the data set have 512 x 512 pixels. A pixel is the detector pitch divided by the
magnification. Row 0 is at the top (+y), column 0 at the left (-x), and the isocentre is in the middle.
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
SMOOTH_PX = (
    1.0  # standard deviation; smooths the steps of the threshold and shifts an edge of radius r by 1/(2 r) pixels
)
SLICE_MM = 1.0  # arbitrary: the objects are uniform along z


def read_object(mat_file: str | Path, scan: dict) -> Volume:
    """Return the share of every pixel that the object fills.

    The segmentation is a threshold. After smoothing with a Gaussian, the contour at 1/2 follows the edge of the object
    to a fraction of a pixel. The slope there, 1/(sqrt(2 pi) sigma) per pixel, is increased to 1 per pixel, the slope of
    an edge averaged over a pixel. The area of the threshold is preserved.

    Parameters
    ----------
    mat_file : str or Path
        Segmentation of the data set.
    scan : dict
        Scan section of the recording.

    Returns
    -------
    Volume
        Shape (1, y, x), float32, 0 to 1.

    Raises
    ------
    InputError
        If the file is missing, damaged, or contains no segmentation.
    """
    inside = np.asarray(read_mat(Path(mat_file), "segmentation", variable_names=[VARIABLE]).get(VARIABLE, ())) > 0
    if inside.ndim != 2 or not inside.any():
        raise InputError(f"{mat_file}: has no segmentation {VARIABLE}; use a ..._recon_fbp_seg.mat of the data set")
    pixel = scan["column_pitch_mm"] * scan["source_to_isocentre_mm"] / scan["source_to_detector_mm"]
    share = with_partial_pixels(inside)[::-1]
    return Volume(share[None].astype(np.float32), Grid((1, *share.shape), (SLICE_MM, pixel, pixel)))


def read_mat(path: Path, content: str, **options) -> dict:
    """Read a MATLAB v5 file of the data set with scipy.io.loadmat; `content` says in messages what it should contain.

    Raises
    ------
    InputError
        If the file is missing or damaged.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; use a {content} of the HTC 2022 data set (.mat)")
    try:
        return loadmat(path, **options)
    except Exception as error:  # scipy raises many types on damaged files
        raise InputError(f"{path}: cannot be read as MATLAB v5 ({error}); copy the complete file again") from None


def with_partial_pixels(inside: np.ndarray) -> np.ndarray:
    """Return a thresholded mask [row, column] with an edge one pixel wide along its smoothed outline, 0 to 1."""
    smooth = ndimage.gaussian_filter(inside.astype(float), SMOOTH_PX, mode="nearest")
    return np.clip(0.5 + (smooth - 0.5) * math.sqrt(2 * math.pi) * SMOOTH_PX, 0, 1)
