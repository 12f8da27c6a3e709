"""What repeats of an image say, condensed as those of projections are (projections.observed)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..noise.condensed import Blocks, Observed
from .whitening import Whitening

# Blocks along z, y and x for the noise's variance: of smaller ones few voxels are left that vary on their own.
PARTS = (2, 4, 4)
PRIOR = 8  # realisations that the scatter usual in all blocks counts as
LAGS = ((0, 0, 1), (0, 1, 0), (0, 0, 2), (0, 2, 0), (1, 0, 0))  # z, y, x, voxels


@dataclass(frozen=True)
class ObservedImages(Observed):
    """As Observed, of images.

    `mean` is whitened, `variance` is over `reference` (HU^2), `correlation` by LAGS.

    Attributes
    ----------
    repeats : ndarray, shape (repeats, z, y, x), or None
        HU.
    hu : ndarray, shape (z, y, x), or None
        Mean over the repeats, HU.
    expected : ndarray, shape (z, y, x), or None
        HU without noise, of the model with nothing fitted: it tells tissues and edges apart.
    """

    repeats: np.ndarray | None = None
    hu: np.ndarray | None = None
    expected: np.ndarray | None = None


@dataclass(frozen=True)
class NoiseStatistics:
    """Statistics of noise over the standard deviation of a Whitening.

    Attributes
    ----------
    variance : ndarray, shape (blocks,)
    correlation : ndarray, shape (lags,)
    """

    variance: np.ndarray
    correlation: np.ndarray


class Condenser:
    """Condenses recorded and simulated images alike.

    Parameters
    ----------
    nulls : ndarray, shape (realisations, z, y, x)
        Realisations of noise, HU: how much statistics of one realisation scatter.
    simulated : int
        Realisations that every prediction is made from: their scatter adds to the errors.
    expected : ndarray, shape (z, y, x)
        HU, for ObservedImages.
    """

    def __init__(self, white: Whitening, nulls: np.ndarray, simulated: int, expected: np.ndarray):
        self.white, self.simulated, self.expected = white, simulated, expected
        self.blocks = Blocks.of(white.sd.shape, PARTS)
        self._counts = self.blocks.sum(white.used)
        self._pairs = [_shift_pairs(white.used, lag) for lag in LAGS]
        # Nulls may be louder than the recording: relative scatter is what counts.
        level = float(np.mean([white.over_sd(one)[white.used].var() for one in nulls]))
        each = [self.noise([one / np.sqrt(level)]) for one in nulls]
        variances = np.var([one.variance for one in each], axis=0, ddof=1)
        # Few realisations tell little of one block, and all blocks together what is usual.
        usual = np.nanmedian(variances * self._counts) / np.maximum(self._counts, 1)
        self._variance_sd = np.sqrt((len(nulls) * variances + PRIOR * usual) / (len(nulls) + PRIOR))
        self._correlation_sd = np.std([one.correlation for one in each], axis=0, ddof=1)

    def observe(self, repeats: np.ndarray, usable: np.ndarray) -> ObservedImages:
        """Condense repeats; the variance only of two or more.

        Parameters
        ----------
        repeats : ndarray, shape (repeats, z, y, x)
            HU.
        usable : ndarray of bool, shape (z, y, x)
            Voxels that count in the whitened mean.
        """
        n, mean = len(repeats), repeats.mean(axis=0, dtype=np.float64)
        statistics = variance_error = correlation_error = None
        if n > 1:
            statistics = self.noise([(one - mean) * np.sqrt(n / (n - 1)) for one in repeats])
            free = 1 / (n - 1) + 1 / self.simulated
            # Logarithms of sample variances lie low by half their relative variance, predicted ones too.
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
        )

    def noise(self, realisations) -> NoiseStatistics:
        """Statistics of realisations of noise.

        Parameters
        ----------
        realisations : sequence of ndarray, shape (z, y, x)
            Of mean 0, HU.
        """
        square, products, total = 0.0, np.zeros(len(LAGS)), 0.0
        for one in realisations:
            over = self.white.over_sd(one)
            square = square + over**2
            total += float((over**2).sum())
            for place, (lag, pairs) in enumerate(zip(LAGS, self._pairs, strict=True)):
                products[place] += float((over * np.roll(over, [-step for step in lag], (0, 1, 2)))[pairs].sum())
        with np.errstate(invalid="ignore"):
            variance = self.blocks.sum(square) / (self._counts * len(realisations))
        count = np.array([pairs.sum() for pairs in self._pairs]) * len(realisations)
        mean_square = total / (self.white.used.sum() * len(realisations))
        return NoiseStatistics(variance, products / np.maximum(count, 1) / mean_square)


def _shift_pairs(used: np.ndarray, lag: tuple[int, int, int]) -> np.ndarray:
    """Voxels that count and whose partner a lag further on does, without wrapping round."""
    partner = np.zeros_like(used)
    inner = tuple(slice(0, n - step) for n, step in zip(used.shape, lag, strict=True))
    moved = tuple(slice(step, None) for step in lag)
    partner[inner] = used[moved]
    return used & partner
