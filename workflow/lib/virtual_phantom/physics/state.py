"""State of the acquisition chain: the mean signal of a scan and everything that its noise depends on.

Effects change a State stage by stage (`effect.STAGES`). The final State gives line integrals, their variance and noisy
scans.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy

from ..base.geometry import ScanGeometry
from ..base.mounting import AS_STATED, Mounting
from .beam.sensors import Sensor
from .beam.spectra import SENSOR, TUNGSTEN, Anode, Filters, Spectrum

PHOTONS, AIR = "photons", "air"  # units of State.readout
MIN_SIGNAL = 1e-6  # relative to air; smaller signals have no logarithm
# Afterglow needs the signal shortly before each view. If a scan has only some of the scanner's views, the chain also
# computes the signal this many scanner views earlier. Residual error of an afterglow of 4 to 14 ms in a clinical scan
# with every 15th view: 1 to 5 % with (1, 2, 3, 5, 8), 8 % with (1, 3, 7), 70 to 95 % with none.
EARLIER_VIEWS = (1, 2, 3, 5, 8)
LINEAR = (1.0, 0.0)  # response of a detector whose readings are proportional to the signal
UNCORRECTED = (0.0, 0.0)  # correction polynomial that does not change line integrals
CORRECTION_LIMIT = 10.0  # line integral above which the polynomial is extrapolated linearly, as vendors' tables end
MAX_VARIANCE = 0.2  # variance of line integrals up to which the series for the moments of the logarithm converges

Inclusions = tuple[tuple[Any, float], ...]  # inclusion.Inclusion, and its excess attenuation in 1/mm


@dataclass
class State:
    """Quantities that effects change.

    Signals are relative to the signal of a pixel in air at fluence 1. The fields follow the order of the chain:
    geometry and object, beam, mean signal, detector, readout.

    Attributes
    ----------
    geometry : ScanGeometry
        Actual geometry of the scan, except for rotations of the detector (`mounting`).
    photons : float
        Noise-equivalent quanta per pixel in air at fluence 1: the inverse of the relative quantum variance, 1/A. It is
        the number of photons if all photons have the same weight. Noise that is equal for all deposited energies (the
        optical part of the Swank factor) is included only as a lower number of photons.
    motion_mm : ndarray, shape (views, 3), or None
        Displacement of the object (x, y, z), mm.
    added : tuple of tuple of Inclusion and float
        Shapes inside the object that the scene lacks, and their excess attenuation, 1/mm.
    spectrum : Spectrum or None
        Detected spectrum without an object; None: the monochromatic beam.
    sources : tuple of tuple of 4 float
        Points of the focal spot: displacement along the columns, along the rows and along the central ray away from the
        isocenter, mm, and weight. A weight is the share of the photons that leave for a pixel: a number, or an array
        broadcastable to (rows, columns) if a collimator hides part of the spot.
    jump_mm : ndarray, shape (views, 3), or None
        Additional displacement of the source in every view, in the directions of `sources`.
    turns : tuple of tuple of 2 float
        Times within a view at which rays are computed, in view intervals from the middle of the view, and their
        weights.
    filters : tuple of tuple of str and ndarray
        Materials between source and object and their thickness, mm, broadcastable to (rows, columns). If the spectrum
        already includes a filter, its thickness is the excess over the central ray.
    fluence : ndarray
        Relative number of photons emitted toward each pixel, broadcastable to (views, rows, columns).
    signal, air : ndarray, shape (views, rows, columns), or None
        Mean signal with and without the object; `air` may have a single view.
    noise : ndarray, shape (views, rows, columns), or None
        Quantum variance of the signal times `photons`: equal to the signal if all photons have the same weight.
    electronic : float
        Standard deviation of electronic noise, photons. One photon is the signal in air at fluence 1 over `photons`.
    neighbours : tuple of 2 float
        Crosstalk along (columns, rows): share of the signal, including its quantum noise, that goes to the pixels on
        each side.
    tail : float
        Share of this crosstalk that a pixel receives, relative to the pixel before it; 0: only the next pixel receives
        it.
    lag : tuple of 3 float
        Afterglow (share, memory, before). `share` of the signal of a view is read in later views, and decays by the
        factor `memory` from one scanner view to the next. `before` is the afterglow at the start of the scan, relative
        to a steady beam with the signal of the first view.
    earlier : ndarray, shape (EARLIER_VIEWS, views, rows, columns), or None
        `signal` at EARLIER_VIEWS before each view, for afterglow in a scan that has only some of the scanner's views;
        None: interpolated from the views of the scan.
    slow_lag : tuple of 3 float
        Second afterglow, as `lag`. It decays over so many views that its noise averages out.
    anti_scatter_ratio : tuple of 2 float
        Grid ratio (height of the septa divided by their distance) across columns and across rows; 0: no grid. A grid
        absorbs radiation that is scattered by larger angles.
    response : tuple of 2 float
        (exponent, loss): a signal of N photons, after crosstalk, afterglow and electronic noise, is read as
        N^exponent / (1 + loss N), in the scan and in the air scan.
    gain : ndarray or None
        Change of the gain of each pixel since the air scan, a factor broadcastable to (views, rows, columns). It
        multiplies the signal, quantum noise and electronic noise, but not `dark`.
    correction : tuple of 2 float
        (a, b): the vendor's beam hardening correction stores p + a p^2 + b p^3 for a line integral p.
    dark, dark_air : ndarray or None, float
        Offset of the readings without radiation, readout units: in the scan, broadcastable to (views, rows, columns),
        and in the air scan.
    readout : float or {"photons", "air"}
        Mean reading of the air scan in readout units; PHOTONS: readings are numbers of photons; AIR: the reading is
        unknown, and the mean signal in air is the unit.
    fewest_points : int or None
        Fewest points along a side of the focal spot, and fewest times within a view, as `points` takes it.
    """

    geometry: ScanGeometry
    photons: float = 1e5
    motion_mm: np.ndarray | None = None
    added: Inclusions = ()
    anode: Anode = TUNGSTEN
    sensor: Sensor = SENSOR
    spectrum: Spectrum | None = None
    sources: tuple[tuple[float, float, float, float | np.ndarray], ...] = ((0.0, 0.0, 0.0, 1.0),)
    jump_mm: np.ndarray | None = None
    turns: tuple[tuple[float, float], ...] = ((0.0, 1.0),)
    filters: Filters = ()
    fluence: np.ndarray = field(default_factory=lambda: np.ones((1, 1, 1)))
    signal: np.ndarray | None = None
    air: np.ndarray | None = None
    noise: np.ndarray | None = None
    electronic: float = 0.0
    neighbours: tuple[float, float] = (0.0, 0.0)
    tail: float = 0.0
    lag: tuple[float, float, float] = (0.0, 0.0, 1.0)
    earlier: np.ndarray | None = None
    slow_lag: tuple[float, float, float] = (0.0, 0.0, 1.0)
    anti_scatter_ratio: tuple[float, float] = (0.0, 0.0)
    response: tuple[float, float] = LINEAR
    gain: np.ndarray | None = None
    correction: tuple[float, float] = UNCORRECTED
    dark: np.ndarray | None = None
    dark_air: float = 0.0
    readout: float | str = PHOTONS
    mounting: Mounting = AS_STATED
    fewest_points: int | None = None

    def __post_init__(self):
        if self.noise is None:
            self.noise = self.signal

    @property
    def unit(self) -> float:
        """Reading of a signal of 1, readout units."""
        if self.readout == PHOTONS:
            return self.photons
        air = float(self.apply_response(self.air).mean())
        return 1 / air if self.readout == AIR else (self.readout - self.dark_air) / air

    @property
    def measured(self) -> np.ndarray:
        """Mean reading after the vendor's correction, relative to air at fluence 1, shape (views, rows, columns)."""
        return self.apply_correction(self._mean_reading)

    @property
    def measured_air(self) -> np.ndarray:
        """Mean reading of the air scan, relative to air at fluence 1, shape (views or 1, rows, columns)."""
        return self.apply_response(with_crosstalk(self.air, self.neighbours, self.tail)) + self.dark_air / self.unit

    def line_integrals(self) -> np.ndarray:
        """Return -ln(signal / air) of the mean signals, float64, shape (views, rows, columns)."""
        return -np.log(self.measured / self.measured_air)

    def change_by_dark_signal(self) -> np.ndarray:
        """Return the change of the line integrals per relative change of a pixel's dark signal, as they are shaped."""
        dark = 0.0 if self.dark is None else self.dark / self.unit
        change = self.dark_air / self.unit / self.measured_air - dark / self._mean_reading
        return np.broadcast_to(self._correction_slope * change, self.signal.shape)

    def variance(self) -> np.ndarray:
        """Return the variance of the line integrals to first order: variance of the signal over its mean squared."""
        quantum, electronic = self._noise_parts()
        return quantum + electronic

    def log_noise(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the bias of the line integrals due to noise, and their variance, both to second order, per pixel.

        Let v be the first-order variance and q its quantum part. The moments of -ln(1 + x), to fourth order in x and
        with the third moment of Poisson counts, are v/2 + 3/4 v^2 - q^2/3 and v + 5/2 v^2 - q^2. For counts of mean m
        without other noise: 1/(2m) + 5/(12 m^2) and 1/m + 3/(2 m^2). Above MAX_VARIANCE the series diverges, and the
        second-order terms keep their value at this limit.
        """
        # The logarithm of a power of the signal is proportional to the exponent, noise included; the correction
        # polynomial is linearized.
        exponent = self.log_slope(self.mean_readout) * self._correction_slope
        quantum, electronic = (part / exponent**2 for part in self._noise_parts())
        first = quantum + electronic
        noise, quantum = np.minimum(first, MAX_VARIANCE), np.minimum(quantum, MAX_VARIANCE)
        bias = first / 2 + 0.75 * noise**2 - quantum**2 / 3
        return exponent * bias, exponent**2 * (first + 2.5 * noise**2 - quantum**2)

    def counts(self, random: np.random.Generator) -> np.ndarray:
        """Simulate one noisy scan, in photons, float64, shape (views, rows, columns).

        Quantum noise is a Poisson count times the signal per count, both chosen so that mean and variance are those of
        the state. Its third moment is the one that `log_noise` assumes.

        Parameters
        ----------
        random : numpy.random.Generator
            Gives one number per pixel and view for the counts; with afterglow, also for the scanner views in between.
            Earlier afterglow and electronic noise use spawned streams, so that the counts do not depend on them.
        """
        from .noise.poisson import poisson_counts  # loads numba, which only noisy scans need

        earlier, electronic = random.spawn(2)
        per_count = np.divide(self.noise, self.signal, out=np.ones_like(self.signal), where=self.signal > 0)
        before_scan = self.sample_earlier_signal(self.signal[0] * self.photons, self.noise[0] * self.photons, earlier)
        # The afterglow of scanner views that are not in the scan has noise of its own.
        step = self.geometry.views_apart if self.lag[0] or self.slow_lag[0] else 1
        signal, per_count = interpolate_views(self.signal, step), interpolate_views(per_count, step)
        quanta = poisson_counts(signal / per_count * self.photons, random) * per_count
        reading = self.read_out(quanta, before_scan=before_scan, step=1)[::step]
        if self.electronic:
            reading += self.electronic * electronic.normal(size=reading.shape)
        if self.response != LINEAR:
            reading = self.apply_response(reading / self.photons) * self.photons
        reading = reading if self.gain is None else reading * self.gain
        reading = reading if self.dark is None else reading + self.dark * (self.photons / self.unit)
        if self.correction == UNCORRECTED:
            return reading
        return self.apply_correction(reading / self.photons) * self.photons

    @property
    def mean_readout(self) -> np.ndarray:
        """Mean signal after crosstalk and afterglow, shape (views, rows, columns)."""
        return self.read_out(self.signal, earlier=self.earlier)

    @property
    def _mean_reading(self) -> np.ndarray:
        """`mean_readout` after response, gain and dark signal."""
        signal = self.apply_response(self.mean_readout)
        signal = signal if self.gain is None else signal * self.gain
        return signal if self.dark is None else np.maximum(signal + self.dark / self.unit, MIN_SIGNAL)

    @property
    def signal_per_line_integral(self) -> np.ndarray:
        """First-order change of the signal before the response per change of the line integral by 1, per pixel."""
        signal = self.mean_readout
        exponent = self.log_slope(signal) * self._correction_slope
        if self.dark is None:  # gains change signal and noise by the same factor
            return signal / exponent
        slope = exponent if self.response == LINEAR else exponent * self.apply_response(signal) / signal
        return self._mean_reading / (slope if self.gain is None else slope * self.gain)

    def _noise_parts(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the first-order quantum and electronic variance of the line integrals."""
        factor = 1 / self.signal_per_line_integral**2
        quantum = self.read_out(self.noise / self.photons, squared=True)
        return quantum * factor, (self.electronic / self.photons) ** 2 * factor

    def apply_response(self, signal: np.ndarray) -> np.ndarray:
        """Return the reading sign(N) |N|^exponent / (1 + loss |N|) of a signal N, which noise can make negative."""
        if self.response == LINEAR:
            return signal
        exponent, loss = self.response
        return np.sign(signal) * np.abs(signal) ** exponent / (1 + loss * self.photons * np.abs(signal))

    def log_slope(self, signal: np.ndarray) -> np.ndarray | float:
        """Return d ln(reading) / d ln(signal) of the response."""
        exponent, loss = self.response
        if not loss:
            return exponent
        lost = loss * self.photons * signal
        return exponent - lost / (1 + lost)

    def apply_correction(self, reading: np.ndarray) -> np.ndarray:
        """Return readings after the vendor's beam hardening correction of their line integrals.

        Parameters
        ----------
        reading : ndarray, shape (views, rows, columns)
            Relative to air at fluence 1. Readings below MIN_SIGNAL count as MIN_SIGNAL.
        """
        if self.correction == UNCORRECTED:
            return reading
        air = self.measured_air
        lines = -np.log(np.maximum(reading, MIN_SIGNAL * air) / air)
        return air * np.exp(-correction_polynomial(lines, self.correction)[0])

    @property
    def _correction_slope(self) -> np.ndarray | float:
        """Derivative of the stored line integral with respect to the measured one."""
        if self.correction == UNCORRECTED:
            return 1.0
        return correction_polynomial(-np.log(self._mean_reading / self.measured_air), self.correction)[1]

    def read_out(
        self,
        signal: np.ndarray,
        squared: bool = False,
        before_scan: np.ndarray | None = None,
        step: int | None = None,
        earlier: np.ndarray | None = None,
    ) -> np.ndarray:
        """Apply crosstalk and afterglow to a signal.

        Parameters
        ----------
        signal : ndarray, shape (views, rows, columns)
        squared : bool, optional
            Whether `signal` is the variance of independent values; weights are then squared.
        before_scan : ndarray, shape (rows, columns), optional
            Signal of the views before the scan; None: the signal of the first view.
        step : int, optional
            Scanner views from one view to the next; None: as in the geometry.
        earlier : ndarray, shape (EARLIER_VIEWS, views, rows, columns), optional
            As State.earlier.
        """
        if before_scan is not None:
            before_scan = with_crosstalk(before_scan[None], self.neighbours, self.tail, squared)[0]
        step = step or self.geometry.views_apart
        signal = with_crosstalk(signal, self.neighbours, self.tail, squared)
        if earlier is not None:
            earlier = np.stack([with_crosstalk(views, self.neighbours, self.tail, squared) for views in earlier])
        reading = with_afterglow(signal, self.lag, squared, before_scan, step, earlier)
        if not (slow := self.slow_lag[0]):
            return reading
        if squared:  # slow afterglow sums so many views that it adds no noise
            return reading * ((1 - self.lag[0] - slow) / (1 - self.lag[0])) ** 2
        # Both afterglows start from the same signal and add up.
        return reading + with_afterglow(signal, self.slow_lag, False, before_scan, step, earlier) - signal

    def sample_earlier_signal(
        self, mean: np.ndarray, variance: np.ndarray, random: np.random.Generator
    ) -> np.ndarray | None:
        """Sample the noisy mean of the signal before the scan, weighted as in the afterglow; None without afterglow.

        Parameters
        ----------
        mean, variance : ndarray, shape (rows, columns)
            Mean and variance of the signal of one view.
        """
        if not (self.lag[0] or self.slow_lag[0]):
            return None
        memory = self.lag[1] if self.lag[0] else self.slow_lag[1]
        # Sum of the squared weights (1 - d) d^i of the views.
        return mean + random.normal(size=mean.shape) * np.sqrt(variance * (1 - memory) / (1 + memory))


def correction_polynomial(lines: np.ndarray, correction: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return p + a p^2 + b p^3 of line integrals p, and its derivative; it is linear above CORRECTION_LIMIT."""
    square, cube = correction
    inside = np.minimum(lines, CORRECTION_LIMIT)
    slope = 1 + 2 * square * inside + 3 * cube * inside**2
    return inside + square * inside**2 + cube * inside**3 + slope * (lines - inside), slope


def with_crosstalk(
    array: np.ndarray, neighbours: tuple[float, float], tail: float = 0.0, squared: bool = False
) -> np.ndarray:
    """Convolve with crosstalk along columns and rows. Signal that would leave is reflected at the detector's edges.

    Parameters
    ----------
    array : ndarray, shape (views, rows, columns)
    neighbours : tuple of 2 float
        c along columns and along rows.
    tail : float, optional
        q, as `Sharing.of` takes it.
    squared : bool, optional
        Square the weights, for variances of independent values.
    """
    for axis, share in zip((2, 1), neighbours, strict=True):
        if share and array.shape[axis] > 1:
            sharing = Sharing.of(share, tail, array.shape[axis])
            array = (sharing.squared() if squared else sharing).along(array, axis)
    return array


@dataclass(frozen=True)
class Sharing:
    """Symmetric convolution along one axis of a detector whose signal is reflected at both edges.

    Attributes
    ----------
    weights : ndarray, shape (reach + 1,)
        Weights of a pixel and of the pixels 1, 2, ... apart.
    edge : ndarray, shape (reach, reach)
        Weights of the pixels next to an edge for each other in addition, by distance from the edge.
    """

    weights: np.ndarray
    edge: np.ndarray

    @classmethod
    def of(cls, share: float, tail: float, length: int) -> Sharing:
        """Return weights 1 - 2c, and c (1 - q) q^(n - 1) of pixel n on each side, for c = `share` and q = `tail`.

        The last weight includes all further pixels: those that receive less than MIN_SIGNAL of c, as smaller signals
        have no logarithm, and those farther away than half the length.

        Parameters
        ----------
        length : int
            Pixels along the axis, at least 2.
        """
        reach = min(math.ceil(math.log(MIN_SIGNAL) / math.log(tail)) if tail else 1, length // 2)
        sides = share * (1 - tail) * tail ** np.arange(reach)
        sides[-1] = share * tail ** (reach - 1)
        return cls(np.array([1 - 2 * share, *sides]), scipy.linalg.hankel(sides))

    def squared(self) -> Sharing:
        """Return the convolution of variances of independent values."""
        near = scipy.linalg.toeplitz(self.weights[:-1])
        return Sharing(self.weights**2, (near + self.edge) ** 2 - near**2)

    def between_neighbors(self, variance: np.ndarray, axis: int) -> np.ndarray:
        """Return the covariance of neighbors along an axis, for variances of independent values.

        This is the sum over k of M[i, k] M[i + 1, k] v[k], where M is the matrix of the convolution.
        """
        variance, reach = np.moveaxis(variance, axis, -1), len(self.edge)
        products, last = self.weights[:-1] * self.weights[1:], variance.shape[-1] - 1
        result = products[0] * (variance[..., :-1] + variance[..., 1:])
        for apart, product in enumerate(products[1:], start=1):
            result[..., apart:] += product * variance[..., : last - apart]
            result[..., : last - apart] += product * variance[..., 1 + apart :]
        far = scipy.linalg.toeplitz(self.weights)[:, :-1]
        near = far + np.vstack([self.edge, np.zeros(reach)])
        edge = (near[:-1] * near[1:] - far[:-1] * far[1:]).T
        result[..., :reach] += np.dot(variance[..., :reach], edge)
        result[..., -reach:] += np.dot(variance[..., -reach:], edge[::-1, ::-1])
        return np.moveaxis(result, -1, axis)

    @property
    def correlations(self) -> np.ndarray:
        """Correlations of pixels 1, 2, ... apart far from the edges, for independent values of equal variance."""
        kernel = np.concatenate([self.weights[:0:-1], self.weights])
        products = np.correlate(kernel, kernel, "full")[len(kernel) - 1 :]
        return products[1:] / products[0]

    def along(self, array: np.ndarray, axis: int) -> np.ndarray:
        """Return an array convolved along an axis."""
        array = np.moveaxis(array, axis, -1)
        result = self.weights[0] * array
        for apart, weight in enumerate(self.weights[1:], start=1):
            result[..., apart:] += weight * array[..., :-apart]
            result[..., :-apart] += weight * array[..., apart:]
        reach = len(self.edge)
        result[..., :reach] += np.dot(array[..., :reach], self.edge)
        result[..., -reach:] += np.dot(array[..., -reach:], self.edge[::-1, ::-1])
        return np.moveaxis(result, -1, axis)


def with_afterglow(
    array: np.ndarray,
    lag: tuple[float, float, float],
    squared: bool = False,
    before_scan: np.ndarray | None = None,
    step: int = 1,
    earlier: np.ndarray | None = None,
) -> np.ndarray:
    """Apply exponential afterglow: y_i = (1 - k) x_i + k g_i with g_(i+1) = d g_i + (1 - d) x_i.

    Parameters
    ----------
    array : ndarray, shape (views, ...)
    lag : tuple of 3 float
        (k, d, before) as State.lag.
    squared : bool, optional
        Square the weights, for variances of independent values.
    before_scan : ndarray, optional
        Signal of the views before the scan; None: the signal of the first view.
    step : int, optional
        Scanner views from one view to the next. Views in between are interpolated.
    earlier : ndarray, shape (EARLIER_VIEWS, views, ...), optional
        As `interpolate_views` takes it.
    """
    share, memory, before = lag
    if not share:
        return array
    if step > 1:
        return with_afterglow(interpolate_views(array, step, earlier), lag, squared, before_scan)[::step]
    prompt, late, decay, new = 1 - share, share, memory, 1 - memory
    start = array[0] if before_scan is None else before_scan
    glow = before * start
    if squared:
        prompt, late, decay, new = prompt**2, late**2, decay**2, new**2
        glow = before**2 * start * new / (1 - decay)
    result = np.empty(array.shape)
    for view, signal in enumerate(array):
        result[view] = prompt * signal + late * glow
        glow = decay * glow + new * signal
    return result


def interpolate_views(array: np.ndarray, step: int, earlier: np.ndarray | None = None) -> np.ndarray:
    """Return the views of a scan and, interpolated linearly, the scanner views between them.

    Parameters
    ----------
    array : ndarray, shape (views, ...)
    step : int
        Scanner views from one view to the next.
    earlier : ndarray, shape (EARLIER_VIEWS, views, ...), optional
        Values at EARLIER_VIEWS before each view, if known.

    Returns
    -------
    ndarray, shape (1 + step (views - 1), ...)
    """
    if step == 1:
        return array
    # Known values for each view but the first, by their distance back in scanner views: the view itself, some earlier
    # ones, and the view before.
    distance, known = [0.0, float(step)], [array[1:], array[:-1]]
    for count, values in [] if earlier is None else zip(EARLIER_VIEWS, earlier, strict=True):
        if count < step:
            distance.insert(-1, float(count))
            known.insert(-1, values[1:])
    result = np.empty((1 + step * (len(array) - 1), *array.shape[1:]), array.dtype)
    result[0] = array[0]
    for back in range(step):
        nearest = int(np.searchsorted(distance, back, side="right")) - 1
        share = (back - distance[nearest]) / (distance[nearest + 1] - distance[nearest])
        result[step - back :: step] = known[nearest] * (1 - share) + known[nearest + 1] * share
    return result
