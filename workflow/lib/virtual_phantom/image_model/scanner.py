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
from .noise import NoiseModel
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

    def image(
        self,
        region: RegionModel,
        mask: np.ndarray,
        mean_hu: float,
        reconstruction: str,
        dose_mgy: float,
        texture_stream: Stream,
        noise_stream: Stream,
    ) -> np.ndarray:
        """Return an image of a region, HU, float32 [z, y, x], with a given mean inside the mask."""
        sd = math.sqrt(self.dose_law[reconstruction].variance(dose_mgy, region.noise_factor))
        noise = self.noise[reconstruction].sample(mask.shape, self.spacing, noise_stream)
        texture = region.texture(mask, self.spacing, self.blur, texture_stream)
        image = noise * np.float32(sd) + texture * np.float32(1 if reconstruction == FBP else region.contrast)
        return image + np.float32(mean_hu - image[mask].mean())

    def features(
        self,
        region: RegionModel,
        mask: np.ndarray,
        mean_hu: float,
        reconstruction: str,
        dose_mgy: float,
        streams: Iterable[tuple[Stream, Stream]],
    ) -> pd.DataFrame:
        """Return the features (columns) of one image per pair of streams (of texture, of noise)."""
        images = (self.image(region, mask, mean_hu, reconstruction, dose_mgy, *pair) for pair in streams)
        return features_of(images, mask, self.spacing)


def features_of(images: Iterable[np.ndarray], mask: np.ndarray, spacing: tuple[float, ...]) -> pd.DataFrame:
    """Return the 86 features (columns) of a region in each image."""
    grid = Grid(mask.shape, spacing)
    tables = [extract(Volume(image, grid), {"roi": mask}) for image in images]
    return pd.concat(tables, ignore_index=True)[list(FEATURES)]


def stream_pairs(stream: Stream, noises: Iterable[int]) -> Iterator[tuple[Stream, Stream]]:
    """Yield the stream of the texture, which stays the same, and that of a noise realization, by its number."""
    for noise in noises:
        yield below(stream, 0), below(stream, 1, noise)
