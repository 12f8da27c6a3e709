"""Images of regions as a scanner shows them at a dose, and their features."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ..base.geometry import Grid
from ..base.streams import Stream, below
from ..features.extraction import extract
from ..features.names import FEATURES
from ..io.volumes import Volume
from .dose import DoseLaw
from .noise import NoiseModel, noisy_images
from .region import Blur, RegionModel

FBP = "fbp"


@dataclass(frozen=True)
class ImageScanner:
    """A scanner with its reconstructions, in image space.

    Attributes
    ----------
    spacing : tuple of 3 float
        Voxel size, mm (z, y, x).
    blur : Blur
        Blur of the object in all reconstructions.
    noise : mapping of str to NoiseModel
        By reconstruction.
    dose_law : mapping of str to DoseLaw
        Noise variance of the uniform region, by reconstruction.
    """

    spacing: tuple[float, float, float]
    blur: Blur
    noise: Mapping[str, NoiseModel]
    dose_law: Mapping[str, DoseLaw]

    def images(
        self,
        region: RegionModel,
        mask: np.ndarray,
        mean_hu: float,
        reconstruction: str,
        dose_mgy: float,
        stream: Stream,
        realizations: Iterable[int],
    ) -> Iterator[np.ndarray]:
        """Return images of a region, one for each number in `realizations`.

        Parameters
        ----------
        mask : ndarray of bool, shape (z, y, x)
            Voxels of the region.
        mean_hu : float
            Mean inside the mask.
        stream : Stream
            Random numbers of the texture, which all images share, and of the noise.

        Returns
        -------
        iterator of ndarray of float32, shape (z, y, x)
            HU.
        """
        sd = math.sqrt(self.dose_law[reconstruction].variance(dose_mgy, region.noise_factor))
        contrast = np.float32(1 if reconstruction == FBP else region.contrast)
        texture = region.texture(mask, self.spacing, self.blur, below(stream, 0)) * contrast
        noise = self.noise[reconstruction]
        return noisy_images(texture, noise, sd, mean_hu, mask, self.spacing, below(stream, 1), realizations)

    def features(self, region: RegionModel, mask: np.ndarray, *settings) -> pd.DataFrame:
        """Return the features (columns) of each image that `images` yields for the same arguments."""
        return features_of(self.images(region, mask, *settings), mask, self.spacing)


def features_of(images: Iterable[np.ndarray], mask: np.ndarray, spacing: tuple[float, ...]) -> pd.DataFrame:
    """Return the 86 features (columns) of a region in each image."""
    grid = Grid(mask.shape, spacing)
    tables = [extract(Volume(image, grid), {"roi": mask}) for image in images]
    return pd.concat(tables, ignore_index=True)[list(FEATURES)]
