"""Reconstruction kernels of filtered back-projection, defined by their modulation transfer function (MTF)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import gamma

from ..base.errors import InputError

HALF, TENTH = math.log(2), math.log(10)


@dataclass(frozen=True)
class Kernel:
    """A smooth kernel with the MTF exp(-(f / f0)^p), defined by two points of the MTF.

    For evenly spaced rays, the noise power of an image along any direction is f MTF(f)^2 [1]_.

    Attributes
    ----------
    mtf50_per_cm, mtf10_per_cm : float
        Frequencies at which the MTF is 0.5 and 0.1, line pairs per cm.

    Raises
    ------
    InputError
        If the first is not positive, or not less than the second.

    References
    ----------
    .. [1] S. J. Riederer, N. J. Pelc and D. A. Chesler, Phys. Med. Biol. 23, 446, 1978.
    """

    mtf50_per_cm: float
    mtf10_per_cm: float

    def __post_init__(self):
        if not 0 < self.mtf50_per_cm < self.mtf10_per_cm < math.inf:
            raise InputError(
                f"kernel: its MTF is a half at {self.mtf50_per_cm:g} and a tenth at {self.mtf10_per_cm:g} per cm; give "
                "positive numbers, the first less than the second"
            )

    @property
    def exponent(self) -> float:
        """The exponent p."""
        return math.log(TENTH / HALF) / math.log(self.mtf10_per_cm / self.mtf50_per_cm)

    def mtf(self, cycles_per_mm: np.ndarray) -> np.ndarray:
        """Return the MTF at frequencies in cycles per mm."""
        return np.exp(-HALF * (np.abs(cycles_per_mm) * 10 / self.mtf50_per_cm) ** self.exponent)

    @property
    def noise(self) -> float:
        """Noise variance of an image, per mm^3, up to a common factor: the integral of f^2 MTF(f)^2 from 0."""
        p, f0 = self.exponent, self.mtf50_per_cm / 10 * HALF ** (-1 / self.exponent)
        return f0**3 * gamma(3 / p) / (p * 2 ** (3 / p))

    def window(self, cycles_per_mm: np.ndarray, pitch_mm: float) -> np.ndarray:
        """Return the factor of the ramp filter, at frequencies up to Nyquist, that gives the image this MTF.

        Back-projection interpolates rays linearly, which multiplies the spectrum by sinc(f pitch)^2 on average over
        positions. The window compensates for that. Rebinning fan rays adds a small blur that increases with the
        distance from the isocenter; it is not compensated.
        """
        return self.mtf(cycles_per_mm) / np.sinc(cycles_per_mm * pitch_mm) ** 2


@dataclass(frozen=True)
class ModifiedKernel:
    """A kernel, or None for the ramp filter alone, times a factor of the MTF at frequencies in cycles per mm."""

    kernel: Kernel | None
    factor: Callable[[np.ndarray], np.ndarray]

    def window(self, cycles_per_mm: np.ndarray, pitch_mm: float) -> np.ndarray:
        """As Kernel.window."""
        before = 1.0 if self.kernel is None else self.kernel.window(cycles_per_mm, pitch_mm)
        return before * self.factor(cycles_per_mm)


def modified(
    kernel: Kernel | None, factor: Callable[[np.ndarray], np.ndarray] | None
) -> Kernel | ModifiedKernel | None:
    """Return a kernel times a factor of the MTF; without a factor the kernel itself."""
    return kernel if factor is None else ModifiedKernel(kernel, factor)


@dataclass(frozen=True)
class NoiseKernel:
    """Kernel of the noise alone: a proxy for iterative reconstruction.

    Iterative reconstruction reduces noise and keeps structures. The noise-free part of the projections has the kernel
    of filtered back-projection, and the noise has this one. The proxy preserves structures of any contrast.

    Attributes
    ----------
    kernel : Kernel
        Gives the spectrum of the noise.
    variance : float
        Noise variance relative to filtered back-projection.

    Raises
    ------
    InputError
        If the variance is not positive.
    """

    kernel: Kernel
    variance: float

    def __post_init__(self):
        if not 0 < self.variance < math.inf:
            raise InputError(f"noise_kernel: its variance is {self.variance:g}; give a positive number")

    def gain(self, signal: Kernel) -> float:
        """Return the factor of the noise, so that its variance relative to the kernel `signal` is as given."""
        return math.sqrt(self.variance * signal.noise / self.kernel.noise)
