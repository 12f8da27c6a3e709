"""The largest section of a region as an image of its own, from which features in two dimensions are extracted."""

from __future__ import annotations

import numpy as np

from ..base.geometry import Grid
from ..io.volumes import Volume


def largest_section(image: Volume, mask: np.ndarray, offset_hu: float = 0.0) -> tuple[Volume, np.ndarray]:
    """The slice in which a region has most voxels; the lowest of several.

    Parameters
    ----------
    image : Volume
        HU.
    mask : ndarray of bool, shape (z, y, x)
        Not empty.
    offset_hu : float, optional
        Added to the values: 1024 gives those that scanners store.

    Returns
    -------
    section : Volume
        One slice, cut to the region and a voxel around it. Voxels of 1 mm, as tables of 2D features have them: no
        feature but TotalEnergy depends on it.
    region : ndarray of bool, shape (1, y, x)
    """
    slice_ = int(np.argmax(mask.sum(axis=(1, 2))))
    rows, columns = (np.flatnonzero(mask[slice_].any(axis=axis)) for axis in (1, 0))
    box = slice_, slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    values, region = np.pad(image.array[box], 1) + np.float32(offset_hu), np.pad(mask[box], 1)
    return Volume(values[None].astype(np.float32), Grid((1, *values.shape), (1.0, 1.0, 1.0))), region[None]
