"""What effects on images change. Apart from `image`: every start of the workflow reads the effects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass
class ImageState:
    """What effects change.

    Attributes
    ----------
    hu : ndarray of float, shape (z, y, x)
        HU.
    spacing_mm : tuple of 3 float
        Voxels (z, y, x), mm, that effects go by.
    """

    hu: np.ndarray
    spacing_mm: tuple[float, float, float]
