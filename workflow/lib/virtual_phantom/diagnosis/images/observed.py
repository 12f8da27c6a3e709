"""Repeats of an image, condensed to the same kinds of statistics as projections (projections.observed)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from scipy import ndimage

from ...physics.image_state import ImageState
from ..noise.condensed import Blocks, Observed
from ..noise.gain_pattern import Pattern, estimate
from .whitening import ImageWhitening

# Blocks along z, y and x for the variance of the noise. Smaller blocks have few independent voxels.
PARTS = (2, 4, 4)
PRIOR = 8  # weight of the common scatter of all blocks, in realizations
RING_EDGE_HU, RING_EDGE_PX = 50.0, 3  # change of the mean HU of a ring to the next, and rings that it influences
LAGS = ((0, 0, 1), (0, 1, 0), (0, 0, 2), (0, 2, 0), (1, 0, 0))  # z, y, x, voxels


@dataclass(frozen=True)
class ObservedImages(Observed):
    """Observed images.

    `mean` is whitened, `variance` is over `reference` (HU^2), `correlation` by LAGS.

    Attributes
    ----------
    repeats : ndarray, shape (repeats, z, y, x), or None
        HU.
    hu : ndarray, shape (z, y, x), or None
        Mean over the repeats, HU.
    expected : ndarray, shape (z, y, x), or None
        HU without noise, of the model before fits, to define tissues and edges.
    white : ImageWhitening or None
        Transform that made `mean`.
    rings : ndarray of int, shape (y, x), or None
        Number of each voxel's ring about the isocenter.
    """

    repeats: np.ndarray | None = None
    hu: np.ndarray | None = None
    expected: np.ndarray | None = None
    white: ImageWhitening | None = None
    rings: np.ndarray | None = None
    of_pixels: ClassVar[bool] = False

    def pattern(self, residual: np.ndarray, weight: np.ndarray, smooth: bool = False, per_constant=None) -> Pattern:
        """Estimate rings in whitened residuals; the RMS is in HU."""
        found = estimate(residual, weight, sums=self.pattern_sums, smooth=smooth)
        if not found.rms:
            return found
        # Over voxels, of the estimates and of their shrinkage; inner rings are stronger and have few voxels.
        field, variance = (np.where(self.usable, self.pattern_field(of), 0) for of in (found.values, found.variance))
        shrunk = (field**2).sum() / ((field**2).sum() + variance.sum())
        rms = float(np.sqrt((self.white.inverse(field)[self.usable] ** 2).mean() / shrunk))
        return replace(found, rms=rms, error=found.error * rms / found.rms)

    def pattern_sums(self, values: np.ndarray) -> np.ndarray:
        """Return sums over the voxels of rings; 0 next to an edge of the object, whose errors look like rings."""
        return self._over_rings(values) * self._away_from_edges

    def _over_rings(self, values: np.ndarray) -> np.ndarray:
        """Return sums over the voxels of every ring, shape (slices, rings)."""
        return np.stack([np.bincount(self.rings.ravel(), one.ravel()) for one in values])

    @cached_property
    def _away_from_edges(self) -> np.ndarray:
        """Return the rings without an edge of the object along the ring, bool, shape (slices, rings)."""
        count = np.maximum(self._over_rings(np.ones(self.expected.shape)), 1)
        mean = self._over_rings(self.expected) / count
        within = np.sqrt(np.maximum(self._over_rings(self.expected**2) / count - mean**2, 0))
        change = np.abs(np.diff(mean, axis=1, append=mean[:, -1:]))
        edge = (change > RING_EDGE_HU) & (change > within)
        return ~ndimage.binary_dilation(edge, np.ones((1, 2 * RING_EDGE_PX + 1)))

    def pattern_field(self, constants: np.ndarray) -> np.ndarray:
        """Return the constant of every voxel's ring, shape (z, y, x). A whitened ring consists of rings, too."""
        return constants[:, self.rings]


@dataclass(frozen=True)
class NoiseStatistics:
    """Variance by block and correlation by lag of noise that is divided by ImageWhitening.sd."""

    variance: np.ndarray
    correlation: np.ndarray


