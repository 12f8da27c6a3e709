"""What repeats of a scan say: their mean, how it varies, and how neighbours vary together.

A recording is condensed to numbers with known errors, so that effects that change only the noise are fitted like those
that change the mean:

* mean: line integrals of every ray, over repeats
* variance: logarithm of the sample variance over repeats, relative to a first model, over blocks of rays
* correlation: of the differences of repeats between neighbouring columns, rows and views
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
from ..noise.whitening import WHITE, Correlations, Whitening

PARTS = (12, 4, 8)  # blocks along views, rows and columns
LEAST_TRANSMISSION = 1e-5  # what fewer photons are read as: such rays are left out
VIEW_PARTS = (12, 1, 1)  # of which a single repeat says how noisy they are, over each other
NOISE_OF_VIEWS = 0.03  # to which noise is taken to follow the model from view to view where it is taken from one repeat
MEDIAN_SQUARE = 0.45494  # of a standard normal variable: median of chi-square with one degree of freedom
OF_MEAN, OF_MEDIAN = 2.0, 5.443  # relative variance of n squares' mean, and of their median, times n
ENOUGH_FOR_MEDIAN = 500  # rays of a block: the median varies 1.65 times as much as the mean, here by 10 %
PLATEAU = 0.001  # share of rays that may have one value by chance; integer counts in air repeat
WHITE_COLUMNS, WHITE_ROWS = 4, 2  # highest orders of the white field's shape
FEW_PIXELS = 3  # along an axis, so that a white field's outermost ones are all that tell its bend
WHITE_TOLERANCE = 0.005  # by which pixels' sensitivities may shape a white field smoothly


@dataclass(frozen=True)
class Scans:
    """Repeats of one scan as line integrals.

    Attributes
    ----------
    repeats : ndarray of float32, shape (repeats, views, rows, columns)
    white : ndarray, shape (rows, columns), or None
        Mean counts without an object; None where line integrals are all there is.
    usable : ndarray of bool, shape (views, rows, columns)
        Rays that measured something in every repeat.
    """

    repeats: np.ndarray
    white: np.ndarray | None
    usable: np.ndarray

    def __len__(self) -> int:
        return len(self.repeats)

    def every(self, step: int) -> Scans:
        """One view of so many."""
        return self if step == 1 else replace(self, repeats=self.repeats[:, ::step], usable=self.usable[::step])


def scans(acquisitions) -> Scans:
    """Repeats of a recording of projections (recordings.projections.Projections)."""
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
    """Rays at the highest signal of a scan, as read out, if more stand there than noise puts on one value.

    Returns
    -------
    ndarray of bool
        Shaped as `signal`.
    """
    highest = signal == np.nanmax(signal)
    return highest & (highest.mean() > PLATEAU)


@dataclass(frozen=True)
class ObservedScans(Observed):
    """As Observed, of line integrals, shape (views, rows, columns).

    `correlation` is that of neighbouring columns, rows and views, missing (NaN) along axes of one pixel.

    Attributes
    ----------
    white : ndarray or None
        Coefficients of the white field's shape.
    """

    white: np.ndarray | None = None

    @property
    def parts(self) -> tuple[str, ...]:
        """As Observed.parts."""
        return super().parts + (() if self.white is None else ("white field",))

    def residuals(self, prediction) -> list[np.ndarray]:
        """As Observed.residuals."""
        return super().residuals(prediction) + ([] if self.white is None else [self.white - prediction.white])

    def weights(self, variance: np.ndarray, floor: np.ndarray) -> list[np.ndarray]:
        """As Observed.weights."""
        shape = [] if self.white is None else [np.full(self.white.size, 1 / WHITE_TOLERANCE**2)]
        return super().weights(variance, floor) + shape


def observe(
    taken: Scans,
    reference: np.ndarray,
    blocks: Blocks | None = None,
    correlations: Correlations = WHITE,
    whitening: Whitening | None = None,
) -> ObservedScans:
    """Condense repeats.

    Parameters
    ----------
    reference : ndarray, shape (views, rows, columns)
        Variance of a first model: what variances are divided by, so that what is left varies little within a block.
    blocks : Blocks, optional
        None: PARTS along the axes.
    correlations : Correlations, optional
        Of the noise.
    whitening : Whitening, optional
        As Observed has it.

    Raises
    ------
    InputError
        If no ray is usable.
    """
    if not taken.usable.any():
        raise InputError("no ray of the recording measured anything; is the object opaque, or are the fields swapped?")
    blocks = blocks or Blocks.of(taken.usable.shape, PARTS)
    n = len(taken)
    mean = taken.repeats.mean(axis=0, dtype=np.float64)
    variance = variance_error = correlation = correlation_error = None
    alone: np.ndarray | float = 1.0
    if n > 1:
        weight = taken.usable / reference
        rays = blocks.sum(taken.usable)
        deviations = [(one - mean) * np.sqrt(weight) for one in taken.repeats]
        square = sum(deviation**2 for deviation in deviations)
        together, within = _fewer(correlations, blocks)
        half = rays * (n - 1) / 2 / within
        alone = within / together
        with np.errstate(invalid="ignore", divide="ignore"):
            # Logarithms of sample variances lie below that of the variance on average: by a standard error over all
            # blocks, were it left so.
            variance = blocks.sum(square) / (rays * (n - 1)) * np.exp(np.log(half) - special.digamma(half))
            variance_error = np.sqrt(special.polygamma(1, half) / alone)
        variance[rays == 0] = np.nan
        correlation, correlation_error = np.full(3, np.nan), np.full(3, np.nan)
        for place, axis in enumerate((2, 1, 0)):
            length = taken.usable.shape[axis]
            if length < 2:
                continue
            low, high = (np.take(taken.usable, range(a, length - 1 + a), axis) for a in (0, 1))
            pairs = int((low & high).sum())
            if not pairs:
                continue
            products = sum(
                float((np.take(d, range(length - 1), axis) * np.take(d, range(1, length), axis)).sum())
                for d in deviations
            )
            correlation[place] = products / (pairs * square[taken.usable].mean())
            fewer = correlations.variance_of_neighbours(axis, taken.usable.shape)
            correlation_error[place] = np.sqrt(fewer / (pairs * (n - 1)))
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
        whitening=whitening,
    )


def with_noise_of_views(data: ObservedScans, squares: np.ndarray, together: float) -> ObservedScans:
    """Of a single repeat, how noisy its views are, over each other.

    Parameters
    ----------
    data : ObservedScans
        Of a single repeat.
    squares : ndarray, shape (views, rows, columns)
        Of differences that have the noise's variance over the reference on average; NaN where there are none.
    together : float
        By what the variance of their sum is larger than that of independent ones.

    Returns
    -------
    ObservedScans
        With the noise of blocks of views, and no correlations known.
    """
    fine, blocks = data.blocks, Blocks.of(data.usable.shape, VIEW_PARTS)
    squares = np.where(data.usable, squares, np.nan)
    level, counts = mean_squares(squares, fine)
    of_views = blocks.index.ravel()[np.unique(fine.index, return_index=True)[1]]
    rays = np.bincount(of_views, counts, blocks.count)
    varies = np.where(counts < ENOUGH_FOR_MEDIAN, OF_MEAN, OF_MEDIAN) * together
    with np.errstate(invalid="ignore", divide="ignore"):
        variance = np.bincount(of_views, counts * level, blocks.count) / rays
        error = np.sqrt(np.bincount(of_views, counts * varies, blocks.count) / rays**2 + NOISE_OF_VIEWS**2)
    missing = np.full(3, np.nan)
    known = {"variance": variance, "variance_error": error, "correlation": missing, "correlation_error": missing}
    return replace(data, coarser=blocks, **known)


def mean_squares(squares: np.ndarray, blocks: Blocks) -> tuple[np.ndarray, np.ndarray]:
    """Mean square of normal noise in blocks, from its squares.

    Where there are enough, by their median: edges that move from view to view have second differences of their own,
    which would count as noise in a mean.

    Parameters
    ----------
    squares : ndarray, shape (views, rows, columns)
        NaN where there are none.

    Returns
    -------
    level : ndarray, shape (blocks,)
        0 in blocks without any.
    counts : ndarray, shape (blocks,)
        How many there are.
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


