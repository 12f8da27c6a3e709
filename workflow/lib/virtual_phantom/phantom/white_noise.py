"""White noise on a phantom, as a control of simulated scans."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..base.streams import Stream, generator
from ..io.volumes import Volume


def add_white_noise(
    image: Volume, masks: Mapping[str, np.ndarray], variance: Mapping[str, float], stream: Stream
) -> Volume:
    """Add normal noise with the variance (HU^2) of each ROI, and outside of all ROIs with their mean SD.

    Parameters
    ----------
    masks : mapping of str to ndarray of bool, shape (z, y, x)
        A voxel of several ROIs gets the variance of the last one.
    """
    sd = np.full(image.array.shape, np.mean([np.sqrt(variance[roi]) for roi in masks]))
    for roi, mask in masks.items():
        sd[mask] = np.sqrt(variance[roi])
    noise = sd * generator(stream).standard_normal(image.array.shape)
    return Volume((image.array + noise).astype(np.float32), image.grid)
