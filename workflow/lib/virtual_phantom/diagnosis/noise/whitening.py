"""Noise that neighbouring rays share: how it is correlated, what makes it white, and what errors it leaves.

A detector whose pixels share light, or glow on, blurs its own quantum noise: variances of single rays fall, those of
sums over many rays do not. Residuals are therefore whitened before they are fitted and tested (pre-whitening [1]_), by
the inverse of a filter that is estimated once per recording from differences of repeats, which no model of the mean
touches.

What is blurred is the signal as it is read. A residual is therefore multiplied by the signal, filtered, and divided by
it again. The filter leaves what is smooth as it is, so that residuals stay line integrals.

References
----------
.. [1] H. H. Barrett and K. J. Myers, Foundations of Image Science, Wiley, 2004, section 13.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft, signal

from ...physics.state import State

SEEN = 3.0  # standard errors by which a correlation must stand out; what is less changes no sum by 1 % of its error
VIEW_LAGS = 48  # successive views whose correlations are looked at, where there are twice as many
MEMORIES = np.linspace(0, 0.95, 96)  # by which correlations may fade from view to view: the range of afterglow's
CALM = 0.2  # change of the line integral from ray to ray up to which noise is correlated as in a uniform signal
LEAST_CALM = 0.05  # of the rays: fewer say less than all of them
LONG = 512  # places along an axis: longer ones have the same relative errors
LEAST_POWER = 0.02  # of noise, over its mean over frequencies: less is no evidence
MOST_ROOT = 0.95  # of the filter along views: inverses of larger ones remember hundreds of views
REACH = 0.1  # of a filter's middle: rays as near to a missing one as its taps are larger do not count


@dataclass(frozen=True)
class Correlations:
    """Of the noise that is read of a uniform signal; 0 along axes where none stands out.

    Attributes
    ----------
    columns, rows : tuple of 2 float
        Correlation of pixels one and two apart.
    views : tuple of 2 float
        Correlation of successive views, and the factor by which it fades with every further one.
    """

    columns: tuple[float, float] = (0.0, 0.0)
    rows: tuple[float, float] = (0.0, 0.0)
    views: tuple[float, float] = (0.0, 0.0)

    @property
    def white(self) -> bool:
        """Whether there are none."""
        return not (self.columns[0] or self.rows[0] or self.views[0])

    def of_every(self, step: int) -> Correlations:
        """Those of one view of so many."""
        first, memory = self.views
        return Correlations(self.columns, self.rows, (first * memory ** (step - 1), memory**step))

    def stands_out(self, other: Correlations, rays: int) -> bool:
        """Whether so many rays would show that their noise has these correlations and not the other ones."""
        pairs = zip((self.columns, self.rows, self.views), (other.columns, other.rows, other.views), strict=True)
        return max(abs(one[0] - two[0]) for one, two in pairs) * np.sqrt(rays) > SEEN

    def of_second_differences(self, of_rows: bool = False) -> float:
        """Variance of x[i - 1] - 2 x[i] + x[i + 1] of successive views, over that of a view.

        Parameters
        ----------
        of_rows : bool, optional
            Of these differences, they are taken of successive rows, too.
        """
        first, memory = self.views
        along_views, along_rows = 6 - 8 * first + 2 * first * memory, 6 - 8 * self.rows[0] + 2 * self.rows[1]
        return along_views * along_rows if of_rows else along_views

    def covariance(self, axis: int, length: int) -> np.ndarray:
        """Covariance of places along an axis, that of a place far from the ends being 1 with itself.

        The pixels at a detector's edges keep what would leave it: as if it were mirrored there.

        Parameters
        ----------
        axis : int
            Of views, rows and columns.

        Returns
        -------
        ndarray, shape (length, length)
        """
        if axis == 0:
            far = np.abs(np.subtract.outer(np.arange(length), np.arange(length)))
            first, memory = self.views
            return np.where(far == 0, 1.0, first * memory ** np.maximum(far - 1.0, 0))
        taps = np.zeros(2 * length + 2)
        taps[:3] = (1.0, *(self.rows if axis == 1 else self.columns))
        place = np.arange(length)
        total = taps[np.abs(np.subtract.outer(place, place))]
        if length == 1:
            return np.ones((1, 1))
        return total + taps[np.add.outer(place, place) + 1] + taps[2 * length - 1 - np.add.outer(place, place)]

    def power(self, axis: int, length: int) -> np.ndarray:
        """Power of noise along rows or columns, by the cosines of a discrete cosine transform (II).

        Parameters
        ----------
        axis : int
            1 or 2, of views, rows and columns.

        Returns
        -------
        ndarray, shape (length,)
            By frequency.
        """
        near, far = self.rows if axis == 1 else self.columns
        angle = np.pi * np.arange(length) / length
        if length == 1:
            return np.ones(1)
        return np.maximum(1 + 2 * near * np.cos(angle) + 2 * far * np.cos(2 * angle), LEAST_POWER)

    def moving_average(self) -> float:
        """Moving-average part of the ARMA(1, 1) process that has the views' correlations.

        That is psi of x_i = phi x_(i-1) + e_i + psi e_(i-1), where |psi| < 1 and phi is the factor by which they fade.
        """
        first, memory = self.views
        if abs(first - memory) < 1e-12:
            return 0.0
        half = (1 + memory**2 - 2 * memory * first) / (first - memory) / 2
        # Between -1 and 1 nothing has such correlations; the nearest that has is the filter's bound.
        root = np.sign(half) / (abs(half) + np.sqrt(max(half**2 - 1, 0)))
        return float(np.clip(root, -MOST_ROOT, MOST_ROOT))

    def amplification(self) -> float:
        """Variance of white noise with the same power at low frequencies, over that of a ray far from the edges."""
        first, memory = self.views
        of_views = max(1 + 2 * first / (1 - memory), LEAST_POWER)
        return float(self.power(1, 2)[0] * self.power(2, 2)[0] * of_views)

    def variance_of_squares(self, axis: int, length: int, places: slice = slice(None)) -> float:
        """Variance of the sum of squares over places of an axis, over that of white noise: n sum C_ij^2 / (sum C_ii)^2.

        Parameters
        ----------
        axis : int
            Of views, rows and columns.
        places : slice, optional
            Those that are summed.
        """
        part = self.covariance(axis, min(length, LONG) if places == slice(None) else length)[places, places]
        return float(len(part) * (part**2).sum() / np.trace(part) ** 2)

    def variance_of_neighbours(self, axis: int, lengths: tuple[int, int, int]) -> float:
        """Variance of the sample correlation of neighbours along an axis, times the number of pairs.

        To first order that of a ratio a / b of quadratic forms x'Mx, whose covariances are 2 tr(M C M' C); C is a
        product by axis.

        Parameters
        ----------
        axis : int
            Of views, rows and columns.
        lengths : tuple of 3 int
            Of all axes.
        """
        if self.white:
            return 1.0
        length = min(lengths[axis], LONG)
        there = self.covariance(axis, length)
        moved = np.zeros_like(there)
        moved[1:] += there[:-1] / 2
        moved[:-1] += there[1:] / 2
        of_pairs, of_squares = 1 / (length - 1), 1 / length
        square = np.trace(there) * of_squares
        ratio = np.trace(moved) * of_pairs / square
        along = (moved * moved.T).sum() * of_pairs**2 + ratio**2 * (there**2).sum() * of_squares**2
        along -= 2 * ratio * (moved * there).sum() * of_pairs * of_squares
        others = [self.variance_of_squares(one, lengths[one]) for one in range(3) if one != axis]
        return float(2 * along / square**2 / of_pairs * np.prod(others))


WHITE = Correlations()


def of_state(state: State, apart: int | None = None) -> Correlations:
    """Correlations that a state of the chain gives the noise.

    Electronic noise is included as its share is over all rays.

    Parameters
    ----------
    apart : int, optional
        Of the scanner's views, by how many those lie apart that are asked for; None: the state's own.
    """
    share, memory, _ = state.lag
    if not (any(state.neighbours) or share):
        return WHITE
    variance = state.variance()
    electronic = (state.electronic / state.photons) ** 2 / state.per_line**2 if state.electronic else 0.0
    coloured = 1 - float(np.mean(electronic / variance))
    pixels = []
    for one, length in zip(state.neighbours, variance.shape[:0:-1], strict=True):
        one = one if length > 1 else 0.0
        square = (1 - 2 * one) ** 2 + 2 * one**2
        pixels.append((coloured * 2 * one * (1 - 2 * one) / square, coloured * one**2 / square))
    # Of weights 1 - k, k (1 - d), k (1 - d) d, ...: those of views that follow each other, over the squares.
    glow = share**2 * (1 - memory) / (1 + memory)
    views = (share * (1 - share) * (1 - memory) + glow * memory) / ((1 - share) ** 2 + glow)
    found = Correlations(*pixels, (coloured * views, memory if share else 0.0))
    return found.of_every(state.geometry.views_apart if apart is None else apart)


class Whitening:
    """Filters residuals of line integrals so that their noise is white.

    Parameters
    ----------
    correlations : Correlations
        Of the noise.
    lines : ndarray, shape (views, rows, columns)
        Line integrals, to first order: what is read is their transmission.
    usable : ndarray of bool, shape (views, rows, columns)

    Attributes
    ----------
    noise, correlations : Correlations
        As given, and those of the views that are usable.
    """

    def __init__(self, correlations: Correlations, lines: np.ndarray, usable: np.ndarray):
        self.views = np.flatnonzero(usable.any(axis=(1, 2)))
        steps = np.diff(self.views)
        step = int(np.median(steps)) if steps.size else 1
        self.noise, self.correlations = correlations, correlations.of_every(step)
        shape = usable.shape
        power = np.multiply.outer(*(correlations.power(axis, shape[axis]) for axis in (1, 2)))
        self._blur = np.sqrt(power / power[0, 0])
        self._memory, self._psi = self.correlations.views[1], self.correlations.moving_average()
        transmission = np.exp(-lines)
        read = _lasting(self._pixels(transmission, self._blur), correlations)
        self._read = np.maximum(read, LEAST_POWER * transmission)
        self.counted = self._away_from_missing(usable)

    @property
    def amplification(self) -> float:
        """Of the variance of a ray far from the edges."""
        return self.correlations.amplification()

    def variance(self, lines: np.ndarray) -> np.ndarray:
        """Shape of the whitened noise's variance, up to a factor.

        Parameters
        ----------
        lines : ndarray, shape (views, rows, columns)
            Line integrals.

        Returns
        -------
        ndarray, shape (views, rows, columns)
        """
        return np.exp(-lines) / self._read**2

    def __call__(self, residual: np.ndarray) -> np.ndarray:
        """A residual made white, shape (views, rows, columns)."""
        pixels = self._pixels(residual * self._read, 1 / self._blur)
        return self._along_views(pixels, inverse=False) / self._read

    def inverse(self, whitened: np.ndarray) -> np.ndarray:
        """A whitened residual as it was, shape (views, rows, columns)."""
        return self._pixels(self._along_views(whitened * self._read, inverse=True), self._blur) / self._read

    def pixels(self, constants: np.ndarray) -> np.ndarray:
        """Constants that, the same in all views, whitening makes these, shape (rows, columns)."""
        return self._pixels(constants[None], self._blur)[0]

    def roughness(self, smooth_px: tuple[float, float]) -> float:
        """Standard deviation of what whitening makes of white constants of pixels, over theirs.

        Parameters
        ----------
        smooth_px : sequence of 2 float
            Widths of Gaussians along rows and columns that are taken off, pixels; 0: none.
        """
        rows, columns = (
            np.exp(-((sigma * np.pi * np.arange(n) / n) ** 2) / 2) if sigma else np.ones(n)
            for sigma, n in zip(smooth_px, self._blur.shape, strict=True)
        )
        rough = (1 - np.outer(rows, columns)) ** 2
        return float(np.sqrt((rough / self._blur**2).sum() / rough.sum()))

    def _pixels(self, array: np.ndarray, factor: np.ndarray) -> np.ndarray:
        """Along rows and columns, mirrored at the detector's edges."""
        if not (self.correlations.columns[0] or self.correlations.rows[0]):
            return array
        axes = (1, 2)
        return fft.idctn(fft.dctn(array, axes=axes) * factor, axes=axes)

    def _along_views(self, array: np.ndarray, inverse: bool) -> np.ndarray:
        """By the innovations of a stationary ARMA(1, 1), from its first view on [1]_, so scaled that what lasts stays.

        Parameters
        ----------
        array : ndarray, shape (views, rows, columns)

        Returns
        -------
        ndarray, shape (views, rows, columns)

        References
        ----------
        .. [1] P. J. Brockwell and R. A. Davis, Time Series: Theory and Methods, 2nd ed., Springer, 1991, example 5.3.1.
        """
        if not self.correlations.views[0]:
            return array
        phi, psi = self._memory, self._psi
        lasting = (1 - phi) / (1 + psi)
        result = np.zeros_like(array)
        expected, spread = np.zeros(array.shape[1:]), (1 + 2 * psi * phi + psi**2) / (1 - phi**2)
        for view in self.views:
            scale = lasting * np.sqrt(spread)
            if inverse:
                innovation = array[view] * scale
                result[view] = read = expected + innovation
            else:
                read = array[view]
                innovation = read - expected
                result[view] = innovation / scale
            expected = phi * read + psi / spread * innovation
            spread = 1 + psi**2 - psi**2 / spread
        return result

    def _away_from_missing(self, usable: np.ndarray) -> np.ndarray:
        """Rays whose filter asks for none that is missing, as far as that matters."""
        counted = usable.copy()
        if usable.all():
            return counted
        along = usable[self.views]
        near = np.ones_like(along)
        for axis in (1, 2):
            length = usable.shape[axis]
            response = np.zeros(length)
            response[length // 2] = 1
            factor = (self._blur[:, 0] if axis == 1 else self._blur[0]) ** -1.0
            taps = np.abs(fft.idct(fft.dct(response) * factor))
            reach = np.abs(np.flatnonzero(taps > REACH * taps[length // 2]) - length // 2).max(initial=0)
            for by in range(1, reach + 1):
                _and(near, along, axis, by)
                _and(near, along, axis, -by)
        for by in range(1, self._view_reach() + 1):
            _and(near, along, 0, by)
        counted[self.views] &= near
        return counted

    def _view_reach(self) -> int:
        if not self.correlations.views[0]:
            return 0
        taps = np.zeros(VIEW_LAGS)
        taps[0] = 1
        taps = np.abs(signal.lfilter([1, -self._memory], [1, self._psi], taps))
        return int(np.flatnonzero(taps > REACH).max())


def estimated(deviations, lines: np.ndarray, usable: np.ndarray, freedom: int) -> Correlations:
    """The correlations of noise.

    Parameters
    ----------
    deviations : sequence of ndarray, shape (views, rows, columns)
        Differences of repeats from their mean, over their standard deviation.
    lines : ndarray, shape (views, rows, columns)
        Line integrals, to first order.
    usable : ndarray of bool, shape (views, rows, columns)
    freedom : int
        How many of the deviations are independent.
    """
    calm = usable.copy()
    for axis in range(3):
        steep = np.abs(np.diff(lines, axis=axis)) > CALM
        for side in (slice(None, -1), slice(1, None)):
            calm[_along(axis, side)] &= ~steep
    if calm.sum() < LEAST_CALM * usable.sum():
        calm = usable
    deviations = [np.where(calm, one, 0.0) for one in deviations]

    def mean(axis: int, lag: int) -> tuple[float, float]:
        """Of products of deviations at a lag, and how many of them are independent without correlations."""
        length = calm.shape[axis]
        low, high = (_along(axis, slice(a, length - lag + a)) for a in (0, lag))
        pairs = int((calm[low] & calm[high]).sum())
        total = sum(float(np.vdot(one[low], one[high])) for one in deviations)
        return total / max(pairs, 1), pairs * freedom

    square, _ = mean(2, 0)
    if not square:
        return WHITE
    of_pixels = [_of_pixels(lambda lag, axis=axis: mean(axis, lag), calm.shape[axis], square) for axis in (2, 1)]
    return Correlations(*of_pixels, _of_views(lambda lag: mean(0, lag), calm.shape[0], square))


def _of_pixels(mean, length: int, square: float) -> tuple[float, float]:
    """Correlations of pixels one and two apart, of which the edges' own variances and covariances are part.

    Of n pixels mirrored at both edges, mean products are 1 + 2 r1 / n, r1 + 2 r2 / (n - 1) and r2, times a variance.

    Parameters
    ----------
    mean : callable
        Lag to the mean of products of deviations, and how many are independent.
    length : int
        n.
    square : float
        Mean product at lag 0.

    Returns
    -------
    first, second : float
        0 where the first does not stand out.
    """
    if length < 2:
        return 0.0, 0.0
    (near, count), (far, _) = mean(1), mean(2) if length > 2 else (0.0, 0.0)
    if abs(near) * np.sqrt(count) < SEEN * square:
        return 0.0, 0.0
    first = near - 2 * far / (length - 1)
    variance = square - 2 * first / length
    return first / variance, far / variance


def _of_views(mean, length: int, square: float) -> tuple[float, float]:
    """Correlation of successive views and its memory: the geometric series that fits best."""
    lags = range(1, min(VIEW_LAGS, length // 2) + 1)
    found = [mean(lag) for lag in lags]
    rho, count = np.array([one / square for one, _ in found]), np.array([count for _, count in found])
    if not rho.size:
        return 0.0, 0.0
    series = MEMORIES[:, None] ** np.arange(rho.size)
    information = series**2 @ count
    first = series @ (count * rho) / np.maximum(information, 1e-300)
    best = int(np.argmax(first**2 * information))
    if abs(first[best]) * np.sqrt(information[best]) < SEEN:
        return 0.0, 0.0
    return float(first[best]), float(MEMORIES[best])


def _lasting(array: np.ndarray, correlations: Correlations) -> np.ndarray:
    """What is read of a signal [view, row, column] that lags behind so that its noise has these correlations."""
    first, memory = correlations.views
    if not first:
        return array
    psi = correlations.moving_average()
    scale = (1 - memory) / (1 + psi)
    over, under = scale * np.array([1, psi]), np.array([1, -memory])
    start = signal.lfilter_zi(over, under)[:, None, None] * array[:1]
    return signal.lfilter(over, under, array, axis=0, zi=start)[0]


def _and(near: np.ndarray, there: np.ndarray, axis: int, by: int) -> None:
    """Of `near` keep what has a neighbour that is `there` so many places before it along an axis, or none at all."""
    length = there.shape[axis]
    low, high = slice(max(by, 0), length + min(by, 0)), slice(max(-by, 0), length + min(-by, 0))
    near[_along(axis, low)] &= there[_along(axis, high)]


def _along(axis: int, part: slice) -> tuple[slice, ...]:
    """A part of [view, row, column] along an axis."""
    return tuple(part if one == axis else slice(None) for one in range(3))