def _fewer(correlations: Correlations, blocks: Blocks) -> tuple[float, np.ndarray]:
    """By what correlated noise makes the variance of sums of squares larger.

    Returns
    -------
    together : float
        Over all rays.
    within : ndarray, shape (blocks,)
        Over each block.
    """
    if correlations.white:
        return 1.0, np.ones(blocks.count)
    shape = blocks.index.shape
    together = np.prod([correlations.variance_of_squares(axis, length) for axis, length in enumerate(shape)])
    within = []
    for axis, (length, parts) in enumerate(zip(shape, blocks.shape, strict=True)):
        ends = [-(-length * i // parts) for i in range(parts + 1)]  # as Blocks.of divides them
        places = (slice(*pair) for pair in pairwise(ends))
        within.append([correlations.variance_of_squares(axis, length, place) for place in places])
    return float(together), np.multiply.outer(np.multiply.outer(*within[:2]), within[2]).ravel()


def white_shape(white: np.ndarray) -> np.ndarray:
    """Coefficients of the logarithm of a white field in Legendre polynomials of columns, then of rows.

    The constant and pixels without signal are left out. So are the outermost columns and rows: what they share with
    neighbours that they lack is lost, or is not, as a detector is built. Of three or fewer there is only the slope.

    Parameters
    ----------
    white : ndarray, shape (rows, columns)

    Returns
    -------
    ndarray, shape (coefficients,)
    """
    good = (white > 0) & _inner(*white.shape)
    matrix = _shapes(*white.shape)[:, good].T
    return np.linalg.lstsq(matrix, np.log(white[good]), rcond=None)[0][1:]


@cache
def _inner(rows: int, columns: int) -> np.ndarray:
    """Pixels that are not outermost, along axes of more than a few; shape (rows, columns)."""
    inside = np.zeros((rows, columns), bool)
    inside[tuple(slice(1, -1) if length > FEW_PIXELS else slice(None) for length in inside.shape)] = True
    return inside


def _most(highest: int, length: int) -> int:
    """The highest order that so many pixels show."""
    return min(highest, length - 3) if length > FEW_PIXELS else min(1, length - 1)


@cache
def _shapes(rows: int, columns: int) -> np.ndarray:
    """The constant, then the polynomials of columns and of rows, shape (polynomials, rows, columns)."""
    terms = [(0, order) for order in range(1, _most(WHITE_COLUMNS, columns) + 1)]
    terms += [(order, 0) for order in range(1, _most(WHITE_ROWS, rows) + 1)]

    def polynomial(length, order):
        position = np.linspace(-1, 1, length) if length > 1 else np.zeros(1)
        return legendre.legval(position, [0] * order + [1])

    shapes = [np.ones((rows, columns))]
    return np.stack(shapes + [polynomial(rows, r)[:, None] * polynomial(columns, c)[None, :] for r, c in terms])
