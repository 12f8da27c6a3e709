"""Regions of an object with texture, as a scanner shows them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft

from ..base.streams import Stream, below
from ..phantom.texture import Component, skewed
from ..reconstruction.kernel import Kernel
from .noise import frequencies, gaussian_field, periodic_shape, slice_transfer


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
        transfer = Kernel(self.mtf50_per_cm, self.mtf10_per_cm).mtf(f) * slice_transfer(fz, self.slice_sd_mm)
        return fft.irfftn(fft.rfftn(field) * transfer.astype(np.float32), s=field.shape)


@dataclass(frozen=True)
class RegionModel:
    """Texture and noise of a region.

    Attributes
    ----------
    noise_factor : float
        Unfiltered noise variance, relative to the uniform region of the dose law (see dose.py).
    fine, coarse : Component
        Components of the texture. The scanner blurs `fine`, whose sd_hu is the SD after the blur. The blur of `coarse`
        is neglected, and its skewness is not used.
    contrast : float
        Amplitude of the texture in iterative reconstructions, relative to filtered back-projection.
    """

    noise_factor: float
    fine: Component
    coarse: Component
    contrast: float = 1.0

    def texture(self, mask: np.ndarray, spacing: tuple[float, ...], blur: Blur, stream: Stream) -> np.ndarray:
        """Return the texture in filtered back-projection, HU [z, y, x]: sum of both components, mean 0 in the mask."""
        texture = gaussian_texture(self.coarse, mask, spacing, below(stream, 1))
        if not self.fine.sd_hu:
            return texture
        box = periodic_shape(mask.shape, spacing)
        gaussian = gaussian_field(box, spacing, below(stream, 0), self.fine.correlation_mm)
        fine = blur.apply(skewed(gaussian, self.fine.skewness), spacing)
        return texture + _scaled(fine, mask, self.fine.sd_hu)


def gaussian_texture(component: Component, mask: np.ndarray, spacing: tuple[float, ...], stream: Stream) -> np.ndarray:
    """Return a component without skewness and blur, HU: mean 0 and the given SD inside the mask [z, y, x]."""
    field = gaussian_field(periodic_shape(mask.shape, spacing), spacing, stream, component.correlation_mm)
    return _scaled(field, mask, component.sd_hu)


def _scaled(field: np.ndarray, mask: np.ndarray, sd: float) -> np.ndarray:
    """Return the part of a periodic field that the mask covers, with mean 0 and this SD inside the mask."""
    field = field[tuple(slice(0, n) for n in mask.shape)]
    inside = field[mask]
    return (field - inside.mean()) * np.float32(sd / inside.std())
