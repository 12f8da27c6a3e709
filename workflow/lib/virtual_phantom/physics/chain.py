"""The acquisition chain: the baseline and whatever effects are switched on, from path lengths to the mean signal.

Baseline [1]_: one energy, a point source, an ideal detector, Poisson noise, the logarithm. Effects act in the order of
`effect.STAGES`; with none the chain gives the baseline.

References
----------
.. [1] Flouris et al., Sci. Rep. 12, 2022.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ..base.geometry import ScanGeometry, orbit_of
from ..base.recent import Kept
from .effect import (
    OF_AIR,
    OF_AIR_PER_SCAN,
    PER_SCAN,
    PER_VIEW,
    READOUT_UNITS,
    STAGES,
    Parameter,
    load,
    needs_times,
)
from .materials import attenuation_per_mm
from .poisson import poisson_counts
from .posed import NearScene, PosedScene, Scan
from .scene import IN_PLACE, Pose, VoxelScene
from .sensors import Sensor
from .spectra import SENSOR, TUNGSTEN, Anode, Filters, Spectrum, passing

# A fit varies one parameter at a time, and most leave earlier steps alone. A focal spot takes nine.
PATHS_KEPT, TRANSMISSIONS_KEPT = 20, 24
EVEN, SOLID_ANGLE = "even", "solid_angle"
PHOTONS, AIR = "photons", "air"  # of a readout: its unit
LEAST_SIGNAL = 1e-6  # of the signal in air: a logarithm of less is none
MOST_NOISE = 0.2  # variance of line integrals up to which moments of the logarithm follow their series
NODES = 4096  # of the table of one material's transmission: errors under 1e-6 at 1/mm and 100 mm


@dataclass
class State:
    """What effects change, stage by stage.

    Attributes
    ----------
    geometry : ScanGeometry
        Of the scan as it really is.
    photons : float
        Noise-equivalent quanta of a pixel in air at fluence 1, that is 1 over its relative quantum variance: 1/A. Where
        all photons count alike, their number. What widens all deposits alike (the light's part of Swank's factor)
        lowers it and stands nowhere else.
    motion_mm : ndarray, shape (views, 3), or None
        Displacement of the object, mm.
    anode : Anode
        Of the tube.
    sensor : Sensor
        Of the detector.
    spectrum : Spectrum or None
        What is read out of the beam without an object; None for the monochromatic beam.
    sources : tuple of tuple of 4 float
        Displacements of points of the focal spot along the columns, the rows and the central ray, away from the
        isocentre, mm, and their weights.
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
    gain : ndarray or None
        Of each pixel since the air scan, a factor broadcastable to (rows, columns).
    dark : ndarray or None
    dark_air : float
        Read out beside the signal and no photons, in readout units: in the scan, broadcastable to (views, rows,
        columns), and in the air scan.
    readout : float or {"photons", "air"}
        Mean reading of the air scan in readout units; PHOTONS where these are photons; AIR where no reading is known
        and the mean signal in air takes their place.
    """

    geometry: ScanGeometry
    photons: float = 1e5
    motion_mm: np.ndarray | None = None
    anode: Anode = TUNGSTEN
    sensor: Sensor = SENSOR
    spectrum: Spectrum | None = None
    sources: tuple[tuple[float, float, float, float], ...] = ((0.0, 0.0, 0.0, 1.0),)
    filters: Filters = ()
    fluence: np.ndarray = field(default_factory=lambda: np.ones((1, 1, 1)))
    signal: np.ndarray | None = None
    air: np.ndarray | None = None
    noise: np.ndarray | None = None
    electronic: float = 0.0
    neighbours: tuple[float, float] = (0.0, 0.0)
    lag: tuple[float, float, float] = (0.0, 0.0, 1.0)
    gain: np.ndarray | None = None
    dark: np.ndarray | None = None
    dark_air: float = 0.0
    readout: float | str = PHOTONS

    @property
    def unit(self) -> float:
        """Readout units of the signal 1."""
        if self.readout == PHOTONS:
            return self.photons
        air = float(self.air.mean())
        return 1 / air if self.readout == AIR else (self.readout - self.dark_air) / air

    def __post_init__(self):
        if self.noise is None:
            self.noise = self.signal

    @property
    def measured(self) -> np.ndarray:
        """The mean signal as it is read out, shape (views, rows, columns)."""
        signal = self.read(self.signal)
        signal = signal if self.gain is None else signal * self.gain
        return signal if self.dark is None else np.maximum(signal + self.dark / self.unit, LEAST_SIGNAL)

    @property
    def measured_air(self) -> np.ndarray:
        """The air scan as it is read out, shape (views or 1, rows, columns)."""
        return shared(self.air, self.neighbours) + self.dark_air / self.unit

    def read(
        self, signal: np.ndarray, squared: bool = False, first: np.ndarray | None = None, apart: int | None = None
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

        Returns
        -------
        ndarray, shape (views, rows, columns)
        """
        first = None if first is None else shared(first[None], self.neighbours, squared)[0]
        apart = apart or self.geometry.views_apart
        return lagged(shared(signal, self.neighbours, squared), self.lag, squared, first, apart)

    def drawn_before(self, mean: np.ndarray, variance: np.ndarray, random: np.random.Generator) -> np.ndarray | None:
        """A mean over the views before the scan, as their glow weighs them, that is as noisy as these are.

        Parameters
        ----------
        mean, variance : ndarray, shape (rows, columns)
            Of the signal of one such view.
        random : numpy.random.Generator

        Returns
        -------
        ndarray, shape (rows, columns), or None
            None without afterglow.
        """
        if not self.lag[0]:
            return None
        return mean + random.normal(size=mean.shape) * np.sqrt(variance * (1 - self.lag[1]) / (1 + self.lag[1]))

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
        quantum, electronic = self._noise_parts()
        first = quantum + electronic
        noise, quantum = np.minimum(first, MOST_NOISE), np.minimum(quantum, MOST_NOISE)
        return first / 2 + 0.75 * noise**2 - quantum**2 / 3, first + 2.5 * noise**2 - quantum**2

    def _noise_parts(self) -> tuple[np.ndarray, np.ndarray]:
        """Variances of what is read over the square of its mean: quantum and electronic."""
        if self.dark is None:  # gains change signal and noise alike
            over = 1 / self.read(self.signal) ** 2
        else:
            over = (1.0 if self.gain is None else self.gain) ** 2 / self.measured**2
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
        earlier, electronic = random.spawn(2)
        each = np.divide(self.noise, self.signal, out=np.ones_like(self.signal), where=self.signal > 0)
        before = self.drawn_before(self.signal[0] * self.photons, self.noise[0] * self.photons, earlier)
        # Of views that are left out, the glow that they leave has noise of its own.
        apart = self.geometry.views_apart if self.lag[0] else 1
        signal, each = between(self.signal, apart), between(each, apart)
        drawn = poisson_counts(signal / each * self.photons, random) * each
        read = self.read(drawn, first=before, apart=1)[::apart]
        if self.electronic:
            read += self.electronic * electronic.normal(size=read.shape)
        read = read if self.gain is None else read * self.gain
        return read if self.dark is None else read + self.dark * (self.photons / self.unit)


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

    Returns
    -------
    ndarray, shape (views, ...)
    """
    share, memory, before = lag
    if not share:
        return array
    if apart > 1:
        return lagged(between(array, apart), lag, squared, first)[::apart]
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


def between(array: np.ndarray, apart: int) -> np.ndarray:
    """[view, ...] with `apart` - 1 further ones from each view to the next, interpolated linearly."""
    if apart == 1:
        return array
    place = np.arange((len(array) - 1) * apart + 1) / apart
    low = np.minimum(place.astype(int), max(len(array) - 2, 0))
    share = (place - low).reshape(-1, *[1] * (array.ndim - 1))
    return array[low] * (1 - share) + array[np.minimum(low + 1, len(array) - 1)] * share


def blurred(array: np.ndarray, share: float, axis: int, squared: bool = False) -> np.ndarray:
    """(c, 1 - 2c, c) along an axis, edge pixels keeping what would leave.

    Parameters
    ----------
    array : ndarray
    share : float
        c.
    axis : int
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


