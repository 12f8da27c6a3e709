"""State of a reconstructed image, which effects of stage "image" change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass
class ImageState:
    """A reconstructed image.

    Attributes
    ----------
    spacing_mm : tuple of 3 float
        Voxel size (z, y, x), mm.
    """

    hu: np.ndarray
    spacing_mm: tuple[float, float, float]
