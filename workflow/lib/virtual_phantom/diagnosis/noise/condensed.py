"""Repeats of a recording condensed to mean, variance and correlations, of rays or voxels along three axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from .gain_pattern import Pattern, estimate, over_views
from .whitening import Whitening

FEWEST = 8  # least degrees of freedom for a reliable mean of an inverse variance


@dataclass(frozen=True)
class Blocks:
    """Division of rays or voxels into blocks along three axes.

    Attributes
    ----------
    index : ndarray of int
        Number of the block, along the three axes.
    shape : tuple of 3 int
        Blocks along each axis.
    """

    index: np.ndarray
    count: int
    shape: tuple[int, int, int]

    @classmethod
    def of(cls, shape: tuple[int, int, int], parts: tuple[int, int, int]) -> Blocks:
        """Divide data of a shape into the given number of parts along each axis, at most one per position."""
        parts = tuple(min(part, n) for part, n in zip(parts, shape, strict=True))
        axes = [np.arange(n) * part // n for part, n in zip(parts, shape, strict=True)]
        index = (axes[0][:, None, None] * parts[1] + axes[1][:, None]) * parts[2] + axes[2]
        return cls(index, int(np.prod(parts)), parts)

    def bounds(self, axis: int) -> list[int]:
        """Return the first position of every block along an axis, followed by the number of positions."""
        length, parts = self.index.shape[axis], self.shape[axis]
        return [-(-length * part // parts) for part in range(parts + 1)]

    def sum(self, array: np.ndarray) -> np.ndarray:
        """Return sums over every block, shape (blocks,)."""
        return np.bincount(self.index.ravel(), np.broadcast_to(array, self.index.shape).ravel(), self.count)

    def spread(self, values: np.ndarray) -> np.ndarray:
        """Return the value of each datum's block, for values of shape (blocks,)."""
        return values[self.index]


