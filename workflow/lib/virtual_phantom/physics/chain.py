"""The acquisition chain: the baseline and whatever effects are switched on, from path lengths to the mean signal.

Baseline [1]_: one energy, a point source, an ideal detector, Poisson noise, the logarithm. Effects act in the order of
`effect.STAGES`, those of one stage in that of their names; with none the chain gives the baseline.

References
----------
.. [1] Flouris et al., Sci. Rep. 12, 2022.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..base.geometry import OrbitGeometry, ScanGeometry
from ..base.mounting import AS_STATED
from ..base.recent import Kept
from .beam.materials import attenuation_per_mm
from .beam.sensors import Sensor
from .beam.spectra import SENSOR, Spectrum, passing
from .beam.transmission import transmitted
from .effect import (
    OF_AIR,
    OF_AIR_PER_SCAN,
    PER_AIR_PHOTON,
    PER_SCAN,
    PER_VIEW,
    READOUT_UNITS,
    STAGES,
    Parameter,
    load,
    needs_times,
)
from .scenes.inclusion import thinned
from .scenes.posed import NearScene, PosedScene, Scan
from .scenes.sampling import averaged, divided, later, sources
from .scenes.scene import IN_PLACE, Pose, VoxelScene
from .state import AIR, EARLIER, PHOTONS, Added, State

# A fit varies one parameter at a time, and most leave earlier steps alone. A focal spot takes nine.
PATHS_KEPT, TRANSMISSIONS_KEPT = 20, 24
KEPT_BYTES, LEAST_KEPT = 2e8, 3  # of either: large scans keep fewer, and work some out again
EVEN, SOLID_ANGLE = "even", "solid_angle"


class Chain:
    """The mean signal of a scene in a geometry, for any settings of effects.

    Parameters
    ----------
    scene : VoxelScene
        Or what has its methods.
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
        parts, pixels = len(divided(geometry, samples)), math.prod(geometry.shape)
        rays = pixels * samples ** (2 if geometry.rows > 1 else 1)
        self._paths = Kept(_kept(8 * rays, PATHS_KEPT) * parts)
        self._transmissions = Kept(_kept(8 * pixels, TRANSMISSIONS_KEPT))
        self._before: list[Chain] | None = None  # of the views before those that are there

    def copy(self, geometry: ScanGeometry | None = None, samples: int | None = None) -> Chain:
        """The same, of another geometry or number of rays if one is given, with nothing kept."""
        return self._of(self.scene, geometry or self.geometry, samples or self.samples)

    def _of(self, scene: VoxelScene, geometry: ScanGeometry, samples: int) -> Chain:
        return Chain(scene, geometry, self.photons, samples, self.illumination, self.sensor, self.readout)

    def near(
        self, physics: Mapping[str, Mapping[str, float]], pose: Pose = IN_PLACE, reach: float = 1.0, **extra
    ) -> Chain:
        """The same, whose rays follow to first order those that given settings send, where they lie near enough.

        Parameters
        ----------
        physics, pose, **extra
            As `state` takes them.
        reach : float, optional
            As PosedScene.near takes it.

        Returns
        -------
        Chain
            This one, where the scene traces all rays or follows others already.
        """
        if not isinstance(self.scene, PosedScene):
            return self
        return self._of(self.scene.near(self._scans(physics, pose, extra), reach), self.geometry, self.samples)

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
            for source, _ in sources(state)
            for beside, _ in divided(source, self.samples)
        ]

    @property
    def reads_in_air(self) -> float:
        """What the detector reads of the photons in air, in readout units."""
        return {PHOTONS: self.photons, AIR: 1.0}.get(self.readout, self.readout)

    def parameters(self, name: str) -> tuple[Parameter, ...]:
        """An effect's parameters with range, start, typical strength and unit as this scan shows them.

        Those that are not fitted (`held`) are left out.

        Raises
        ------
        InputError
            For an effect that needs the scan's times where they are not known.
        """
        air = self.reads_in_air
        unit = {PHOTONS: "photons", AIR: "of air"}.get(self.readout, READOUT_UNITS)
        scan, geometry = {OF_AIR: air, PER_AIR_PHOTON: 1 / self.photons}, self.geometry
        if geometry.view_interval_ms is not None:
            scan |= {PER_VIEW: geometry.view_interval_ms, PER_SCAN: 1 / geometry.duration_s}
            scan[OF_AIR_PER_SCAN] = air / geometry.duration_s
        return tuple(
            replace(one.within(scan), unit=one.unit.replace(READOUT_UNITS, unit))
            for one in load(name).parameters
            if one.name not in self.held(name)
        )

    def held(self, name: str) -> dict[str, float]:
        """Parameters of an effect that are not fitted, at the values that are taken for them.

        Those of the scanner's design are typical. Those that a scan without known times cannot show do nothing.

        Raises
        ------
        InputError
            For an effect that is nothing without its times.
        """
        every = load(name).parameters
        found = {one.name: one.typical for one in every if one.stated}
        timed = [one for one in every if one.timed]
        if self.geometry.view_interval_ms is None and timed:
            if needs_times(name):
                self.geometry.known_interval_ms  # noqa: B018  raises
            found |= {one.name: one.neutral for one in timed}
        return found

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
        """
        state = self._run_through(physics, pose, photons, extra)
        glows = state.lag[0] or state.slow_lag[0]
        if glows and self.geometry.views_apart > 1 and isinstance(self.geometry, OrbitGeometry):
            state.earlier = self._earlier(physics, pose, photons, extra)
        return state

    def _run_through(self, physics, pose: Pose, photons: float | None, extra: Mapping) -> State:
        """As `state`, of the views that are there alone."""
        state, behind = self._before_the_object(physics, photons, **extra)
        self._transmit(state, pose)
        for effect in behind:
            effect.apply(state, physics[effect.name])
        return state

    def _earlier(self, physics, pose: Pose, photons: float | None, extra: Mapping) -> np.ndarray:
        """As State.earlier: between views that lie far apart nothing tells what has just been seen."""
        if self._before is None:
            self._before = [self.copy(later(self.geometry, -count)) for count in EARLIER]
            for one in self._before:  # of one pose: of large scans more of them would take gigabytes
                one._paths = Kept(len(divided(one.geometry, one.samples)))
        return np.stack([one._run_through(physics, pose, photons, extra).signal for one in self._before])

    def _before_the_object(self, physics, photons: float | None = None, **extra) -> tuple[State, list]:
        """The state of the beam that meets the object, and the effects that come behind it."""
        state = State(self.geometry, photons or self.photons, sensor=self.sensor, readout=self.readout, **extra)
        if self.illumination == SOLID_ANGLE:
            state.fluence = self.geometry.solid_angles()
        effects = sorted((load(name) for name in physics), key=lambda effect: (STAGES.index(effect.stage), effect.name))
        before = [effect for effect in effects if STAGES.index(effect.stage) < STAGES.index("scatter")]
        for effect in before:
            effect.apply(state, physics[effect.name])
        if self.illumination == SOLID_ANGLE and state.mounting != AS_STATED:
            state.fluence = state.fluence * state.mounting.solid_angles(self.geometry)
        return state, effects[len(before) :]

    def _transmit(self, state: State, pose: Pose) -> None:
        beam, thinned = self._beam(state)
        air = thinned
        total, seen = 0.0, 0.0
        for geometry, weight in sources(state):
            total = total + weight * self.transmission(geometry, pose, state.motion_mm, beam, state.added)
            seen = seen + weight
        if any(np.ndim(weight) for *_, weight in state.sources):  # a collimator hides points of the source
            air = air * seen
        if beam is None:  # one energy: filters thin the beam and no more
            total = total * thinned
        state.air = np.broadcast_to(air * state.fluence, (state.fluence.shape[0], *total.shape[2:])).copy()
        state.signal = state.noise = total[0] * state.fluence
        if len(total) > 1:
            state.noise = total[1] * state.fluence

    def _beam(self, state: State) -> tuple[Spectrum | None, np.ndarray]:
        """The spectrum behind the filters, if there is one, and the beam's signal without an object.

        Returns
        -------
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
        self, geometry: ScanGeometry, pose: Pose, motion_mm=None, beam: Spectrum | None = None, added: Added = ()
    ) -> np.ndarray:
        """Signal, and its quantum variance where these are other shares, over those in air without filters.

        Parameters
        ----------
        pose : Pose
            Of the object.
        motion_mm : ndarray, shape (views, 3), optional
            As State.motion_mm.
        beam : Spectrum, optional
            Its shares may be of every row and column, shape (energies, rows, columns); None: the monochromatic beam.
        added : tuple of tuple of InObject and float, optional
            As State.added.

        Returns
        -------
        ndarray of float64, shape (1 or 2, views, rows, columns)
        """
        rays = (geometry.key, pose, None if motion_mm is None else motion_mm.tobytes())
        key = None if beam is None else beam.key, *((one.key, more) for one, more in added)
        return self._transmissions.get(
            (rays, key), lambda: self._transmission(rays, geometry, pose, motion_mm, beam, added)
        )

    def _transmission(self, rays, geometry, pose, motion_mm, beam, added) -> np.ndarray:
        total = 0.0
        for beside, weights in divided(geometry, self.samples):
            paths = self._paths.get(
                (rays, beside.key), lambda beside=beside: self.scene.path_lengths(beside, pose, motion_mm)
            )
            signal = self._through(paths, beam, weights.shape)
            if added:
                signal = signal * thinned(added, beside, pose, motion_mm)
            total = total + averaged(signal, weights)
        return total

    def _through(self, paths: np.ndarray, beam: Spectrum | None, rays: tuple[int, int]) -> np.ndarray:
        """Of so many rows and columns of rays per pixel."""
        if beam is None:
            return np.exp(-np.tensordot(self.scene.attenuation_per_mm, paths.astype(np.float64), 1))[None]
        table = np.stack([attenuation_per_mm(material, beam.energies_kev) for material in self.scene.materials])
        shares = np.stack([beam.signal, beam.noise])
        if shares.ndim > 2:  # where a filter is alike along rows or columns, there is one for all of them
            for axis, count in zip((-2, -1), rays, strict=True):
                shares = shares.repeat(count if shares.shape[axis] > 1 else 1, axis)
        return transmitted(paths, table, shares, self.scene.threads)


def _kept(size: float, most: int) -> int:
    """How many results of so many bytes a chain keeps."""
    return int(min(most, max(LEAST_KEPT, KEPT_BYTES // size)))
