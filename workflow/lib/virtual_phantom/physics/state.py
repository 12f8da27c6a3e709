"""What effects change of a scan, stage by stage, and what is read out of it: means, noise and line integrals."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from ..base.geometry import ScanGeometry
from ..base.mounting import AS_STATED, Mounting
from ..base.pose import Pose
from .beam.sensors import Sensor
from .beam.spectra import SENSOR, TUNGSTEN, Anode, Filters, Spectrum

PHOTONS, AIR = "photons", "air"  # of a readout: its unit
LEAST_SIGNAL = 1e-6  # of the signal in air: a logarithm of less is none
# Views of the scanner before each one that is there, by which a glow is followed: of a clinical scan of which one view
# in 15 is fitted they leave 1 to 5 % of what a glow of 4 to 14 ms changes, (1, 3, 7) 8 %, none of them 70 to 95 %.
EARLIER = (1, 2, 3, 5, 8)
LINEAR = (1.0, 0.0)  # response of a detector whose readings are proportional to the signal
AS_READ = (0.0, 0.0)  # a polynomial on line integrals that leaves them as they are
MOST_CORRECTED = 10.0  # line integral from which such a polynomial goes on as a straight line: makers' tables end too
MOST_NOISE = 0.2  # variance of line integrals up to which moments of the logarithm follow their series


class InObject(Protocol):
    """What lies in an object, as inclusion.Inclusion: path lengths of rays in it, and a key of what it is."""

    key: Hashable

    def lengths_mm(self, geometry: ScanGeometry, pose: Pose, motion_mm: np.ndarray | None) -> np.ndarray:
        """As Inclusion.lengths_mm."""


Added = tuple[tuple[InObject, float], ...]  # by how much each attenuates more than what is there, 1/mm


@dataclass
class State:
    """What effects change, stage by stage.

    Attributes
    ----------
    geometry : ScanGeometry
        Of the scan as it really is, but for what turns the detector.
    photons : float
        Noise-equivalent quanta of a pixel in air at fluence 1, that is 1 over its relative quantum variance: 1/A. Where
        all photons count alike, their number. What widens all deposits alike (the light's part of Swank's factor)
        lowers it and stands nowhere else.
    motion_mm : ndarray, shape (views, 3), or None
        Displacement of the object, mm.
    added : tuple of tuple of InObject and float
        What lies in the object beside what the scene has, and by how much it attenuates more, 1/mm.
    anode : Anode
        Of the tube.
    sensor : Sensor
        Of the detector.
    spectrum : Spectrum or None
        What is read out of the beam without an object; None for the monochromatic beam.
    sources : tuple of tuple of 4 float
        Displacements of points of the source along the columns, the rows and the central ray, away from the isocentre,
        mm, and their weights: of the photons that leave towards a pixel, a number or an array broadcastable to (rows,
        columns) where a collimator hides some.
    jump_mm : ndarray, shape (views, 3), or None
        Displacement of the source in every view, as of `sources`.
    turns : tuple of tuple of 2 float
        When during a view rays are taken, in intervals from its middle, and the weights of these moments.
    filters : tuple of tuple of str and ndarray
        Materials that the beam passes before the object, and their thickness in mm, broadcastable to (rows, columns);
        over that of the central ray where this is in the spectrum already.
    fluence : ndarray
        Photons that leave the tube towards each pixel, relative, broadcastable to (views, rows, columns).
    signal, air : ndarray, shape (views, rows, columns), or None
        Mean signal with the object and without (air may have one view), over the signal of a pixel in air at fluence 1.
    noise : ndarray, shape (views, rows, columns), or None
        Quantum variance of the signal, times `photons`: the signal itself where all photons count alike.
    electronic : float
        Standard deviation of electronic noise, in photons: of each, the signal in air over `photons`.
    neighbours : tuple of 2 float
        (column, row): share of the signal that goes to the next pixel on either side, after the quantum noise is in it.
    lag : tuple of 3 float
        (share, memory, before): share of a view's signal that is read with later views, what of the glow each further
        view of the scanner leaves, and how much of it there is before the first view, over what that view's signal
        would bring about if it lasted.
    earlier : ndarray, shape (EARLIER, views, rows, columns), or None
        `signal` so many of the scanner's views before each, of a scan of which some are left out and that glows on;
        None: it is interpolated from the views that are there.
    slow_lag : tuple of 3 float
        As `lag`, of a second glow that fades over so many views that its own noise averages out.
    grid : tuple of 2 float
        Height of the septa over their gap, across the columns and across the rows; 0: there are none. What is scattered
        further sideways they stop.
    response : tuple of 2 float
        (exponent, loss): what is read of the signal N in photons, when neighbours have shared it, it has glowed on and
        electronic noise is in it, goes as N^exponent / (1 + loss N), in the scan and in the air scan.
    gain : ndarray or None
        Of each pixel since the air scan, a factor broadcastable to (rows, columns).
    correction : tuple of 2 float
        (a, b): in the place of line integrals p the maker stores p + a p^2 + b p^3.
    dark_air : float
        Read out beside the signal and no photons, in readout units: in the scan, broadcastable to (views, rows,
        columns), and in the air scan.
    readout : float or {"photons", "air"}
        Mean reading of the air scan in readout units; PHOTONS where these are photons; AIR where no reading is known
        and the mean signal in air takes their place.
    mounting : Mounting
        How the detector hangs in the geometry.
    """

    geometry: ScanGeometry
    photons: float = 1e5
    motion_mm: np.ndarray | None = None
    added: Added = ()
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
    lag: tuple[float, float, float] = (0.0, 0.0, 1.0)
    earlier: np.ndarray | None = None
    slow_lag: tuple[float, float, float] = (0.0, 0.0, 1.0)
    grid: tuple[float, float] = (0.0, 0.0)
    response: tuple[float, float] = LINEAR
    gain: np.ndarray | None = None
    correction: tuple[float, float] = AS_READ
    dark: np.ndarray | None = None
    dark_air: float = 0.0
    readout: float | str = PHOTONS
    mounting: Mounting = AS_STATED

    @property
    def unit(self) -> float:
        """Readout units of the signal 1."""
        if self.readout == PHOTONS:
            return self.photons
        air = float(self.responded(self.air).mean())
        return 1 / air if self.readout == AIR else (self.readout - self.dark_air) / air

    def __post_init__(self):
        if self.noise is None:
            self.noise = self.signal

    @property
    def measured(self) -> np.ndarray:
        """The mean signal as it is stored, shape (views, rows, columns)."""
        return self.corrected(self._read_out)

    @property
    def _read_out(self) -> np.ndarray:
        """The mean signal as it is read out, shape (views, rows, columns)."""
        signal = self.responded(self.mean_read)
        signal = signal if self.gain is None else signal * self.gain
        return signal if self.dark is None else np.maximum(signal + self.dark / self.unit, LEAST_SIGNAL)

    @property
    def measured_air(self) -> np.ndarray:
        """The air scan as it is read out, shape (views or 1, rows, columns)."""
        return self.responded(shared(self.air, self.neighbours)) + self.dark_air / self.unit

    def responded(self, signal: np.ndarray) -> np.ndarray:
        """The reading of a signal by the detector's response.

        Parameters
        ----------
        signal : ndarray
            Over that of a pixel in air at fluence 1. Electronic noise may have it under 0, where the response goes on
            as on the other side.

        Returns
        -------
        ndarray
            Shaped as `signal`, and itself of a linear response.
        """
        if self.response == LINEAR:
            return signal
        exponent, loss = self.response
        return np.sign(signal) * np.abs(signal) ** exponent / (1 + loss * self.photons * np.abs(signal))

    def corrected(self, reading: np.ndarray) -> np.ndarray:
        """A reading whose line integral is corrected for beam hardening as the maker does it.

        Parameters
        ----------
        reading : ndarray, shape (views, rows, columns)
            Over that of a pixel in air at fluence 1. Readings without a logarithm count as the least that have one.

        Returns
        -------
        ndarray
            Shaped as `reading`, and itself without a correction.
        """
        if self.correction == AS_READ:
            return reading
        air = self.measured_air
        lines = -np.log(np.maximum(reading, LEAST_SIGNAL * air) / air)
        return air * np.exp(-polynomial(lines, self.correction)[0])

    def exponent(self, signal: np.ndarray) -> np.ndarray | float:
        """How ln(reading) grows with ln(signal) by the response, with signals as `responded` takes them."""
        exponent, loss = self.response
        if not loss:
            return exponent
        lost = loss * self.photons * signal
        return exponent - lost / (1 + lost)

    @property
    def per_line(self) -> np.ndarray:
        """How much signal, as it meets the response, changes a line integral by 1, to first order in either.

        Returns
        -------
        ndarray, shape (views, rows, columns)
        """
        signal = self.mean_read
        exponent = self.exponent(signal) * self._slope
        if self.dark is None:  # gains change signal and noise alike
            return signal / exponent
        slope = exponent if self.response == LINEAR else exponent * self.responded(signal) / signal
        return self._read_out / (slope if self.gain is None else slope * self.gain)

    @property
    def _slope(self) -> np.ndarray | float:
        """How a stored line integral grows with the one that is read."""
        if self.correction == AS_READ:
            return 1.0
        return polynomial(-np.log(self._read_out / self.measured_air), self.correction)[1]

    @property
    def mean_read(self) -> np.ndarray:
        """The mean signal that neighbours have shared and that lags behind, shape (views, rows, columns)."""
        return self.read(self.signal, earlier=self.earlier)

    def read(
        self,
        signal: np.ndarray,
        squared: bool = False,
        first: np.ndarray | None = None,
        apart: int | None = None,
        earlier: np.ndarray | None = None,
    ) -> np.ndarray:
        """What is read out of a signal that neighbours share and that lags behind.

        Parameters
        ----------
        signal : ndarray, shape (views, rows, columns)
        squared : bool, optional
            Of variances of independent values.
        first : ndarray, shape (rows, columns), optional
            Signal of the views before the scan; None: as that of its first view.
        apart : int, optional
            As of `lagged`; None: that of the geometry.
        earlier : ndarray, shape (EARLIER, views, rows, columns), optional
            The signal a little before, as State.earlier.

        Returns
        -------
        ndarray, shape (views, rows, columns)
        """
        first = None if first is None else shared(first[None], self.neighbours, squared)[0]
        apart = apart or self.geometry.views_apart
        signal = shared(signal, self.neighbours, squared)
        if earlier is not None:
            earlier = np.stack([shared(one, self.neighbours, squared) for one in earlier])
        read = lagged(signal, self.lag, squared, first, apart, earlier)
        if not (slow := self.slow_lag[0]):
            return read
        if squared:  # of so many views, none adds to the noise of any
            return read * ((1 - self.lag[0] - slow) / (1 - self.lag[0])) ** 2
        # Both glow beside each other: what one keeps of a view is not the other's.
        return read + lagged(signal, self.slow_lag, False, first, apart, earlier) - signal

    def drawn_before(self, mean: np.ndarray, variance: np.ndarray, random: np.random.Generator) -> np.ndarray | None:
        """A mean over the views before the scan, as their glow weighs them, that is as noisy as these are.

        Parameters
        ----------
        mean, variance : ndarray, shape (rows, columns)
            Of the signal of one such view.

        Returns
        -------
        ndarray, shape (rows, columns), or None
            None without afterglow.
        """
        if not (self.lag[0] or self.slow_lag[0]):
            return None
        memory = self.lag[1] if self.lag[0] else self.slow_lag[1]
        return mean + random.normal(size=mean.shape) * np.sqrt(variance * (1 - memory) / (1 + memory))

    def line_integrals(self) -> np.ndarray:
        """-ln(signal / air) of the means, float64, shape (views, rows, columns)."""
        return -np.log(self.measured / self.measured_air)

    def variance(self) -> np.ndarray:
        """Of the line integrals, to first order in the noise: that of the signal over its mean squared."""
        quantum, electronic = self._noise_parts()
        return quantum + electronic

    def log_noise(self) -> tuple[np.ndarray, np.ndarray]:
        """What noise adds to the mean of the line integrals, and their variance, both to second order.

        Moments of -ln(1 + x) to the fourth in x, whose third moment is that of Poisson counts: v/2 + 3/4 v^2 - q^2/3
        and v + 5/2 v^2 - q^2, of the first-order variance v and its quantum part q; for counts of mean m alone 1/(2m) +
        5/(12 m^2) and 1/m + 3/(2 m^2). Where v is over MOST_NOISE, the series says nothing any more, and the
        second-order terms stay at that.

        Returns
        -------
        mean, variance : ndarray, shape (views, rows, columns)
        """
        # A power of the signal takes its logarithm that many times, noise and all; a polynomial does to first order.
        exponent = self.exponent(self.mean_read) * self._slope
        quantum, electronic = (part / exponent**2 for part in self._noise_parts())
        first = quantum + electronic
        noise, quantum = np.minimum(first, MOST_NOISE), np.minimum(quantum, MOST_NOISE)
        above = first / 2 + 0.75 * noise**2 - quantum**2 / 3
        return exponent * above, exponent**2 * (first + 2.5 * noise**2 - quantum**2)

    def _noise_parts(self) -> tuple[np.ndarray, np.ndarray]:
        """Variances of what is read over the square of its mean: quantum and electronic."""
        over = 1 / self.per_line**2
        return self.read(self.noise / self.photons, squared=True) * over, (self.electronic / self.photons) ** 2 * over

    def counts(self, random: np.random.Generator) -> np.ndarray:
        """One noisy scan: quantum noise, shared by neighbours, and electronic noise.

        Quantum noise is drawn as so many Poisson counts of so much signal each that mean and variance are right. The
        third moment is then that of `log_noise`.

        Parameters
        ----------
        random : numpy.random.Generator
            It gives one number per pixel for the counts. What was before the scan and electronic noise have streams of
            their own, spawned from it, so that counts are the same with and without them.

        Returns
        -------
        ndarray of float64, shape (views, rows, columns)
            Photons.
        """
        from .noise.poisson import poisson_counts  # loads numba, for those who draw

        earlier, electronic = random.spawn(2)
        each = np.divide(self.noise, self.signal, out=np.ones_like(self.signal), where=self.signal > 0)
        before = self.drawn_before(self.signal[0] * self.photons, self.noise[0] * self.photons, earlier)
        # Of views that are left out, the glow that they leave has noise of its own.
        apart = self.geometry.views_apart if self.lag[0] or self.slow_lag[0] else 1
        signal, each = between(self.signal, apart), between(each, apart)
        drawn = poisson_counts(signal / each * self.photons, random) * each
        read = self.read(drawn, first=before, apart=1)[::apart]
        if self.electronic:
            read += self.electronic * electronic.normal(size=read.shape)
        if self.response != LINEAR:
            read = self.responded(read / self.photons) * self.photons
        read = read if self.gain is None else read * self.gain
        read = read if self.dark is None else read + self.dark * (self.photons / self.unit)
        return read if self.correction == AS_READ else self.corrected(read / self.photons) * self.photons


def polynomial(lines: np.ndarray, correction: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """The polynomial p + a p^2 + b p^3 and its slope; from MOST_CORRECTED on a straight line.

    Parameters
    ----------
    lines : ndarray
        Line integrals p.
    correction : tuple of 2 float
        a and b.

    Returns
    -------
    values, slopes : ndarray
        Shaped as `lines`.
    """
    square, cube = correction
    inside = np.minimum(lines, MOST_CORRECTED)
    slope = 1 + 2 * square * inside + 3 * cube * inside**2
    return inside + square * inside**2 + cube * inside**3 + slope * (lines - inside), slope


def shared(array: np.ndarray, neighbours: tuple[float, float], squared: bool = False) -> np.ndarray:
    """What neighbours share: (c, 1 - 2c, c) along columns and rows.

    Signal that would leave the detector stays in the pixel at its edge.

    Parameters
    ----------
    array : ndarray, shape (views, rows, columns)
    neighbours : tuple of 2 float
        c along columns and along rows.
    squared : bool, optional
        The weights are squared: variances of independent values.

    Returns
    -------
    ndarray, shape (views, rows, columns)
    """
    for axis, share in zip((2, 1), neighbours, strict=True):
        if share and array.shape[axis] > 1:
            array = blurred(array, share, axis, squared)
    return array


def lagged(
    array: np.ndarray,
    lag: tuple[float, float, float],
    squared: bool = False,
    first: np.ndarray | None = None,
    apart: int = 1,
    earlier: np.ndarray | None = None,
) -> np.ndarray:
    """What is read where a share glows on and fades by the factor `memory` from view to view.

    Parameters
    ----------
    array : ndarray, shape (views, ...)
    lag : tuple of 3 float
        As State.lag.
    squared : bool, optional
        The weights are squared: variances of independent values.
    first : ndarray, optional
        What the views before the scan held; None: as the first view.
    apart : int, optional
        Of so many views of the scanner one is there: those between are interpolated.
    earlier : ndarray, shape (EARLIER, views, ...), optional
        As `between` takes it.

    Returns
    -------
    ndarray, shape (views, ...)
    """
    share, memory, before = lag
    if not share:
        return array
    if apart > 1:
        return lagged(between(array, apart, earlier), lag, squared, first)[::apart]
    keep, late, fading, new = 1 - share, share, memory, 1 - memory
    first = array[0] if first is None else first
    glow = before * first
    if squared:
        keep, late, fading, new = keep**2, late**2, fading**2, new**2
        glow = before**2 * first * new / (1 - fading)
    result = np.empty(array.shape)
    for view, signal in enumerate(array):
        result[view] = keep * signal + late * glow
        glow = fading * glow + new * signal
    return result


def between(array: np.ndarray, apart: int, earlier: np.ndarray | None = None) -> np.ndarray:
    """Views with those of the scanner that lie between them, interpolated linearly.

    Parameters
    ----------
    array : ndarray, shape (views, ...)
    apart : int
        From view to view.
    earlier : ndarray, shape (EARLIER, views, ...), optional
        The same so many of the scanner's views before each; None: not known.

    Returns
    -------
    ndarray, shape (1 + apart (views - 1), ...)
    """
    if apart == 1:
        return array
    behind, known = [0.0, float(apart)], [array[1:], array[:-1]]  # of every view but the first: itself, the one before
    for count, one in [] if earlier is None else zip(EARLIER, earlier, strict=True):
        if count < apart:
            behind.insert(-1, float(count))
            known.insert(-1, one[1:])
    found = np.empty((1 + apart * (len(array) - 1), *array.shape[1:]), array.dtype)
    found[0] = array[0]
    for back in range(apart):
        at = int(np.searchsorted(behind, back, side="right")) - 1
        share = (back - behind[at]) / (behind[at + 1] - behind[at])
        found[apart - back :: apart] = known[at] * (1 - share) + known[at + 1] * share
    return found


def blurred(array: np.ndarray, share: float, axis: int, squared: bool = False) -> np.ndarray:
    """(c, 1 - 2c, c) along an axis, edge pixels keeping what would leave.

    Parameters
    ----------
    share : float
        c.
    squared : bool, optional
        The weights are squared: variances of independent values.

    Returns
    -------
    ndarray
        Shaped as `array`.
    """
    middle, side = 1 - 2 * share, share
    kept = side  # what an edge pixel has beyond the middle's share
    if squared:
        middle, side, kept = middle**2, side**2, (middle + side) ** 2 - middle**2
    array = np.moveaxis(array, axis, -1)
    result = middle * array
    result[..., 1:] += side * array[..., :-1]
    result[..., :-1] += side * array[..., 1:]
    result[..., 0] += kept * array[..., 0]
    result[..., -1] += kept * array[..., -1]
    return np.moveaxis(result, -1, axis)