@dataclass(frozen=True)
class Prediction:
    """Prediction of the condensed data.

    Attributes
    ----------
    mean : ndarray
        Along the data's three axes.
    log_variance : ndarray, shape (blocks,)
        Logarithm of the variance over Observed.reference.
    correlation : ndarray, shape (pairs,), or None
        None if the data have no correlations.
    design : tuple of 2 ndarray
        Change of the mean per unit of density scale and air offset, broadcastable to it.
    """

    mean: np.ndarray
    log_variance: np.ndarray
    correlation: np.ndarray | None
    design: tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Observed:
    """Condensed repeats.

    Attributes
    ----------
    mean : ndarray
        Along views, rows and columns, or slices, rows and columns.
    n : int
        Number of repeats.
    usable : ndarray of bool
        Rays or voxels that are used.
    reference : ndarray
        Unit of `variance`, shaped as the mean.
    variance : ndarray, shape (blocks,), or None
        Mean sample variance over `reference`, scaled so that its logarithm is unbiased; None for a single repeat.
    variance_error : ndarray, shape (blocks,), or None
        Standard error of its logarithm, for sums over many blocks: correlated noise makes neighboring blocks vary
        together.
    correlation, correlation_error : ndarray, shape (pairs,), or None
        Correlation of neighbors, and its standard error; NaN where missing.
    numerical : tuple of ndarray
        Errors of predictions common to many rays, one standard deviation, whitened, shaped as the mean.
    alone : ndarray, shape (blocks,), or float
        Variance of the logarithm of a single block's variance, over the square of `variance_error`.
    whitening : Whitening or None
        Filter that makes the mean's noise white; None: it is white.
    block_weight_variance : ndarray, shape (blocks,), or float
        Relative variance of the mean's weights, which are measured by block.
    coarser : Blocks or None
        Blocks for which only the relative variance is known; None: the variance of `blocks` is known absolutely.
    """

    mean: np.ndarray
    n: int
    usable: np.ndarray
    blocks: Blocks
    reference: np.ndarray
    variance: np.ndarray | None
    variance_error: np.ndarray | None
    correlation: np.ndarray | None
    correlation_error: np.ndarray | None
    numerical: tuple[np.ndarray, ...] = ()
    alone: np.ndarray | float = 1.0
    whitening: Whitening | None = None
    block_weight_variance: np.ndarray | float = 0.0
    coarser: Blocks | None = None
    of_pixels: ClassVar[bool] = True  # whether a pattern has a constant for each pixel

    @property
    def noise_blocks(self) -> Blocks:
        """Blocks of which the variance is known."""
        return self.blocks if self.coarser is None else self.coarser

    def whitened(self, change: np.ndarray) -> np.ndarray:
        """Whiten a change of the mean, with 0 for data that are not used."""
        used = np.where(self.usable, change, 0)
        return used if self.whitening is None else self.whitening(used)

    def as_recorded(self, whitened: np.ndarray) -> np.ndarray:
        """Undo the whitening of a residual."""
        return whitened if self.whitening is None else self.whitening.inverse(whitened)

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the parts of the data, in the order of residuals and weights."""
        return ("mean",) if self.variance is None else ("mean", "noise variance", "noise correlation")

    def pattern(
        self, residual: np.ndarray, weight: np.ndarray, smooth: bool = False, per_constant: np.ndarray | None = None
    ) -> Pattern:
        """Estimate a pattern of pixels in residuals of the mean; arguments as `gain_pattern.estimate`."""
        return estimate(residual, weight, self.whitening, self.pattern_sums, smooth, per_constant)

    def pattern_sums(self, values: np.ndarray) -> np.ndarray:
        """Return sums over the data that share a constant of a gain pattern."""
        return over_views(values)

    def pattern_field(self, constants: np.ndarray) -> np.ndarray:
        """Return the constants of a gain pattern, broadcastable to the mean."""
        return constants

    def residuals(self, prediction: Prediction) -> list[np.ndarray]:
        """Return observed minus predicted data, by part; the mean's noise is whitened."""
        found = [self.whitened(self.mean - prediction.mean).ravel()]
        if self.variance is not None:
            found.append(self._of_variance(prediction))
            found.append(np.nan_to_num(self.correlation - prediction.correlation))
        return found

    def _of_variance(self, prediction: Prediction) -> np.ndarray:
        """Return the logarithm of observed over predicted variance, shape (blocks,)."""
        left = np.log(self.variance) - prediction.log_variance
        known = np.isfinite(left)
        left = np.where(known, left, 0.0)
        if self.coarser is None:
            return left
        weight = np.where(known, self.variance_error, np.inf) ** -2
        return np.where(known, left - (weight @ left) / weight.sum(), 0.0)

    def weights(self, variance: np.ndarray, floor: np.ndarray) -> list[np.ndarray]:
        """Return inverse variances of the parts of `residuals`, shape (data,); 0 for missing data.

        Parameters
        ----------
        variance, floor : ndarray
            Variance of one repeat, and numerical error of predictions (standard deviation), whitened, along three axes.
        """
        found = [np.where(self.counted, 1 / (variance / self.n + floor**2), 0).ravel()]
        if self.variance is not None:
            for error in (self.variance_error, self.correlation_error):
                with np.errstate(divide="ignore", invalid="ignore"):
                    found.append(np.nan_to_num(1 / error**2, posinf=0.0))
            found[1][~np.isfinite(self.variance)] = 0
        return found

    @property
    def weight_variance(self) -> np.ndarray:
        """Relative variance of each datum's weight, or one number for all."""
        of_blocks = np.asarray(self.block_weight_variance)
        return self.blocks.spread(of_blocks) if of_blocks.ndim else of_blocks

    @property
    def counted(self) -> np.ndarray:
        """Usable data with weight in the mean; whitening excludes data next to missing ones."""
        return self.usable if self.whitening is None else self.whitening.counted
