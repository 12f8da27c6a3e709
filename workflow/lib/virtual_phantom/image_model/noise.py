"""Noise of reconstructed images as a random field with a given power spectrum.

Filtered back-projection turns white noise of the projections into noise whose power rises with the in-plane frequency f
and falls with the modulation transfer function (MTF) of the kernel [1]_. Slices are averages along z. The power is
proportional to

    (f + c) MTF(f)^2 exp(-(2 pi f_z s)^2)

with a constant c for the noise at low frequencies that interpolation adds, and a Gaussian slice profile of standard
deviation s. Real noise has more outliers than a Gaussian field, as its amplitude varies with the position. The field
is therefore multiplied by exp(m g), with a smooth Gaussian field g.

References
----------
.. [1] S. J. Riederer, N. J. Pelc and D. A. Chesler, Phys. Med. Biol. 23, 446, 1978.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import fft

from ..base.streams import Stream, below, generator
from ..reconstruction.kernel import Kernel

AMPLITUDE_LENGTH_MM = 3.0  # correlation length of g


def periodic_shape(shape: tuple[int, ...], spacing: tuple[float, ...], margin_mm: float = 12.0) -> tuple[int, ...]:
    """Return the shape of a periodic box with a margin, so that opposite sides of a region are independent."""
    return tuple(
        fft.next_fast_len(n + math.ceil(margin_mm / step), real=True) for n, step in zip(shape, spacing, strict=True)
    )


@lru_cache(maxsize=32)
def frequencies(shape: tuple[int, ...], spacing: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return the frequencies along z and in the plane, per mm, of the real Fourier transform of a volume."""
    z, y = (fft.fftfreq(n, step) for n, step in zip(shape[:2], spacing[:2], strict=True))
    x = fft.rfftfreq(shape[2], spacing[2])
    return np.abs(z)[:, None, None].astype(np.float32), np.hypot(y[:, None], x).astype(np.float32)[None]


def slice_transfer(fz: np.ndarray, slice_sd_mm: float) -> np.ndarray:
    """Return the transfer function of a Gaussian slice profile at frequencies along z, per mm."""
    return np.exp(-2 * (np.pi * fz * slice_sd_mm) ** 2)


@lru_cache(maxsize=64)
def white(shape: tuple[int, ...], entropy: int, key: tuple[int, ...]) -> np.ndarray:
    """Return the real Fourier transform of white noise of variance 1; cached, because fits use the same noise again."""
    values = generator(Stream(entropy, spawn_key=key)).standard_normal(shape, dtype=np.float32)
    return fft.rfftn(values)


def filtered(shape: tuple[int, ...], stream: Stream, amplitude: np.ndarray) -> np.ndarray:
    """Return white noise after a filter with this amplitude, scaled to an expected variance of 1."""
    power = np.broadcast_to(amplitude, (*shape[:2], shape[2] // 2 + 1)).astype(np.float64) ** 2
    doubled = power.sum() * 2 - power[..., 0].sum() - (power[..., -1].sum() if shape[2] % 2 == 0 else 0.0)
    field = fft.irfftn(white(shape, stream.entropy, tuple(stream.spawn_key)) * amplitude, s=shape)
    return field / np.float32(math.sqrt(doubled / np.prod(shape)))


@dataclass(frozen=True)
class NoiseModel:
    """Noise of one reconstruction.

    Attributes
    ----------
    mtf50_per_cm, mtf10_per_cm : float
        Frequencies at which the MTF is 0.5 and 0.1, line pairs per cm.
    low_frequency_per_cm : float
        The constant c.
    slice_sd_mm : float
        Standard deviation s of the slice profile.
    log_amplitude_sd : float
        The factor m.
    """

    mtf50_per_cm: float
    mtf10_per_cm: float
    low_frequency_per_cm: float
    slice_sd_mm: float
    log_amplitude_sd: float = 0.0

    def amplitude(self, shape: tuple[int, ...], spacing: tuple[float, ...]) -> np.ndarray:
        """Return the square root of the noise power at each frequency of a volume, up to a constant factor."""
        fz, f = frequencies(shape, spacing)
        in_plane = np.sqrt(f + self.low_frequency_per_cm / 10) * Kernel(self.mtf50_per_cm, self.mtf10_per_cm).mtf(f)
        return (in_plane * slice_transfer(fz, self.slice_sd_mm)).astype(np.float32)

    def sample(self, shape: tuple[int, ...], spacing: tuple[float, ...], stream: Stream) -> np.ndarray:
        """Return a field of mean 0 and an expected variance of 1, float32 [z, y, x], spacing in mm."""
        box = periodic_shape(shape, spacing)
        inside = tuple(slice(0, n) for n in shape)
        field = filtered(box, below(stream, 0), self.amplitude(box, spacing))[inside]
        if self.log_amplitude_sd:
            field = field * self._local_amplitude(box, spacing, below(stream, 1))[inside]
        return field

    def _local_amplitude(self, box: tuple[int, ...], spacing: tuple[float, ...], stream: Stream) -> np.ndarray:
        """Return exp(m g) / sqrt(E exp(2 m g)), so that the variance stays 1."""
        smooth = gaussian_field(box, spacing, stream, AMPLITUDE_LENGTH_MM)
        return np.exp(self.log_amplitude_sd * smooth - self.log_amplitude_sd**2)


def gaussian_field(
    box: tuple[int, ...], spacing: tuple[float, ...], stream: Stream, correlation_mm: float
) -> np.ndarray:
    """Return a periodic Gaussian field of variance 1 and autocorrelation exp(-r^2 / (2 correlation_mm^2))."""
    fz, f = frequencies(box, spacing)
    amplitude = np.exp(-((np.pi * correlation_mm) ** 2) * (fz**2 + f**2))
    return filtered(box, stream, amplitude)


def noisy_images(
    texture: np.ndarray,
    noise: NoiseModel,
    sd_hu: float,
    mean_hu: float,
    mask: np.ndarray,
    spacing: tuple[float, ...],
    stream: Stream,
    realizations: Iterable[int],
) -> Iterator[np.ndarray]:
    """Yield images of a texture, one per noise realization, HU, float32 [z, y, x], with a given mean in the mask."""
    for number in realizations:
        image = noise.sample(mask.shape, spacing, below(stream, number)) * np.float32(sd_hu) + texture
        yield image + np.float32(mean_hu - image[mask].mean())
