"""Tissue texture: random fields in mm, which do not depend on the grid on which they are sampled.

White noise on a periodic lattice of step l / 2 is filtered in Fourier space. The result is a Gaussian random field g of
unit variance with autocorrelation exp(-r^2 / (2 l^2)), sampled by periodic cubic splines. A point transform gives it
the skewness S: t = (exp(s g) - m) / d, a lognormal of mean 0 and variance 1, with
S = (exp(s^2) + 2) sqrt(exp(s^2) - 1) [1]_.

References
----------
.. [1] Johnson, Kotz and Balakrishnan, Continuous Univariate Distributions 1, 2nd ed., chapter 14.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from scipy.fft import fftfreq, irfftn, rfftfreq, rfftn

from ..base.streams import Stream, generator, named

NODES = 96  # lattice nodes per axis: the field repeats after 48 correlation lengths
STEPS_PER_LENGTH = 2  # lattice nodes per correlation length


@dataclass(frozen=True)
class Component:
    """Parameters of a random field; ValueError if they are out of range.

    Attributes
    ----------
    sd_hu : float
        Standard deviation, HU.
    correlation_mm : float
        Length l of the Gaussian autocorrelation exp(-r^2 / (2 l^2)), before the point transform.
    skewness : float
        From -5 to 5.
    """

    sd_hu: float
    correlation_mm: float
    skewness: float = 0.0

    def __post_init__(self):
        if not (self.sd_hu >= 0 and self.correlation_mm > 0 and abs(self.skewness) <= 5):
            raise ValueError("a texture needs sd_hu >= 0, correlation_mm > 0 and a skewness between -5 and 5")


def lognormal_shape(skewness: float) -> float:
    """Return the parameter s of the lognormal exp(s g) with the skewness |skewness|."""

    def excess(s):
        return (math.exp(s * s) + 2) * math.sqrt(math.expm1(s * s)) - abs(skewness)

    return scipy.optimize.brentq(excess, 0, 1.5) if skewness else 0.0


def skewed(gaussian: np.ndarray, skewness: float) -> np.ndarray:
    """Transform a Gaussian field of mean 0 and variance 1 to one with a skewness (see the module's docstring)."""
    if not skewness:
        return gaussian
    s = lognormal_shape(skewness)
    mean = math.exp(s * s / 2)
    field = (np.exp(s * gaussian) - mean) / (mean * math.sqrt(math.expm1(s * s)))
    return field * math.copysign(1, skewness)


class Field:
    """A random realization of a component."""

    def __init__(self, component: Component, seed: Stream):
        self.component = component
        self.step_mm = component.correlation_mm / STEPS_PER_LENGTH
        self._seed = seed

    @cached_property
    def _nodes(self) -> np.ndarray:
        noise = generator(self._seed).standard_normal((NODES,) * 3)
        k = 2 * np.pi * fftfreq(NODES) * STEPS_PER_LENGTH
        kx = 2 * np.pi * rfftfreq(NODES) * STEPS_PER_LENGTH
        spectrum = rfftn(noise) * np.exp(-(k[:, None, None] ** 2 + k[:, None] ** 2 + kx**2) / 4)
        values = irfftn(spectrum, s=noise.shape)
        return values / values.std()

    def sample(self, z: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the values in HU, float32 [z, y, x], at positions along three axes, mm."""
        values = self._nodes
        for axis in (z, y, x):  # each product removes the first axis of the lattice and appends the sampled axis
            values = np.tensordot(values, self._weights(axis), axes=(0, 1))
        values = skewed(values, self.component.skewness)
        return (values * self.component.sd_hu).astype(np.float32)

    def _weights(self, positions_mm: np.ndarray) -> np.ndarray:
        """Return the weights (positions, nodes) of periodic cubic spline interpolation."""
        ends = np.vstack([np.eye(NODES), np.eye(NODES)[:1]])
        spline = scipy.interpolate.CubicSpline(np.arange(NODES + 1), ends, bc_type="periodic")
        return spline(np.asarray(positions_mm) / self.step_mm % NODES)


class Texture:
    """Sum of the components of a tissue."""

    def __init__(self, components: tuple[Component, ...], name: str, seed: Stream):
        self.components = components
        self._fields = [Field(c, named(seed, name, i)) for i, c in enumerate(components)]
        self._mean, self._gain = 0.0, 1.0
        self._conditions: list = []  # shapes, until the first sample: checks of a layout need none

    def sample(self, z: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the HU to add to the mean of the tissue, float32 [z, y, x], at positions along three axes, mm."""
        while self._conditions:
            self._condition(self._conditions.pop(0))
        return self._sample(z, y, x)

    def _sample(self, z, y, x) -> np.ndarray:
        total = np.zeros((len(z), len(y), len(x)), np.float32)
        for field in self._fields:
            total += field.sample(z, y, x)
        return (total - np.float32(self._mean)) * np.float32(self._gain)

    def condition(self, shape) -> None:
        """Shift and scale the texture so that it has mean 0 and the SD of its components inside the shape.

        Without this, mean and SD of a region of a few correlation lengths would vary with the seed. Both are computed
        at steps of half the shortest correlation length, independent of the grid.
        """
        if self._fields:
            self._conditions.append(shape)

    def _condition(self, shape) -> None:
        step = min(f.step_mm for f in self._fields)
        low, high = shape.bounds_mm()
        z, y, x = (np.arange(low[i], high[i] + step, step) for i in (2, 1, 0))
        inside = self._sample(z, y, x)[shape.level(*np.ix_(z, y, x)) < 0].astype(np.float64)
        target = math.sqrt(sum(c.sd_hu**2 for c in self.components))
        self._mean, self._gain = float(inside.mean()), target / float(inside.std())
