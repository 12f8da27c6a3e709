"""The repeats of a recording, condensed to what fits and tests ask for.

That is the mean, and how noisy and how correlated they are: of rays or of voxels, along three axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .prediction import Prediction
from .whitening import Whitening

FEWEST = 8  # degrees of freedom from which on the mean of an inverse says anything


@dataclass(frozen=True)
class Blocks:
    """A division of rays or voxels into blocks along three axes.

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
        """Divide data of a shape into so many parts along each axis, or as many as there are places."""
        parts = tuple(min(part, n) for part, n in zip(parts, shape, strict=True))
        axes = [np.arange(n) * part // n for part, n in zip(parts, shape, strict=True)]
        index = (axes[0][:, None, None] * parts[1] + axes[1][:, None]) * parts[2] + axes[2]
        return cls(index, int(np.prod(parts)), parts)

    def sum(self, array: np.ndarray) -> np.ndarray:
        """Sums over every block, shape (blocks,)."""
        return np.bincount(self.index.ravel(), np.broadcast_to(array, self.index.shape).ravel(), self.count)

    def spread(self, values: np.ndarray) -> np.ndarray:
        """Values of blocks, shape (blocks,), given to all that lie in them."""
        return values[self.index]


@dataclass(frozen=True)
class Observed:
    """The condensed repeats.

    Attributes
    ----------
    mean : ndarray
        Along three axes, of views, rows and columns or of slices, rows and columns.
    n : int
        Number of repeats.
    usable : ndarray of bool
        Rays or voxels that count.
    reference : ndarray
        What `variance` is over, shaped as the mean.
    variance : ndarray, shape (blocks,), or None
        Mean of the sample variance over `reference`, so scaled that its logarithm is unbiased; None of a single repeat.
    variance_error : ndarray, shape (blocks,), or None
        Standard error of its logarithm, as sums over many blocks have it: of noise that neighbours share, those of
        blocks side by side vary together.
    correlation, correlation_error : ndarray, shape (pairs,), or None
        Of neighbours, and its standard error; missing ones are NaN.
    numerical : tuple of ndarray
        Distortions alike in many rays by which predictions may be off (one standard deviation), whitened, each shaped
        as the mean.
    alone : ndarray, shape (blocks,), or float
        Variance of a single block's logarithm over the square of `variance_error`.
    whitening : Whitening or None
        What makes the mean's noise white; None where it is.
    weighed : ndarray, shape (blocks,), or float
        Relative variance of the mean's weights, which are measured block by block.
    coarser : Blocks or None
        Blocks of which the variance is known over each other, and nothing of its level; None: it is known of `blocks`.
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
    weighed: np.ndarray | float = 0.0
    coarser: Blocks | None = None

    @property
    def noise_blocks(self) -> Blocks:
        """Blocks of which the variance is known."""
        return self.blocks if self.coarser is None else self.coarser

    def whitened(self, residual: np.ndarray) -> np.ndarray:
        """A residual of the mean, its noise made white."""
        return residual if self.whitening is None else self.whitening(residual)

    def as_recorded(self, whitened: np.ndarray) -> np.ndarray:
        """A whitened residual as it was."""
        return whitened if self.whitening is None else self.whitening.inverse(whitened)

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of what is known of the data, in the order of residuals and weights."""
        return ("mean",) if self.variance is None else ("mean", "noise variance", "noise correlation")

    def residuals(self, prediction: Prediction) -> list[np.ndarray]:
        """Observed less predicted, by part; the mean's noise made white."""
        found = [self.whitened(np.where(self.usable, self.mean - prediction.mean, 0)).ravel()]
        if self.variance is not None:
            found.append(self._of_variance(prediction))
            found.append(np.nan_to_num(self.correlation - prediction.correlation))
        return found

    def _of_variance(self, prediction: Prediction) -> np.ndarray:
        """Logarithm of the observed variance less the predicted one, shape (blocks,)."""
        left = np.log(self.variance) - prediction.log_variance
        known = np.isfinite(left)
        left = np.where(known, left, 0.0)
        if self.coarser is None:
            return left
        weight = np.where(known, self.variance_error, np.inf) ** -2
        return np.where(known, left - (weight @ left) / weight.sum(), 0.0)

    def weights(self, variance: np.ndarray, floor: np.ndarray) -> list[np.ndarray]:
        """Inverse variances of the parts of `residuals`, 0 for what is not there.

        Parameters
        ----------
        variance : ndarray
            Of the mean's data of one repeat, whitened, along three axes.
        floor : ndarray
            Numerical error of the prediction, whitened, standard deviation, along three axes.

        Returns
        -------
        list of ndarray, shape (data,)
        """
        found = [np.where(self.counted, 1 / (variance / self.n + floor**2), 0).ravel()]
        if self.variance is not None:
            for error in (self.variance_error, self.correlation_error):
                with np.errstate(divide="ignore", invalid="ignore"):
                    found.append(np.nan_to_num(1 / error**2, posinf=0.0))
            found[1][~np.isfinite(self.variance)] = 0
        return found

    @property
    def scatter(self) -> np.ndarray:
        """Relative variance of the weight of every datum, or of all of them alike."""
        weighed = np.asarray(self.weighed)
        return self.blocks.spread(weighed) if weighed.ndim else weighed

    @property
    def counted(self) -> np.ndarray:
        """What is usable and counts in the mean: whitening takes away those beside missing ones."""
        return self.usable if self.whitening is None else self.whitening.counted
