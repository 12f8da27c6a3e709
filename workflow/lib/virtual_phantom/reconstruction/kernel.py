"""Reconstruction kernels: a ramp, apodised so that the image has a given modulation transfer function (MTF)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import gamma

from ..base.errors import InputError

HALF, TENTH = math.log(2), math.log(10)


@dataclass(frozen=True)
class Kernel:
    """A smooth kernel by two points of its MTF, which is exp(-(f / f0)^p) through both.

    The noise power of an image of evenly spread rays is f MTF(f)^2 along any direction [1]_.

    Attributes
    ----------
    mtf50_per_cm, mtf10_per_cm : float
        Where the MTF is a half and a tenth, line pairs per cm.

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
        """What p is."""
        return math.log(TENTH / HALF) / math.log(self.mtf10_per_cm / self.mtf50_per_cm)

    def mtf(self, cycles_per_mm: np.ndarray) -> np.ndarray:
        """The MTF at these frequencies, per mm."""
        return np.exp(-HALF * (np.abs(cycles_per_mm) * 10 / self.mtf50_per_cm) ** self.exponent)

    @property
    def noise(self) -> float:
        """The variance of an image's noise but for what all kernels share: the integral of f^2 MTF(f)^2 from 0 on.

        Returns
        -------
        float
            Per mm cubed.
        """
        p, f0 = self.exponent, self.mtf50_per_cm / 10 * HALF ** (-1 / self.exponent)
        return f0**3 * gamma(3 / p) / (p * 2 ** (3 / p))

    def window(self, cycles_per_mm: np.ndarray, pitch_mm: float) -> np.ndarray:
        """What the ramp is multiplied by, so that the image has the MTF.

        Back-projection interpolates rays linearly, which multiplies the spectrum by sinc(f pitch)^2 on average over
        places: that is taken out. Sorting fan rays into parallel ones blurs a little more, the more the farther from
        the isocentre, and none beside it.

        Parameters
        ----------
        cycles_per_mm : ndarray
            Up to the Nyquist frequency of the samples.
        pitch_mm : float
            From sample to sample.
        """
        return self.mtf(cycles_per_mm) / np.sinc(cycles_per_mm * pitch_mm) ** 2
