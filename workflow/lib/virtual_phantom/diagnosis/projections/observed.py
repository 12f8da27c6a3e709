"""Repeats of a scan, condensed to statistics with known errors.

With these, effects on the noise are fitted like effects on the mean:

* mean: line integral of every ray, over repeats
* variance: logarithm of the sample variance over repeats, relative to a first model, by block of rays
* correlation: of differences of repeats, between neighboring columns, rows and views
* white: smooth shape of the white field
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.polynomial import legendre
from scipy import special

from ...base.errors import InputError
from ..noise.condensed import Blocks, Observed
from ..noise.whitening import WHITE, Correlations

PARTS = (12, 4, 8)  # blocks along views, rows and columns
LEAST_TRANSMISSION = 1e-5  # rays with less are not used
VIEW_PARTS = (12, 1, 1)  # blocks for the relative noise variance of a single repeat
NOISE_OF_VIEWS = 0.03  # relative error of the modeled noise variance between views, for a single repeat
MEDIAN_SQUARE = 0.45494  # median of chi-square with one degree of freedom
VARIANCE_OF_MEAN, VARIANCE_OF_MEDIAN = 2.0, 5.443  # relative, of n squares of normal noise, times n
ENOUGH_FOR_MEDIAN = 500  # rays of a block; the relative SD of the median is then 10 %, of the mean 6 %
PLATEAU = 0.001  # share of rays that have the highest signal by chance, as integer counts in air repeat
WHITE_COLUMNS, WHITE_ROWS = 4, 2  # highest orders of the white field's shape
FEW_PIXELS = 3  # up to this number along an axis, only the outermost pixels determine the white field's curvature
WHITE_TOLERANCE = 0.005  # SD of the coefficients of the white field, from sensitivities that vary smoothly


@dataclass(frozen=True)
class Scans:
    """Repeats of one scan as line integrals.

    Attributes
    ----------
    repeats : ndarray of float32, shape (repeats, views, rows, columns)
    white : ndarray, shape (rows, columns), or None
        Mean counts without an object; None for recordings of line integrals.
    usable : ndarray of bool, shape (views, rows, columns)
        Rays with a signal in every repeat.
    """

    repeats: np.ndarray
    white: np.ndarray | None
    usable: np.ndarray

    def __len__(self) -> int:
        return len(self.repeats)

    def every(self, step: int) -> Scans:
        """Return every `step`-th view."""
        return self if step == 1 else replace(self, repeats=self.repeats[:, ::step], usable=self.usable[::step])


def scans(acquisitions) -> Scans:
    """Read the repeats of a recording of projections (recordings.projections.Projections)."""
    arrays, usable, whites = [], None, []
    for acquisition in acquisitions:
        array = acquisition.line_integrals(LEAST_TRANSMISSION)
        good = np.isfinite(array)
        if not acquisition.log:
            good &= array < -np.log(LEAST_TRANSMISSION) * 0.999
            whites.append(acquisition.white - acquisition.dark)
        good &= ~saturated(-array if acquisition.log else acquisition.data)
        arrays.append(np.where(good, array, 0).astype(np.float32))
        usable = good if usable is None else usable & good
    return Scans(np.stack(arrays), np.mean(whites, axis=0) if whites else None, usable)


def saturated(signal: np.ndarray) -> np.ndarray:
    """Return the rays with the highest signal, if there are more of them than noise explains; otherwise no ray."""
    highest = signal == np.nanmax(signal)
    return highest & (highest.mean() > PLATEAU)


@dataclass(frozen=True)
class ObservedScans(Observed):
    """Observed line integrals, shape (views, rows, columns).

    `correlation` has an entry for neighboring columns, rows and views; NaN along axes with one pixel.

    Attributes
    ----------
    white : ndarray or None
        Coefficients of the white field's shape.
    """

    white: np.ndarray | None = None

    @property
    def parts(self) -> tuple[str, ...]:
        """See Observed.parts."""
        return super().parts + (() if self.white is None else ("white field",))

    def residuals(self, prediction) -> list[np.ndarray]:
        """See Observed.residuals."""
        return super().residuals(prediction) + ([] if self.white is None else [self.white - prediction.white])

    def weights(self, variance: np.ndarray, floor: np.ndarray) -> list[np.ndarray]:
        """See Observed.weights."""
        shape = [] if self.white is None else [np.full(self.white.size, 1 / WHITE_TOLERANCE**2)]
        return super().weights(variance, floor) + shape


def observe(
    taken: Scans,
    reference: np.ndarray,
    blocks: Blocks | None = None,
    correlations: Correlations = WHITE,
) -> ObservedScans:
    """Condense repeats to a mean, variances and correlations.

    Parameters
    ----------
    reference : ndarray, shape (views, rows, columns)
        Variance of a first model. Variances are divided by it, so that they vary little within a block.
    blocks : Blocks or None
        None: as many blocks as PARTS.
    correlations : Correlations
        Noise correlations, which increase the standard errors.

    Raises
    ------
    InputError
        If no ray is usable.
    """
    if not taken.usable.any():
        raise InputError("no ray has a signal; check the object, data_white and data_dark")
    blocks = blocks or Blocks.of(taken.usable.shape, PARTS)
    n = len(taken)
    mean = taken.repeats.mean(axis=0, dtype=np.float64)
    variance = variance_error = correlation = correlation_error = None
    alone: np.ndarray | float = 1.0
    if n > 1:
        weight = taken.usable / reference
        rays = blocks.sum(taken.usable)
        deviations = [(repeat - mean) * np.sqrt(weight) for repeat in taken.repeats]
        square = sum(deviation**2 for deviation in deviations)
        of_all, of_block = _variance_factors(correlations, blocks)
        half = rays * (n - 1) / 2 / of_block  # of the degrees of freedom
        alone = of_block / of_all
        with np.errstate(invalid="ignore", divide="ignore"):
            # The mean logarithm of a sample variance is below the logarithm of the variance. Without this correction,
            # the bias over all blocks would be one standard error.
            variance = blocks.sum(square) / (rays * (n - 1)) * np.exp(np.log(half) - special.digamma(half))
            variance_error = np.sqrt(special.polygamma(1, half) / alone)
        variance[rays == 0] = np.nan
        correlation, correlation_error = np.full(3, np.nan), np.full(3, np.nan)
        for index, axis in enumerate((2, 1, 0)):
            length = taken.usable.shape[axis]
            if length < 2:
                continue
            pairs = int(neighbors(taken.usable, axis).sum())
            if not pairs:
                continue
            products = sum(
                float((np.take(d, range(length - 1), axis) * np.take(d, range(1, length), axis)).sum())
                for d in deviations
            )
            correlation[index] = products / (pairs * square[taken.usable].mean())
            factor = correlations.variance_of_neighbors(axis, taken.usable.shape)
            correlation_error[index] = np.sqrt(factor / (pairs * (n - 1)))
    return ObservedScans(
        mean=mean,
        n=n,
        usable=taken.usable,
        blocks=blocks,
        reference=reference,
        variance=variance,
        variance_error=variance_error,
        correlation=correlation,
        correlation_error=correlation_error,
        white=None if taken.white is None else white_shape(taken.white),
        alone=alone,
    )


def neighbors(usable: np.ndarray, axis: int) -> np.ndarray:
    """Return which pairs of neighbors along an axis are usable; this axis is one shorter than in `usable`."""
    first, second = (np.take(usable, range(start, usable.shape[axis] - 1 + start), axis) for start in (0, 1))
    return first & second


def with_noise_of_views(data: ObservedScans, squares: np.ndarray, together: float) -> ObservedScans:
    """Add the noise variance by block of views to the data of a single repeat; correlations stay unknown.

    Parameters
    ----------
    squares : ndarray, shape (views, rows, columns)
        Squared second differences, scaled so that their mean is the noise variance over the reference; NaN without
        a signal.
    together : float
        Variance of the sum of squares, relative to the sum of independent squares.
    """
    fine, blocks = data.blocks, Blocks.of(data.usable.shape, VIEW_PARTS)
    squares = np.where(data.usable, squares, np.nan)
    level, counts = mean_squares(squares, fine)
    # Number of the block of views that contains each fine block.
    coarse = blocks.index.ravel()[np.unique(fine.index, return_index=True)[1]]
    rays = np.bincount(coarse, counts, blocks.count)
    spread = np.where(counts < ENOUGH_FOR_MEDIAN, VARIANCE_OF_MEAN, VARIANCE_OF_MEDIAN) * together
    with np.errstate(invalid="ignore", divide="ignore"):
        variance = np.bincount(coarse, counts * level, blocks.count) / rays
        error = np.sqrt(np.bincount(coarse, counts * spread, blocks.count) / rays**2 + NOISE_OF_VIEWS**2)
    missing = np.full(3, np.nan)
    known = {"variance": variance, "variance_error": error, "correlation": missing, "correlation_error": missing}
    return replace(data, coarser=blocks, **known)


def mean_squares(squares: np.ndarray, blocks: Blocks) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean square of normal noise by block.

    Blocks with enough squares use the median, because the second differences of moving edges would increase the mean.

    Parameters
    ----------
    squares : ndarray, shape (views, rows, columns)
        NaN without a signal.

    Returns
    -------
    level : ndarray, shape (blocks,)
        0 in blocks without squares.
    counts : ndarray, shape (blocks,)
        Number of squares.
    """
    index = blocks.index.ravel()
    order = np.argsort(index, kind="stable")
    parts = np.split(squares.ravel()[order], np.cumsum(np.bincount(index, minlength=blocks.count))[:-1])
    parts = [part[np.isfinite(part)] for part in parts]
    return np.array([_mean_square(part) for part in parts]), np.array([part.size for part in parts])


