"""State of a reconstructed image, which effects of stage "image" change."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy


@dataclass
class ImageState:
    """A reconstructed image, whose center is the isocenter.

    Attributes
    ----------
    hu : ndarray, shape (z, y, x)
    spacing_mm : tuple of 3 float
        Voxel size (z, y, x), mm.
    before_filter, after_filter : ndarray, shape (z, y, x), or None
        Images from the same line integrals without and with the filter among the effects (Effect.mtf); None if only
        the image is known.
    """

    hu: np.ndarray
    spacing_mm: tuple[float, float, float]
    before_filter: np.ndarray | None = None
    after_filter: np.ndarray | None = None

    def filter(self, mtf: Callable[[np.ndarray], np.ndarray]) -> None:
        """Multiply the in-plane spectrum by a factor, given in-plane frequencies in cycles per mm.

        Only changes since the reconstruction are filtered in the image if it is known with the filter.
        """
        known = self.after_filter is not None
        image = self.hu - self.before_filter if known else self.hu
        # The cosine transform implies mirrored boundaries. A sampled kernel narrower than a voxel would have no effect.
        plane = zip(image.shape[1:], self.spacing_mm[1:], strict=True)
        rows, columns = (np.arange(n) / (2 * n * pixel) for n, pixel in plane)
        factor = mtf(np.hypot(rows[:, None], columns)).astype(image.dtype)
        filtered = scipy.fft.idctn(scipy.fft.dctn(image, axes=(1, 2)) * factor, axes=(1, 2))
        self.hu = self.after_filter + filtered if known else filtered

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
