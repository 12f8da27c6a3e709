"""Regions of an object with texture, as a scanner shows them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft

from ..base.streams import Stream, below
from ..phantom.texture import Component, skewed
from ..reconstruction.kernel import Kernel
from .noise import frequencies, gaussian_field, periodic_shape


@dataclass(frozen=True)
class Blur:
    """Blur of an object by a scanner: in-plane MTF exp(-(f / f0)^p), and a Gaussian slice profile along z.

    Attributes
    ----------
    mtf50_per_cm, mtf10_per_cm : float
        Frequencies at which the MTF is 0.5 and 0.1, line pairs per cm.
    slice_sd_mm : float
        Standard deviation of the slice profile.
    """

    mtf50_per_cm: float
    mtf10_per_cm: float
    slice_sd_mm: float

    def apply(self, field: np.ndarray, spacing: tuple[float, ...]) -> np.ndarray:
        """Return a periodic field [z, y, x] after the blur."""
        fz, f = frequencies(field.shape, spacing)
        transfer = Kernel(self.mtf50_per_cm, self.mtf10_per_cm).mtf(f) * np.exp(
            -2 * (np.pi * fz * self.slice_sd_mm) ** 2
        )
        return fft.irfftn(fft.rfftn(field) * transfer.astype(np.float32), s=field.shape)


@dataclass(frozen=True)
class RegionModel:
    """Texture and noise of a region.

    Attributes
    ----------
    noise_factor : float
        Unfiltered noise variance, relative to the uniform region of the dose law (see dose.py).
    fine, coarse : Component
        Components of the texture. `fine` is blurred by the scanner; its sd_hu is that after the blur. `coarse` is too
        wide to be blurred, and has no skewness.
    contrast : float
        Texture of the iterative reconstruction, relative to that of filtered back-projection.
    """

    noise_factor: float
    fine: Component
    coarse: Component
    contrast: float = 1.0

    def texture(self, mask: np.ndarray, spacing: tuple[float, ...], blur: Blur, stream: Stream) -> np.ndarray:
        """Return the texture of filtered back-projection, HU: mean 0 and the given SDs inside the mask [z, y, x]."""
        box = periodic_shape(mask.shape, spacing)
        inside = tuple(slice(0, n) for n in mask.shape)
        coarse = gaussian_field(box, spacing, below(stream, 1), self.coarse.correlation_mm)[inside]
        texture = _scaled(coarse, mask, self.coarse.sd_hu)
        if not self.fine.sd_hu:
            return texture
        gaussian = gaussian_field(box, spacing, below(stream, 0), self.fine.correlation_mm)
        fine = blur.apply(skewed(gaussian, self.fine.skewness), spacing)[inside]
        return texture + _scaled(fine, mask, self.fine.sd_hu)


def _scaled(field: np.ndarray, mask: np.ndarray, sd: float) -> np.ndarray:
    """Return the field with mean 0 and this SD inside the mask."""
    inside = field[mask]
    return (field - inside.mean()) * np.float32(sd / inside.std())