def _mean_square(squares: np.ndarray) -> float:
    if squares.size < ENOUGH_FOR_MEDIAN:
        return float(squares.mean()) if squares.size else 0.0
    return float(np.median(squares)) / MEDIAN_SQUARE


def _variance_factors(correlations: Correlations, blocks: Blocks) -> tuple[float, np.ndarray]:
    """Return the factors by which noise correlation increases the variance of sums of squares.

    Returns
    -------
    of_all : float
        For all rays.
    of_block : ndarray, shape (blocks,)
        For each block.
    """
    if correlations.white:
        return 1.0, np.ones(blocks.count)
    shape = blocks.index.shape
    of_all = np.prod([correlations.variance_of_squares(axis, length) for axis, length in enumerate(shape)])
    of_part = []  # by axis
    for axis, length in enumerate(shape):
        places = (slice(*pair) for pair in pairwise(blocks.bounds(axis)))
        of_part.append([correlations.variance_of_squares(axis, length, place) for place in places])
    return float(of_all), np.multiply.outer(np.multiply.outer(*of_part[:2]), of_part[2]).ravel()


def white_shape(white: np.ndarray) -> np.ndarray:
    """Return coefficients of the logarithm of a white field in Legendre polynomials of columns, then of rows.

    The constant and pixels without signal are omitted. The outermost columns and rows are omitted too, as their
    crosstalk depends on the design of the detector. Axes with three or fewer pixels have only a slope.

    Parameters
    ----------
    white : ndarray, shape (rows, columns)
    """
    good = (white > 0) & _inner(*white.shape)
    matrix = _shapes(*white.shape)[:, good].T
    return np.linalg.lstsq(matrix, np.log(white[good]), rcond=None)[0][1:]