class Condenser:
    """Condenses recorded and simulated images in the same way.

    Parameters
    ----------
    nulls : ndarray, shape (realizations, z, y, x), or None
        Noise, HU, for the scatter of the statistics of one realization; None: statistics of the noise are not data.
    simulated : int
        Realizations of each prediction, whose scatter adds to the errors.
    expected : ndarray, shape (z, y, x)
        See ObservedImages.
    """

    def __init__(self, white: ImageWhitening, nulls: np.ndarray | None, simulated: int, expected: np.ndarray):
        self.white, self.simulated, self.expected = white, simulated, expected
        self.blocks, self._of_noise = Blocks.of(white.sd.shape, PARTS), nulls is not None
        if nulls is None:
            return
        self._counts = self.blocks.sum(white.used)
        self._pairs = [_shift_pairs(white.used, lag) for lag in LAGS]
        # Only relative scatter is used, because the noise level of the nulls may differ from the recording.
        level = float(np.mean([white.over_sd(null)[white.used].var() for null in nulls]))
        each = [self.noise([null / np.sqrt(level)]) for null in nulls]
        variances = np.var([null.variance for null in each], axis=0, ddof=1)
        # Few realizations give an uncertain scatter for one block, but a good one for all blocks.
        usual = np.nanmedian(variances * self._counts) / np.maximum(self._counts, 1)
        self._variance_sd = np.sqrt((len(nulls) * variances + PRIOR * usual) / (len(nulls) + PRIOR))
        self._correlation_sd = np.std([null.correlation for null in each], axis=0, ddof=1)

    def observe(self, repeats: np.ndarray, usable: np.ndarray) -> ObservedImages:
        """Condense repeats; the variance needs at least two.

        Parameters
        ----------
        repeats : ndarray, shape (repeats, z, y, x)
            HU.
        usable : ndarray of bool, shape (z, y, x)
            Voxels that count in the whitened mean.
        """
        n, mean = len(repeats), repeats.mean(axis=0, dtype=np.float64)
        statistics = variance_error = correlation_error = None
        if n > 1 and self._of_noise:
            statistics = self.noise([(repeat - mean) * np.sqrt(n / (n - 1)) for repeat in repeats])
            free = 1 / (n - 1) + 1 / self.simulated
            # Logarithms of sample variances are low by half their relative variance, predicted ones too.
            unbiased = np.exp(self._variance_sd**2 / 2 * (1 / (n - 1) - 1 / self.simulated))
            variance_error, correlation_error = (sd * np.sqrt(free) for sd in (self._variance_sd, self._correlation_sd))
        return ObservedImages(
            mean=self.white(mean),
            n=n,
            usable=usable & self.white.used,
            blocks=self.blocks,
            reference=self.white.sd**2,
            variance=None if statistics is None else statistics.variance * unbiased,
            variance_error=variance_error,
            correlation=None if statistics is None else statistics.correlation,
            correlation_error=correlation_error,
            repeats=repeats,
            hu=mean,
            expected=self.expected,
            white=self.white,
            rings=ImageState(mean, (1.0, 1.0, 1.0)).rings,
        )

    def noise(self, realizations) -> NoiseStatistics:
        """Return the statistics of realizations of noise, HU with mean 0, each of shape (z, y, x)."""
        square, products, total = 0.0, np.zeros(len(LAGS)), 0.0
        for realization in realizations:
            over = self.white.over_sd(realization)
            square = square + over**2
            total += float((over**2).sum())
            for index, (lag, pairs) in enumerate(zip(LAGS, self._pairs, strict=True)):
                products[index] += float((over * np.roll(over, [-step for step in lag], (0, 1, 2)))[pairs].sum())
        with np.errstate(invalid="ignore"):
            variance = self.blocks.sum(square) / (self._counts * len(realizations))
        count = np.array([pairs.sum() for pairs in self._pairs]) * len(realizations)
        mean_square = total / (self.white.used.sum() * len(realizations))
        return NoiseStatistics(variance, products / np.maximum(count, 1) / mean_square)


def _shift_pairs(used: np.ndarray, lag: tuple[int, int, int]) -> np.ndarray:
    """Return voxels that count and whose partner at this lag counts too, without wrap-around."""
    partner = np.zeros_like(used)
    inner = tuple(slice(0, n - step) for n, step in zip(used.shape, lag, strict=True))
    moved = tuple(slice(step, None) for step in lag)
    partner[inner] = used[moved]
    return used & partner