class Chain:
    """The mean signal of a scene in a geometry, for any settings of effects.

    Parameters
    ----------
    scene : VoxelScene
        Or what has its methods.
    geometry : ScanGeometry
    photons : float, optional
        As State.photons.
    samples : int, optional
        Rays per pixel and direction, whose signals are averaged (`quadrature`); 1 is the baseline's ray to its centre.
    illumination : {"even", "solid_angle"}, optional
        EVEN: all pixels get the same photons in air; SOLID_ANGLE: as the source sees them.
    sensor : Sensor, optional
        Of the detector, which a spectrum is weighed by.
    readout : float or {"photons", "air"}, optional
        As State.readout.
    """

    def __init__(
        self,
        scene: VoxelScene,
        geometry: ScanGeometry,
        photons: float = 1e5,
        samples: int = 1,
        illumination: str = EVEN,
        sensor: Sensor = SENSOR,
        readout: float | str = PHOTONS,
    ):
        self.scene, self.geometry, self.photons, self.samples = scene, geometry, photons, samples
        self.illumination, self.sensor, self.readout = illumination, sensor, readout
        rays = len(quadrature(samples, geometry.rows > 1))
        self._paths, self._transmissions = Kept(PATHS_KEPT * rays), Kept(TRANSMISSIONS_KEPT)

    def copy(self, geometry: ScanGeometry | None = None, samples: int | None = None) -> Chain:
        """The same, of another geometry or number of rays if one is given, with nothing kept."""
        return self._of(self.scene, geometry or self.geometry, samples or self.samples)

    def _of(self, scene: VoxelScene, geometry: ScanGeometry, samples: int) -> Chain:
        return Chain(scene, geometry, self.photons, samples, self.illumination, self.sensor, self.readout)

    def near(self, physics: Mapping[str, Mapping[str, float]], pose: Pose = IN_PLACE, **extra) -> Chain:
        """The same, whose rays follow to first order those that given settings send, where they lie near enough.

        Parameters
        ----------
        physics, pose, **extra
            As `state` takes them.

        Returns
        -------
        Chain
            This one, where the scene traces all rays or follows others already.
        """
        if not isinstance(self.scene, PosedScene):
            return self
        return self._of(self.scene.near(self._scans(physics, pose, extra)), self.geometry, self.samples)

    def follows(self, physics: Mapping[str, Mapping[str, float]], pose: Pose = IN_PLACE, **extra) -> bool:
        """Whether all rays that given settings send lie near enough to those that they may follow.

        Parameters
        ----------
        physics, pose, **extra
            As `state` takes them.

        Returns
        -------
        bool
            True also where the scene traces all rays.
        """
        return not isinstance(self.scene, NearScene) or all(map(self.scene.follows, self._scans(physics, pose, extra)))

    def _scans(self, physics: Mapping[str, Mapping[str, float]], pose: Pose, extra: Mapping) -> list[Scan]:
        """What these settings ask of the scene."""
        state, _ = self._before_the_object(physics, **extra)
        return [
            (beside, pose, state.motion_mm)
            for *place_mm, _ in state.sources
            for beside, _, _ in self._rays(displaced(state.geometry, *place_mm))
        ]

    def parameters(self, name: str) -> tuple[Parameter, ...]:
        """An effect's parameters with range, start, typical strength and unit as this scan shows them.

        Those that it cannot show (`held`) are left out.

        Returns
        -------
        tuple of Parameter

        Raises
        ------
        InputError
            For an effect that needs the scan's times where they are not known.
        """
        air = {PHOTONS: self.photons, AIR: 1.0}.get(self.readout, self.readout)
        unit = {PHOTONS: "photons", AIR: "of air"}.get(self.readout, READOUT_UNITS)
        scan, geometry = {OF_AIR: air}, self.geometry
        if geometry.view_interval_ms is not None:
            scan |= {PER_VIEW: geometry.view_interval_ms, PER_SCAN: 1 / geometry.duration_s}
            scan[OF_AIR_PER_SCAN] = air / geometry.duration_s
        return tuple(
            replace(one.within(scan), unit=one.unit.replace(READOUT_UNITS, unit))
            for one in load(name).parameters
            if one.name not in self.held(name)
        )

    def held(self, name: str) -> dict[str, float]:
        """Parameters of an effect that a scan without known times cannot show, at the values where they do nothing.

        Returns
        -------
        dict of str to float

        Raises
        ------
        InputError
            For an effect that is nothing without them.
        """
        timed = [one for one in load(name).parameters if one.timed]
        if self.geometry.view_interval_ms is not None or not timed:
            return {}
        if needs_times(name):
            self.geometry.known_interval_ms  # noqa: B018  raises
        return {one.name: one.neutral for one in timed}

    def state(
        self, physics: Mapping[str, Mapping[str, float]], pose: Pose = IN_PLACE, photons: float | None = None, **extra
    ) -> State:
        """The chain run through, means and what noise needs.

        Parameters
        ----------
        physics : mapping of str to mapping of str to float
            {effect: {parameter: value}}; none gives the baseline.
        pose : Pose, optional
            Of the object.
        photons : float, optional
            As State.photons; None: the chain's.
        **extra
            Fields of the State to begin with.

        Returns
        -------
        State
        """
        state, behind = self._before_the_object(physics, photons, **extra)
        self._transmit(state, pose)
        for effect in behind:
            effect.apply(state, physics[effect.name])
        return state

    def _before_the_object(self, physics, photons: float | None = None, **extra) -> tuple[State, list]:
        """The state of the beam that meets the object, and the effects that come behind it."""
        state = State(self.geometry, photons or self.photons, sensor=self.sensor, readout=self.readout, **extra)
        if self.illumination == SOLID_ANGLE:
            state.fluence = self.geometry.solid_angles()
        effects = sorted((load(name) for name in physics), key=lambda effect: STAGES.index(effect.stage))
        before = [effect for effect in effects if STAGES.index(effect.stage) < STAGES.index("scatter")]
        for effect in before:
            effect.apply(state, physics[effect.name])
        return state, effects[len(before) :]

    def _transmit(self, state: State, pose: Pose) -> None:
        beam, air = self._beam(state)
        total = 0.0
        for *place_mm, weight in state.sources:
            geometry = displaced(state.geometry, *place_mm)
            total = total + weight * self.transmission(geometry, pose, state.motion_mm, beam)
        if beam is None:  # one energy: filters thin the beam and no more
            total = total * air
        state.air = np.broadcast_to(air * state.fluence, (state.fluence.shape[0], *total.shape[2:])).copy()
        state.signal = state.noise = total[0] * state.fluence
        if len(total) > 1:
            state.noise = total[1] * state.fluence

    def _beam(self, state: State) -> tuple[Spectrum | None, np.ndarray]:
        """The spectrum behind the filters, if there is one, and the beam's signal without an object.

        Returns
        -------
        spectrum : Spectrum or None
        air : ndarray
            Signal, broadcastable to (rows, columns).
        """
        if not state.filters:
            return state.spectrum, np.ones((1, 1))
        if state.spectrum is None:
            return None, passing(state.filters, [self.scene.energy_kev])[0]
        beam = state.spectrum.behind(state.filters)
        return beam, beam.signal.sum(axis=0)

    def transmission(
        self, geometry: ScanGeometry, pose: Pose, motion_mm=None, beam: Spectrum | None = None
    ) -> np.ndarray:
        """Signal, and its quantum variance where these are other shares, over those in air without filters.

        Parameters
        ----------
        geometry : ScanGeometry
        pose : Pose
            Of the object.
        motion_mm : ndarray, shape (views, 3), optional
            As State.motion_mm.
        beam : Spectrum, optional
            Its shares may be of every row and column, shape (energies, rows, columns); None: the monochromatic beam.

        Returns
        -------
        ndarray of float64, shape (1 or 2, views, rows, columns)
        """
        rays = (geometry.key, pose, None if motion_mm is None else motion_mm.tobytes())
        key = None if beam is None else beam.key
        return self._transmissions.get((rays, key), lambda: self._transmission(rays, geometry, pose, motion_mm, beam))

    def _transmission(self, rays, geometry, pose, motion_mm, beam) -> np.ndarray:
        total = 0.0
        for beside, place, weight in self._rays(geometry):
            paths = self._paths.get(
                (rays, place), lambda beside=beside: self.scene.path_lengths(beside, pose, motion_mm)
            )
            total = total + weight * self._through(paths, beam)
        return total

    def _rays(self, geometry: ScanGeometry) -> list[tuple[ScanGeometry, tuple[float, float], float]]:
        """Of a geometry, those of one ray per pixel that are averaged: (geometry, where in the pixel, weight)."""
        return [
            (
                replace(
                    geometry,
                    column_offset_px=geometry.column_offset_px + place[0],
                    row_offset_px=geometry.row_offset_px + place[1],
                ),
                place,
                weight,
            )
            for place, weight in quadrature(self.samples, geometry.rows > 1)
        ]

    def _through(self, paths: np.ndarray, beam: Spectrum | None) -> np.ndarray:
        if beam is None:
            return np.exp(-np.tensordot(self.scene.attenuation_per_mm, paths.astype(np.float64), 1))[None]
        table = np.stack([attenuation_per_mm(material, beam.energies_kev) for material in self.scene.materials])
        return transmitted(paths, table, np.stack([beam.signal, beam.noise]))


