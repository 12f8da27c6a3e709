"""Acquisition chain: the mean signal of a scan, with any set of effects.

The baseline [1]_ has one energy, a point source, an ideal detector, Poisson noise and the logarithm. Effects act in the
order of `effect.STAGES`, and within a stage in the order of their names. Without effects the chain is the baseline.

References
----------
.. [1] Flouris et al., Sci. Rep. 12, 2022.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from ..base.geometry import OrbitGeometry, ScanGeometry
from ..base.lru_cache import LRUCache
from ..base.mounting import AS_STATED
from .beam.materials import attenuation_per_mm
from .beam.sensors import Sensor
from .beam.spectra import SENSOR, TUNGSTEN, Anode, Spectrum, filter_transmission
from .beam.transmission import polychromatic_signal
from .effect import (
    OF_AIR,
    OF_AIR_PER_SCAN,
    PER_AIR_PHOTON,
    PER_PIXEL,
    PER_SCAN,
    PER_SCAN_SQUARED,
    PER_VIEW,
    READOUT_UNITS,
    STAGES,
    Parameter,
    load,
    needs_times,
)
from .scenes.edges import EdgeScan
from .scenes.inclusion import inclusion_transmission
from .scenes.posed import LinearizedScene, PosedScan, PosedScene
from .scenes.sampling import average_rays, later_geometry, sources, supersampled
from .scenes.scene import IN_PLACE, Pose, VoxelScene, scan_key
from .scenes.shapes import DiscScene, ShapesScene
from .state import AIR, EARLIER_VIEWS, PHOTONS, Inclusions, State

# Cached results. A fit varies one parameter at a time, and most parameters leave the results of earlier stages as they
# are. Each of the four or more points of a focal spot has its own path lengths.
MAX_PATHS, MAX_TRANSMISSIONS = 20, 24
# For each of the two caches. Small scans cache more results: an extended source at several times needs 50 and more.
CACHE_BYTES, SMALL_BYTES, MIN_CACHED = 2e8, 2e7, 3
EDGE_BYTES = 100  # of cached rays at edges, for each ray of a pixel: about twice as many, with vectors and weights
EVEN, SOLID_ANGLE = "even", "solid_angle"


class Chain:
    """Mean signal of a scene in a geometry, for any settings of effects.

    Parameters
    ----------
    scene : VoxelScene
        Or another class of `scenes` with the same methods.
    photons : float, optional
        As State.photons.
    samples : int, optional
        Rays per pixel and direction, whose signals are averaged; 1: one ray to the center, as in the baseline.
    illumination : {"even", "solid_angle"}, optional
        EVEN: all pixels receive the same number of photons in air; SOLID_ANGLE: a number proportional to the solid
        angle of the pixel.
    readout : float or {"photons", "air"}, optional
        As State.readout.
    fewest_points : int, optional
        As State.fewest_points.
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
        fewest_points: int | None = None,
    ):
        self.scene, self.geometry, self.photons, self.samples = scene, geometry, photons, samples
        self.illumination, self.sensor, self.readout = illumination, sensor, readout
        self.fewest_points = fewest_points
        parts, pixels = len(supersampled(geometry, samples)), math.prod(geometry.shape)
        rays = pixels * samples ** (2 if geometry.rows > 1 else 1)
        edges = samples > 1 and isinstance(scene, ShapesScene)
        self._paths = LRUCache(_cache_length((8 + EDGE_BYTES * edges) * rays, MAX_PATHS) * (parts + edges))
        self._transmissions = LRUCache(_cache_length(8 * pixels, MAX_TRANSMISSIONS))
        self._earlier_chains: list[Chain] | None = None

    def copy(self, geometry: ScanGeometry | None = None, samples: int | None = None) -> Chain:
        """Return a chain with empty caches, for another geometry or number of rays if given."""
        return self._copy(self.scene, geometry or self.geometry, samples or self.samples)

    def _copy(self, scene: VoxelScene, geometry: ScanGeometry, samples: int) -> Chain:
        detector = self.illumination, self.sensor, self.readout
        return Chain(scene, geometry, self.photons, samples, *detector, self.fewest_points)

    def linearized_at(
        self, physics: Mapping[str, Mapping[str, float]], pose: Pose = IN_PLACE, reach: float = 1.0, **extra
    ) -> Chain:
        """Return a chain whose path lengths are linearized at the given settings, as PosedScene.linearized_at.

        `reach` is a factor of the linear range. Other arguments are as in `state`. A chain whose scene is not a
        PosedScene is returned unchanged.
        """
        if not isinstance(self.scene, PosedScene):
            return self
        return self._copy(
            self.scene.linearized_at(self._scans(physics, pose, extra), reach), self.geometry, self.samples
        )

    def in_linear_range(self, physics: Mapping[str, Mapping[str, float]], pose: Pose = IN_PLACE, **extra) -> bool:
        """Whether all rays of the given settings are in the linear range; true if the scene is not linearized."""
        scene = self.scene
        return not isinstance(scene, LinearizedScene) or all(
            map(scene.in_linear_range, self._scans(physics, pose, extra))
        )

    def _scans(self, physics: Mapping[str, Mapping[str, float]], pose: Pose, extra: Mapping) -> list[PosedScan]:
        """Return the scans for which these settings need path lengths."""
        state, _ = self._until_object(physics, **extra)
        return [
            (rays, pose, state.motion_mm)
            for source, _ in sources(state)
            for rays, _ in supersampled(source, self.samples)
        ]

    def geometry_with(self, physics: Mapping[str, Mapping[str, float]], anode: Anode = TUNGSTEN) -> ScanGeometry:
        """Return the geometry of the rays from the middle of the focal spot, with the given settings of effects."""
        state, _ = self._until_object(physics, anode=anode)
        return state.mounting.of(state.geometry)

    @property
    def air_reading(self) -> float:
        """Reading of the detector in air, readout units."""
        return {PHOTONS: self.photons, AIR: 1.0}.get(self.readout, self.readout)

    def parameters(self, name: str) -> tuple[Parameter, ...]:
        """Return the fitted parameters of an effect with range, start, typical strength and unit for this scan.

        Raises
        ------
        InputError
            If the effect needs the times of the scan and they are unknown.
        """
        air = self.air_reading
        unit = {PHOTONS: "photons", AIR: "of air"}.get(self.readout, READOUT_UNITS)
        geometry = self.geometry
        pitch = max(geometry.column_pitch_mm, geometry.row_pitch_mm if geometry.rows > 1 else 0.0)
        scan = {OF_AIR: air, PER_AIR_PHOTON: 1 / self.photons, PER_PIXEL: pitch}
        if geometry.view_interval_ms is not None:
            duration = geometry.duration_s
            scan |= {PER_VIEW: geometry.view_interval_ms, PER_SCAN: 1 / duration, PER_SCAN_SQUARED: 1 / duration**2}
            scan[OF_AIR_PER_SCAN] = air / duration
        return tuple(
            replace(parameter.within(scan), unit=parameter.unit.replace(READOUT_UNITS, unit))
            for parameter in load(name).parameters
            if parameter.name not in self.fixed_parameters(name)
        )

    def fixed_parameters(self, name: str) -> dict[str, float]:
        """Return the parameters of an effect that are not fitted, and their values.

        Parameters of the scanner design have their typical value. Parameters that need unknown times of the scan have
        their neutral value.

        Raises
        ------
        InputError
            If the effect needs the times of the scan and they are unknown.
        """
        parameters = load(name).parameters
        fixed = {parameter.name: parameter.typical for parameter in parameters if parameter.stated}
        timed = [parameter for parameter in parameters if parameter.timed]
        if self.geometry.view_interval_ms is None and timed:
            if needs_times(name):
                self.geometry.known_interval_ms  # noqa: B018  raises
            fixed |= {parameter.name: parameter.neutral for parameter in timed}
        return fixed

    def state(
        self, physics: Mapping[str, Mapping[str, float]], pose: Pose = IN_PLACE, photons: float | None = None, **extra
    ) -> State:
        """Run the chain.

        Parameters
        ----------
        physics : mapping of str to mapping of str to float
            {effect: {parameter: value}}; empty: the baseline.
        photons : float, optional
            As State.photons; None: the number of the chain.
        **extra
            Initial values of fields of the State.
        """
        state = self._run(physics, pose, photons, extra)
        glows = state.lag[0] or state.slow_lag[0]
        if glows and self.geometry.views_apart > 1 and isinstance(self.geometry, OrbitGeometry):
            state.earlier = self._earlier_signal(physics, pose, photons, extra)
        return state

    def _run(self, physics, pose: Pose, photons: float | None, extra: Mapping) -> State:
        """Run the chain, without State.earlier."""
        state, later_effects = self._until_object(physics, photons, **extra)
        self._transmit(state, pose)
        for effect in later_effects:
            effect.apply(state, physics[effect.name])
        return state

    def _earlier_signal(self, physics, pose: Pose, photons: float | None, extra: Mapping) -> np.ndarray:
        """Return State.earlier, for scans whose views are too far apart to interpolate the signal between them."""
        if self._earlier_chains is None:
            self._earlier_chains = [self.copy(later_geometry(self.geometry, -count)) for count in EARLIER_VIEWS]
            for chain in self._earlier_chains:  # cache one pose; more poses of a large scan would take gigabytes
                chain._paths = LRUCache(len(supersampled(chain.geometry, chain.samples)))
        return np.stack([chain._run(physics, pose, photons, extra).signal for chain in self._earlier_chains])

    def _until_object(self, physics, photons: float | None = None, **extra) -> tuple[State, list]:
        """Return the state of the beam before the object, and the effects that act later."""
        stated = {"sensor": self.sensor, "readout": self.readout, "fewest_points": self.fewest_points}
        state = State(self.geometry, photons or self.photons, **stated, **extra)
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
        """Set signal, noise and air: sums over the points of the focal spot."""
        beam, filtered_air = self._beam(state)
        total, visible = 0.0, 0.0
        for geometry, weight in sources(state):
            total = total + weight * self.transmission(geometry, pose, state.motion_mm, beam, state.added)
            visible = visible + weight
        air = filtered_air
        if any(np.ndim(weight) for *_, weight in state.sources):  # a collimator hides points of the source
            air = air * visible
        if beam is None:  # at a single energy, filters change signal and air by the same factor
            total = total * filtered_air
        state.air = np.broadcast_to(air * state.fluence, (state.fluence.shape[0], *total.shape[2:])).copy()
        state.signal = state.noise = total[0] * state.fluence
        if len(total) > 1:
            state.noise = total[1] * state.fluence

    def _beam(self, state: State) -> tuple[Spectrum | None, np.ndarray]:
        """Return the filtered spectrum, if there is one, and its signal in air, broadcastable to (rows, columns)."""
        if not state.filters:
            return state.spectrum, np.ones((1, 1))
        if state.spectrum is None:
            return None, filter_transmission(state.filters, [self.scene.energy_kev])[0]
        beam = state.spectrum.filtered(state.filters)
        return beam, beam.signal.sum(axis=0)

    def transmission(
        self, geometry: ScanGeometry, pose: Pose, motion_mm=None, beam: Spectrum | None = None, added: Inclusions = ()
    ) -> np.ndarray:
        """Return the signal, and its quantum variance if it differs, relative to air without filters.

        Parameters
        ----------
        geometry, pose, motion_mm
            As in GridScene.path_lengths.
        beam : Spectrum, optional
            None: the monochromatic beam.
        added : tuple of tuple of Inclusion and float, optional
            As State.added.

        Returns
        -------
        ndarray of float64, shape (1 or 2, views, rows, columns)
        """
        if isinstance(self.scene, DiscScene) and not added:  # poses that look the same share a result
            pose = self.scene.seen_pose(pose)
        scan = scan_key(geometry, pose, motion_mm)
        key = scan, None if beam is None else beam.key, *((shape.key, excess) for shape, excess in added)
        return self._transmissions.get(key, lambda: self._transmission(geometry, pose, motion_mm, beam, added))

    def _transmission(self, geometry, pose, motion_mm, beam, added) -> np.ndarray:
        total = 0.0
        for rays, weights in supersampled(geometry, self.samples):
            paths = self._paths.get(
                scan_key(rays, pose, motion_mm), lambda rays=rays: self.scene.path_lengths(rays, pose, motion_mm)
            )
            signal = self._ray_signal(paths, beam, weights.shape)
            if added:
                signal = signal * inclusion_transmission(added, rays, pose, motion_mm)
            total = total + average_rays(signal, weights)
        if isinstance(self.scene, ShapesScene):
            for edges, paths in self._edges(geometry, pose, motion_mm, added):
                signal = self._ray_signal(paths, beam, edges)
                if added:
                    signal = signal * inclusion_transmission(added, edges, pose, None)
                edges.replace_in(total, signal)
        return total

    def _edges(self, geometry, pose: Pose, motion_mm, added: Inclusions) -> Iterable[tuple[EdgeScan, np.ndarray]]:
        """Return the rays of pixels that see an edge of the scene or of an added shape, with their path lengths."""

        def trace() -> Iterator[tuple[EdgeScan, np.ndarray]]:
            whole = ShapesScene([*self.scene.shapes, *(shape.shape for shape, _ in added)]) if added else self.scene
            for edges in whole.edge_scans(geometry, self.samples, pose, motion_mm):
                yield edges, self.scene.path_lengths(edges, pose)

        if len(supersampled(geometry, self.samples)) > 1:  # too large to be cached
            return trace()
        key = "edges", scan_key(geometry, pose, motion_mm), *(shape.key for shape, _ in added)
        return self._paths.get(key, lambda: list(trace()))

    def _ray_signal(self, paths: np.ndarray, beam: Spectrum | None, rays: tuple[int, int] | EdgeScan) -> np.ndarray:
        """Return the signal of every ray by the Beer-Lambert law.

        `rays` are the (rows, columns) of rays per pixel, or the rays of pixels that see an edge.
        """
        if beam is None and paths.dtype == np.float32:  # their rounding is as large as that of the signal
            table, shares = self.scene.attenuation_per_mm[:, None], np.ones((1, 1))
            return polychromatic_signal(paths, table, shares, self.scene.threads)
        if beam is None:
            logarithm = np.tensordot(-self.scene.attenuation_per_mm, paths.astype(np.float64), 1)
            return np.exp(logarithm, out=logarithm)[None]
        table = np.stack([attenuation_per_mm(material, beam.energies_kev) for material in self.scene.materials])
        shares = np.stack([beam.signal, beam.noise])
        if shares.ndim > 2 and isinstance(rays, EdgeScan):
            rows, columns = (
                pixel if count > 1 else np.zeros_like(pixel)
                for pixel, count in zip(rays.pixels[1:], shares.shape[-2:], strict=True)
            )
            shares = np.broadcast_to(shares[..., rows, columns, None], (*shares.shape[:2], len(rays.weights), 1))
            return polychromatic_signal(np.moveaxis(paths, 1, 2), table, shares, self.scene.threads).swapaxes(1, 2)
        if shares.ndim > 2:  # shares of pixels become shares of rays, except along axes on which a filter is constant
            for axis, count in zip((-2, -1), rays, strict=True):
                shares = shares.repeat(count if shares.shape[axis] > 1 else 1, axis)
        return polychromatic_signal(paths, table, shares, self.scene.threads)


def _cache_length(size: float, most: int) -> int:
    """Return how many results of this many bytes a cache holds."""
    return int(min(max(most, SMALL_BYTES // size), max(MIN_CACHED, CACHE_BYTES // size)))
