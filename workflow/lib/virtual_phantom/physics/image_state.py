"""State of a reconstructed image, which effects of stage "image" change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass
class ImageState:
    """A reconstructed image, whose center is the isocenter.

    Attributes
    ----------
    hu : ndarray, shape (z, y, x)
    spacing_mm : tuple of 3 float
        Voxel size (z, y, x), mm.
    """

    hu: np.ndarray
    spacing_mm: tuple[float, float, float]

    @property
    def y_mm(self) -> np.ndarray:
        """Positions of the rows."""
        return self._positions(1)

    @property
    def x_mm(self) -> np.ndarray:
        """Positions of the columns."""
        return self._positions(2)

    @property
    def radius_mm(self) -> np.ndarray:
        """Distances from the axis of rotation, shape (y, x)."""
        return np.hypot(self.y_mm[:, None], self.x_mm)

    @property
    def rings(self) -> np.ndarray:
        """Number of the ring about the axis of rotation, as wide as a pixel, shape (y, x)."""
        return (self.radius_mm / min(self.spacing_mm[1:])).astype(int)

    def _positions(self, axis: int) -> np.ndarray:
        count = self.hu.shape[axis]
        return (np.arange(count) - (count - 1) / 2) * self.spacing_mm[axis]
