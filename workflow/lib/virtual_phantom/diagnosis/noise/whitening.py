"""Correlated noise of neighboring rays: its estimate, the filter that whitens it, and errors of its statistics.

Optical crosstalk and afterglow blur the quantum noise of a detector: they reduce the variance of single rays, but not
the variance of sums over many rays. Residuals are therefore whitened before they are fitted and tested (pre-whitening
[1]_). The filter is estimated once per recording from differences of repeats, which do not depend on a model of the
mean.

The detector blurs its signal, not the line integrals. A residual is therefore multiplied by the signal, filtered, and
divided by the signal. The filter does not change smooth residuals, so they remain line integrals.

References
----------
.. [1] H. H. Barrett and K. J. Myers, Foundations of Image Science, Wiley, 2004, section 13.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft, signal

from ...physics.state import Sharing, State

SEEN = 3.0  # standard errors from which a correlation is used; smaller ones change errors of sums by less than 1 %
VIEW_LAGS = 48  # successive views whose correlations are estimated, if there are twice as many
PIXEL_LAGS = 8  # pixels apart; at the longest tail of crosstalk, more distant pixels add 0.5 % to the variance of sums
FAINT = 1e-4  # smaller correlations of a model are 0: they change the variance of sums by less than 0.1 %
MEMORIES = np.linspace(0, 0.95, 96)  # factors by which correlations decay from view to view: the range of afterglow
CALM = 0.2  # largest change of the line integral between neighboring rays used to estimate correlations
LEAST_CALM = 0.05  # of the rays; with fewer, all rays are used
LONG = 512  # positions along an axis; longer axes have the same relative errors
LEAST_POWER = 0.02  # of noise, relative to the mean over frequencies; smaller estimates are not reliable
MOST_ROOT = 0.95  # largest moving-average coefficient; the filter of a larger one would extend over hundreds of views
REACH = 0.1  # rays are excluded if a missing ray has a filter coefficient above this share of the central one


@dataclass(frozen=True)
class Correlations:
    """Correlations of the noise of a uniform signal; 0 along axes where none is significant.

    Attributes
    ----------
    columns, rows : tuple of float
        Correlation of pixels one, two, ... apart, two at least.
    views : tuple of 2 float
        Correlation of successive views, and the factor by which it decays with every further one.
    """

    columns: tuple[float, ...] = (0.0, 0.0)
    rows: tuple[float, ...] = (0.0, 0.0)
    views: tuple[float, float] = (0.0, 0.0)

    @property
    def white(self) -> bool:
        """Whether all correlations are 0."""
        return not (self.columns[0] or self.rows[0] or self.views[0])

    def of_every(self, step: int) -> Correlations:
        """Return the correlations of every `step`-th view."""
        first, memory = self.views
        return Correlations(self.columns, self.rows, (first * memory ** (step - 1), memory**step))

    def stands_out(self, other: Correlations, rays: int) -> bool:
        """Return whether this number of rays would distinguish these correlations from others."""
        pairs = zip((self.columns, self.rows, self.views), (other.columns, other.rows, other.views), strict=True)
        return max(abs(own[0] - its[0]) for own, its in pairs) * np.sqrt(rays) > SEEN

    def of_second_differences(self, of_rows: bool = False) -> float:
        """Return the variance of x[i - 1] - 2 x[i] + x[i + 1] of successive views, relative to a view's variance.

        Parameters
        ----------
        of_rows : bool, optional
            Differences are taken along successive rows, too.
        """
        first, memory = self.views
        along_views, along_rows = 6 - 8 * first + 2 * first * memory, 6 - 8 * self.rows[0] + 2 * self.rows[1]
        return along_views * along_rows if of_rows else along_views

    def covariance(self, axis: int, length: int) -> np.ndarray:
        """Return the covariance of positions along an axis (0 views, 1 rows, 2 columns), shape (length, length).

        The variance is 1 far from the ends. Pixels at the edges keep the light that would leave the detector, as if the
        detector were mirrored there.
        """
        if axis == 0:
            far = np.abs(np.subtract.outer(np.arange(length), np.arange(length)))
            first, memory = self.views
            return np.where(far == 0, 1.0, first * memory ** np.maximum(far - 1.0, 0))
        lags = self.rows if axis == 1 else self.columns
        taps = np.zeros(2 * length + len(lags))
        taps[: 1 + len(lags)] = (1.0, *lags)
        place = np.arange(length)
        total = taps[np.abs(np.subtract.outer(place, place))]
        if length == 1:
            return np.ones((1, 1))
        return total + taps[np.add.outer(place, place) + 1] + taps[2 * length - 1 - np.add.outer(place, place)]

    def power(self, axis: int, length: int) -> np.ndarray:
        """Return the power of noise along rows (axis 1) or columns (2), shape (length,).

        It is by frequency of a discrete cosine transform (II).
        """
        angle = np.pi * np.arange(length) / length
        if length == 1:
            return np.ones(1)
        lags = enumerate(self.rows if axis == 1 else self.columns, start=1)
        return np.maximum(1 + sum(2 * correlation * np.cos(lag * angle) for lag, correlation in lags), LEAST_POWER)

    def moving_average(self) -> float:
        """Return the moving-average coefficient of the ARMA(1, 1) process with the views' correlations.

        This is psi of x_i = phi x_(i-1) + e_i + psi e_(i-1), with |psi| < 1 and phi the factor of their decay.
        """
        first, memory = self.views
        if abs(first - memory) < 1e-12:
            return 0.0
        half = (1 + memory**2 - 2 * memory * first) / (first - memory) / 2
        # If |half| < 1, no coefficient gives these correlations. The bound of the filter is nearest to them.
        root = np.sign(half) / (abs(half) + np.sqrt(max(half**2 - 1, 0)))
        return float(np.clip(root, -MOST_ROOT, MOST_ROOT))

    @property
    def amplification(self) -> float:
        """Variance of white noise with the same power at low frequencies, relative to a ray's variance."""
        first, memory = self.views
        of_views = max(1 + 2 * first / (1 - memory), LEAST_POWER)
        return float(self.power(1, 2)[0] * self.power(2, 2)[0] * of_views)

    def variance_of_squares(self, axis: int, length: int, places: slice = slice(None)) -> float:
        """Return the variance of a sum of squares along an axis, relative to white noise.

        This is n sum C_ij^2 / (sum C_ii)^2.

        Parameters
        ----------
        places : slice, optional
            Positions that are summed.
        """
        part = self.covariance(axis, min(length, LONG) if places == slice(None) else length)[places, places]
        return float(len(part) * (part**2).sum() / np.trace(part) ** 2)

    def variance_of_neighbors(self, axis: int, lengths: tuple[int, int, int]) -> float:
        """Return the variance of the sample correlation of neighbors along an axis, times the number of pairs.

        The correlation is a ratio of two quadratic forms x'Mx, whose covariances are 2 tr(M C M' C). The variance is of
        first order, and the covariance C is a product over the axes.
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
        others = [self.variance_of_squares(other, lengths[other]) for other in range(3) if other != axis]
        return float(2 * along / square**2 / of_pairs * np.prod(others))


WHITE = Correlations()


def of_state(state: State, apart: int | None = None) -> Correlations:
    """Return the noise correlations of a state of the chain, reduced by the mean share of electronic noise.

    Parameters
    ----------
    apart : int, optional
        Distance of successive views, in views of the scanner; None: as in the state.
    """
    share, memory, _ = state.lag
    if not (any(state.neighbours) or share):
        return WHITE
    variance = state.variance()
    electronic = (
        (state.electronic / state.photons) ** 2 / state.signal_per_line_integral**2 if state.electronic else 0.0
    )
    colored = 1 - float(np.mean(electronic / variance))
    pixels = []
    for crosstalk, length in zip(state.neighbours, variance.shape[:0:-1], strict=True):
        sharing = Sharing.of(crosstalk if length > 1 else 0.0, state.tail, max(length, 2))
        lags = colored * sharing.correlations
        pixels.append(tuple(lags[: max(2, np.count_nonzero(lags > FAINT))].tolist()))
    # Sum of the products of successive weights over the sum of squares, for weights 1 - k, k (1 - d), k (1 - d) d, ...
    glow = share**2 * (1 - memory) / (1 + memory)
    views = (share * (1 - share) * (1 - memory) + glow * memory) / ((1 - share) ** 2 + glow)
    found = Correlations(*pixels, (colored * views, memory if share else 0.0))
    return found.of_every(state.geometry.views_apart if apart is None else apart)


class Whitening:
    """Filter that whitens residuals of line integrals.

    Parameters
    ----------
    lines : ndarray, shape (views, rows, columns)
        Line integrals, to first order: their transmission is the signal.
    usable : ndarray of bool, shape (views, rows, columns)

    Attributes
    ----------
    noise, correlations : Correlations
        As given, and of the usable views.
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

    def variance(self, lines: np.ndarray) -> np.ndarray:
        """Return the variance of whitened noise up to a factor, for line integrals (views, rows, columns)."""
        return np.exp(-lines) / self._read**2

    def __call__(self, residual: np.ndarray) -> np.ndarray:
        """Whiten a residual, shape (views, rows, columns)."""
        pixels = self._pixels(residual * self._read, 1 / self._blur)
        return self._along_views(pixels, inverse=False) / self._read

    def inverse(self, whitened: np.ndarray) -> np.ndarray:
        """Undo the whitening of a residual, shape (views, rows, columns)."""
        return self._pixels(self._along_views(whitened * self._read, inverse=True), self._blur) / self._read

    def pixels(self, constants: np.ndarray) -> np.ndarray:
        """Return constants of pixels from whitened ones, equal in all views, shape (rows, columns)."""
        return self._pixels(constants[None], self._blur)[0]

    def roughness(self, smooth_px: tuple[float, float]) -> float:
        """Return the factor by which whitening changes the standard deviation of white constants of pixels.

        Parameters
        ----------
        smooth_px : sequence of 2 float
            Widths of Gaussians along rows and columns that are subtracted, pixels; 0: none.
        """
        rows, columns = (
            np.exp(-((sigma * np.pi * np.arange(n) / n) ** 2) / 2) if sigma else np.ones(n)
            for sigma, n in zip(smooth_px, self._blur.shape, strict=True)
        )
        rough = (1 - np.outer(rows, columns)) ** 2
        return float(np.sqrt((rough / self._blur**2).sum() / rough.sum()))

    def _pixels(self, array: np.ndarray, factor: np.ndarray) -> np.ndarray:
        """Filter along rows and columns, mirrored at the detector's edges."""
        if not (self.correlations.columns[0] or self.correlations.rows[0]):
            return array
        axes = (1, 2)
        return fft.idctn(fft.dctn(array, axes=axes) * factor, axes=axes)

    def _along_views(self, array: np.ndarray, inverse: bool) -> np.ndarray:
        """Filter along views by the innovations of a stationary ARMA(1, 1) process [1]_, constants kept.

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
        """Return the rays whose filter uses no missing ray with a relevant coefficient."""
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
    """Estimate the correlations of noise.

    Parameters
    ----------
    deviations : sequence of ndarray, shape (views, rows, columns)
        Differences of repeats from their mean, over their standard deviation.
    lines : ndarray, shape (views, rows, columns)
        Line integrals, to first order.
    usable : ndarray of bool, shape (views, rows, columns)
    freedom : int
        Number of independent deviations.
    """
    calm = usable.copy()
    for axis in range(3):
        steep = np.abs(np.diff(lines, axis=axis)) > CALM
        for side in (slice(None, -1), slice(1, None)):
            calm[_along(axis, side)] &= ~steep
    if calm.sum() < LEAST_CALM * usable.sum():
        calm = usable
    deviations = [np.where(calm, deviation, 0.0) for deviation in deviations]

    def mean(axis: int, lag: int) -> tuple[float, float]:
        """Return the mean product of deviations at a lag, and the number of independent ones without correlations."""
        length = calm.shape[axis]
        low, high = (_along(axis, slice(a, length - lag + a)) for a in (0, lag))
        pairs = int((calm[low] & calm[high]).sum())
        total = sum(float(np.vdot(deviation[low], deviation[high])) for deviation in deviations)
        return total / max(pairs, 1), pairs * freedom

    square, _ = mean(2, 0)
    if not square:
        return WHITE
    of_pixels = [_of_pixels(lambda lag, axis=axis: mean(axis, lag), calm.shape[axis], square) for axis in (2, 1)]
    return Correlations(*of_pixels, _of_views(lambda lag: mean(0, lag), calm.shape[0], square))


def _of_pixels(mean, length: int, square: float) -> tuple[float, ...]:
    """Return the correlations of pixels one, two, ... apart, edges considered; 0 if not significant.

    The mean product at lag k of n pixels mirrored at both edges is r(k) + 2 (r(k + 1) + r(k + 3) + ...) / (n - k),
    times a variance, with r(0) = 1. The lags end before the first from lag 3 on that is not significant.

    Parameters
    ----------
    mean : callable
        Lag to the mean product of deviations, and the number of independent ones.
    length : int
        n.
    square : float
        Mean product at lag 0.
    """
    found = []
    for lag in range(1, min(length, PIXEL_LAGS + 1)):
        product, count = mean(lag)
        if lag != 2 and abs(product) * np.sqrt(count) < SEEN * square:
            break
        found.append(product)
    if not found:
        return 0.0, 0.0
    for lag in range(len(found), -1, -1):  # found[lag - 1] is of this lag
        of_edges = 2 * sum(found[lag::2]) / (length - lag)
        if lag:
            found[lag - 1] -= of_edges
    variance = square - of_edges
    return tuple(product / variance for product in (*found, *[0.0] * (2 - len(found))))


def _of_views(mean, length: int, square: float) -> tuple[float, float]:
    """Return the correlation of successive views and its decay: the geometric series that fits best."""
    lags = range(1, min(VIEW_LAGS, length // 2) + 1)
    found = [mean(lag) for lag in lags]
    rho, count = np.array([product / square for product, _ in found]), np.array([count for _, count in found])
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
    """Return the reading of a signal [view, row, column] with a lag that causes these correlations."""
    first, memory = correlations.views
    if not first:
        return array
    psi = correlations.moving_average()
    scale = (1 - memory) / (1 + psi)
    over, under = scale * np.array([1, psi]), np.array([1, -memory])
    start = signal.lfilter_zi(over, under)[:, None, None] * array[:1]
    return signal.lfilter(over, under, array, axis=0, zi=start)[0]


def _and(near: np.ndarray, there: np.ndarray, axis: int, by: int) -> None:
    """Keep positions of `near` whose neighbor `by` positions before is in `there` or outside of the array."""
    length = there.shape[axis]
    low, high = slice(max(by, 0), length + min(by, 0)), slice(max(-by, 0), length + min(-by, 0))
    near[_along(axis, low)] &= there[_along(axis, high)]


def _along(axis: int, part: slice) -> tuple[slice, ...]:
    """Return the index of a part of [view, row, column] along an axis."""
    return tuple(part if other == axis else slice(None) for other in range(3))