@cache
def _inner(rows: int, columns: int) -> np.ndarray:
    """Return the pixels without the outermost ones along axes of more than FEW_PIXELS, shape (rows, columns)."""
    inside = np.zeros((rows, columns), bool)
    inside[tuple(slice(1, -1) if length > FEW_PIXELS else slice(None) for length in inside.shape)] = True
    return inside


def _highest_order(highest: int, length: int) -> int:
    """Return the highest order that this number of pixels determines."""
    return min(highest, length - 3) if length > FEW_PIXELS else min(1, length - 1)


@cache
def _shapes(rows: int, columns: int) -> np.ndarray:
    """Return the constant and the polynomials of columns and of rows, shape (polynomials, rows, columns)."""
    terms = [(0, order) for order in range(1, _highest_order(WHITE_COLUMNS, columns) + 1)]
    terms += [(order, 0) for order in range(1, _highest_order(WHITE_ROWS, rows) + 1)]

    def polynomial(length, order):
        position = np.linspace(-1, 1, length) if length > 1 else np.zeros(1)
        return legendre.legval(position, [0] * order + [1])

    shapes = [np.ones((rows, columns))]
    return np.stack(shapes + [polynomial(rows, r)[:, None] * polynomial(columns, c)[None, :] for r, c in terms])