def transmitted(paths: np.ndarray, attenuation_per_mm: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Shares of the signal and of its variance that many energies leave.

    One material's transmission is a function of the path length alone, if pixels share a beam, and is taken from a
    table.

    Parameters
    ----------
    paths : ndarray, shape (materials, ...)
        Path lengths, mm.
    attenuation_per_mm : ndarray, shape (materials, energies)
        1/mm.
    shares : ndarray, shape (shares, energies) or (shares, energies, rows, columns)
        In air, of all pixels or of every one.

    Returns
    -------
    ndarray of float64, shape (shares, ...)
    """
    total = np.zeros((len(shares), *paths.shape[1:]))
    if len(paths) == 1 and shares.ndim == 2:
        nodes = np.linspace(0, max(float(paths.max()), 1e-6), NODES)
        logarithms = np.log(np.exp(-np.outer(nodes, attenuation_per_mm[0])) @ shares.T).T
        for one, logarithm in zip(total, logarithms, strict=True):
            one[...] = np.exp(np.interp(paths[0], nodes, logarithm))
        return total
    for column, weights in zip(attenuation_per_mm.T.astype(np.float32), shares.swapaxes(0, 1), strict=True):
        left = np.exp(-np.tensordot(column, paths, 1))
        for one, weight in zip(total, weights, strict=True):
            one += weight * left
    return total


def quadrature(samples: int, of_rows: bool = True) -> list[tuple[tuple[float, float], float]]:
    """Where rays meet a pixel: Gauss and Legendre's nodes, so that two per direction blur as the whole pixel does.

    Rays evenly spaced would blur by 1 - 1 / samples^2 of that.

    Parameters
    ----------
    samples : int
        Rays per direction.
    of_rows : bool, optional
        False for a detector of one row (fan beam), whose rays stay in the plane.

    Returns
    -------
    list of tuple
        ((column, row) from the pixel's centre in pixels, weight).
    """
    nodes, weights = np.polynomial.legendre.leggauss(samples)
    columns = [(float(node) / 2, float(weight) / 2) for node, weight in zip(nodes, weights, strict=True)]
    rows = columns if of_rows else [(0.0, 1.0)]
    return [((column, row), one * other) for row, other in rows for column, one in columns]


def displaced(geometry: ScanGeometry, column_mm: float, row_mm: float, away_mm: float = 0.0) -> ScanGeometry:
    """The geometry of a point of the focal spot beside its centre.

    A source moved by s along the column axis stands where a gantry turned by -s/R would put it; the detector, which
    stays, then lies s (D - R)/R off in the turned frame. Its tilt against that frame (s/R) is neglected.

    Parameters
    ----------
    geometry : ScanGeometry
    column_mm, row_mm : float
        Along the detector's columns and rows.
    away_mm : float, optional
        Along the central ray, away from the isocentre.

    Returns
    -------
    ScanGeometry

    Raises
    ------
    InputError
        If the point is displaced and the scan is no circle or helix.
    """
    if not column_mm and not row_mm and not away_mm:
        return geometry
    geometry = orbit_of(geometry, "focal_spot")
    radius, distance = geometry.source_to_isocentre_mm, geometry.source_to_detector_mm
    turn = -column_mm / radius
    return replace(
        geometry,
        angles_rad=geometry.angles_rad + turn,
        column_offset_px=geometry.column_offset_px - turn * (distance - radius) / geometry.column_pitch_mm,
        source_z_mm=geometry.source_z_mm + row_mm,
        source_to_isocentre_mm=radius + away_mm,
        source_to_detector_mm=distance + away_mm,
        row_offset_px=geometry.row_offset_px - row_mm / geometry.row_pitch_mm,
    )
