"""A further recording that could be made: what would be scanned how, and what it is expected to tell."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import special

from ...base.geometry import OrbitGeometry
from ...physics.chain import Chain
from ...physics.state import MOST_NOISE, PHOTONS
from ..fitting.fit import Fit, Fitter, Problem
from ..fitting.linearization import before_images
from ..fitting.nuisance import Nuisance
from ..noise.condensed import Blocks
from ..projections.model import ScansModel
from ..projections.observed import PARTS, ObservedScans, white_shape
from .information import MeasurementInformation, keys_of, slope, told

# Rays and views that expectations are reckoned of; those left out weigh in the others. A choice that bounds the time.
MOST_RAYS, LEAST_VIEWS = 1.5e4, 24
# Rays per pixel and direction of objects with sharp edges: with few, what a displacement changes depends on those that
# graze an edge. Of voxels, which have no such edges, as the recording's own model has.
SAMPLES = 4
# Of derivatives: a displacement of the object in pixels, and at most that share of a number's range. With a tenth of a
# pixel and more, an offset and an axis beside the ray of a centred disc, which are the same, had a correlation of 0.98.
MOVED, STEP = 1 / 60, 0.02
LEAST_STEP = 0.03  # share of a fit's own step: where nothing is in the beam, a displacement changes nothing; a choice
# Of the signal in air: how well dark frames before and after a scan say what it had; a choice.
DARK_SD = 1e-5
ROUNDING = 1 / 12  # variance of a reading in whole units
MOST_KNOWN = 0.01  # of the logarithm of a variance: how well one of very many readings is known
# Of an object that one has: how well its density and its size are known (docs/how-to/objects.md).
OBJECT_KNOWN = {"scale": 0.02, "size": 0.002}


@dataclass(frozen=True)
class Conditions:
    """How often a recording is repeated, and how much of it is fitted.

    Attributes
    ----------
    repeats : int
        That are fitted, and as many held out.
    share : float
        Of the views that are fitted.
    white : bool
        Whether it comes with a white field.
    """

    repeats: int
    share: float = 1.0
    white: bool = False


@dataclass(frozen=True)
class Scan:
    """A further scan.

    Attributes
    ----------
    words : str
        What is to be done.
    scene : VoxelScene
        Or what has its methods.
    photons : float
        Over those of the scan that there is, per pixel and view.
    known : mapping of str to float
        Standard deviations of the alignment that differ from those of the scan that there is.
    scan, nominal : mapping
        What recording.yaml has otherwise.
    section : mapping or None
        diagnosis.recordings.<name> of the configuration; None: as that of the recording that there is.
    """

    name: str
    words: str
    scene: object
    geometry: OrbitGeometry
    photons: float = 1.0
    known: Mapping[str, float] = field(default_factory=dict)
    scan: Mapping = field(default_factory=dict)
    nominal: Mapping = field(default_factory=dict)
    section: Mapping | None = None

    def chain(self, like: Chain) -> Chain:
        """What simulates it.

        Parameters
        ----------
        like : Chain
            Of the recording that there is.
        """
        readout = like.readout
        if readout != PHOTONS:  # a reading in air goes with the photons, what is read beside them does not
            readout = like.reads_in_air * self.photons
        photons = like.photons * self.photons
        samples = like.samples if hasattr(self.scene, "slopes") else max(like.samples, SAMPLES)
        return Chain(self.scene, self.geometry, photons, samples, like.illumination, like.sensor, readout)

    def tells(
        self,
        model: ScansModel,
        effects: tuple[str, ...],
        fit: Fit,
        conditions: Conditions,
        own: Collection[str],
        again: bool = False,
        beside: MeasurementInformation | None = None,
        weighed: Fit | None = None,
        protocol: str = "",
    ) -> MeasurementInformation:
        """What it is expected to tell of the numbers of one explanation.

        Parameters
        ----------
        model : ScansModel
            Of the recording that there is.
        fit : Fit
            Of that recording, with these effects.
        own : collection of str
            Effects that each scan has for itself: they are expected to do nothing in this one.
        again : bool, optional
            Whether it is the recording that there is, with the alignment that was fitted and the effects that it has.
        beside : MeasurementInformation, optional
            Of another explanation, whose steps of derivatives are taken where it has the same numbers.
        weighed : Fit, optional
            Whose noise weighs the data: to be compared, explanations need the same; None: `fit`.
        protocol : str, optional
            As `information.told` takes it.
        """
        problem = self.problem(model, effects, fit, conditions, () if again else own, again, weighed)
        keys = keys_of(problem, self.name, own, protocol)
        known = {} if beside is None else dict(zip(beside.keys, beside.steps, strict=True))
        if set(keys) <= set(known):
            problem.steps = np.array([known[key] for key in keys])
        else:
            problem.steps = self._steps(problem)
        return told(problem, self.name, own, protocol)

    def problem(
        self,
        model: ScansModel,
        effects: tuple[str, ...],
        fit: Fit,
        conditions: Conditions,
        off: Collection[str] = (),
        again: bool = False,
        weighed: Fit | None = None,
    ) -> Problem:
        """What its fit would solve, of views and rays that are few enough.

        Parameters
        ----------
        model, effects, fit, conditions, again, weighed
            As `tells` takes them.
        off : collection of str, optional
            Effects that do nothing in it.
        """
        chain = self.chain(model.chain)
        step = thinning(chain.geometry)
        if step > 1:
            chain = chain.copy(chain.geometry.every(step))
        aligned = self._aligned(model, weighed or fit)
        further = ScansModel(
            chain, aligned, model.anode, model.tube_kvp, density=model.density, declared=model.declared
        )

        def here(one: Fit) -> Fit:
            physics = {name: dict(values) for name, values in one.physics.items()}
            for name in off:
                for parameter in further.parameters(name) if name in physics else ():
                    if parameter.neutral is not None:
                        physics[name][parameter.name] = parameter.neutral
            expected = {number.name: number.expected for number in further.alignment(effects)}
            nuisance = {name: one.nuisance[name] if again else value for name, value in expected.items()}
            return replace(one, effects=effects, physics=physics, nuisance=nuisance, linearisation=model.nominal)

        fitter = _expecting(further, here(weighed or fit), conditions, step)
        return Problem(fitter, effects, here(fit))

    def _steps(self, problem: Problem) -> np.ndarray:
        """Of derivatives: all numbers change the data by as many standard deviations as a small displacement.

        Of two that change the same, slopes are then the same even where the data are no straight line, as at edges.

        Returns
        -------
        ndarray, shape (numbers,)
        """
        place = len(problem.unknowns) + [one.name for one in problem.aligned].index("x_mm")
        steps = problem.steps.copy()
        steps[place] = MOVED * self.geometry.column_pitch_mm / self.geometry.magnification
        problem.steps = steps
        sizes = np.array([step * np.linalg.norm(slope(problem, index, step)) for index, step in enumerate(steps)])
        wanted = np.divide(sizes[place], sizes, out=np.ones_like(sizes), where=sizes > 0)
        most = STEP * (problem.high - problem.low)
        most = np.maximum(np.where(np.isfinite(most), most, steps), steps)
        return np.clip(steps * wanted, LEAST_STEP * steps, most)

    def _aligned(self, model: ScansModel, fit: Fit) -> tuple[Nuisance, ...]:
        found = []
        for one in model.aligned:
            if one.name in model.distortions:
                continue  # more rays and smaller voxels make them small
            expected = fit.nuisance[one.name] + np.log(self.photons) if one.name == "log_photons" else one.expected
            found.append(replace(one, expected=float(expected), sd=self.known.get(one.name, one.sd)))
        named = {one.name for one in found}
        found += [Nuisance(name, "1", 1.0, sd) for name, sd in self.known.items() if name not in named]
        return tuple(found)


@dataclass(frozen=True)
class DarkFrames:
    """Readings without a beam, before and after a scan.

    Attributes
    ----------
    name, words, section, scan, nominal
        As Scan has them.
    """

    name: str
    words: str
    section: Mapping | None = None
    scan: Mapping = field(default_factory=dict)
    nominal: Mapping = field(default_factory=dict)

    def tells(
        self,
        model: ScansModel,
        effects: tuple[str, ...],
        fit: Fit,
        conditions: Conditions,
        own: Collection[str],
        again: bool = False,
        beside: MeasurementInformation | None = None,
        weighed: Fit | None = None,
        protocol: str = "",
    ) -> MeasurementInformation:
        """As Scan.tells: a dark signal, its drift, and the variance of the electronics."""
        unknowns = model.unknowns(model.whole(effects))
        geometry = model.chain.geometry
        air = model.chain.reads_in_air
        half = (geometry.duration_s if geometry.view_interval_ms is not None else 1.0) / 2
        photons = float(fit.physics.get("electronic_noise", {}).get("photons", 0.0))
        values = fit.physics.get("dark_signal", {})
        level, drift = values.get("level_units", 0.0), values.get("drift_units_per_s", 0.0) * half
        variance = photons**2 + ROUNDING * (model.chain.photons / air) ** 2
        sd = DARK_SD * air
        predicted = np.array([(level - drift) / sd, (level + drift) / sd, np.log(variance) / MOST_KNOWN])
        slopes = {
            ("dark_signal", "level_units"): np.array([1 / sd, 1 / sd, 0]),
            ("dark_signal", "drift_units_per_s"): np.array([-half / sd, half / sd, 0]),
            ("electronic_noise", "photons"): np.array([0, 0, 2 * photons / variance / MOST_KNOWN]),
        }
        told_of = [one for one in unknowns if (one.effect, one.name) in slopes]
        keys = tuple((one.effect, one.name) for one in told_of)
        changes = np.stack([slopes[key] for key in keys], axis=1) if keys else np.zeros((3, 0))
        now = np.array([one.of(fit.physics[one.effect][one.name]) for one in told_of])
        room = np.array([[one.low, one.high] for one in told_of]).reshape(-1, 2) - now[:, None]
        return MeasurementInformation(
            keys, changes, predicted, np.array([1 / one.sd**2 for one in told_of]), room, now * 0
        )


def thinning(geometry: OrbitGeometry) -> int:
    """One view of so many is enough for an expectation: an odd number, as a focal spot may jump every second view."""
    rays = geometry.views * geometry.rows * geometry.columns
    step = max(1, min(int(rays / MOST_RAYS), geometry.views // LEAST_VIEWS))
    return step - (step % 2 == 0)


def _expecting(model: ScansModel, fit: Fit, conditions: Conditions, step: int) -> Fitter:
    """What fits of a scan would weigh its data by: the noise that is expected of it."""
    state = model.chain.state(
        before_images(fit.physics), photons=float(np.exp(fit.nuisance["log_photons"])), anode=model.anode
    )
    first = state.variance()
    usable = first < MOST_NOISE
    variance = np.where(usable, state.log_noise()[1], 1.0)
    blocks, n = Blocks.of(usable.shape, PARTS), conditions.repeats
    spread, spread_error, alike, alike_error = None, None, None, None
    if n > 1:
        rays = np.maximum(blocks.sum(usable), 1)
        spread = np.where(blocks.sum(usable) > 0, 1.0, np.nan)
        spread_error = np.sqrt(special.polygamma(1, rays * (n - 1) / 2))
        pairs = [_pairs(usable, axis) for axis in (2, 1, 0)]
        alike = np.array([0.0 if one else np.nan for one in pairs])
        alike_error = np.array([1 / np.sqrt(one * (n - 1)) if one else np.nan for one in pairs])
    white = np.zeros_like(white_shape(state.measured_air[0])) if conditions.white else None
    data = ObservedScans(
        np.zeros(usable.shape), n, usable, blocks, variance, spread, spread_error, alike, alike_error, white=white
    )
    fitter = Fitter(model, data, data, variance, np.zeros(usable.shape))
    of_views = len(fitter.weights) - conditions.white  # the white field is one, however many views there are
    more = [step * conditions.share if part < of_views else 1.0 for part in range(len(fitter.weights))]
    fitter.weights = [weight * one for weight, one in zip(fitter.weights, more, strict=True)]
    return fitter


def _pairs(usable: np.ndarray, axis: int) -> int:
    length = usable.shape[axis]
    low, high = (np.take(usable, range(a, length - 1 + a), axis) for a in (0, 1))
    return int((low & high).sum())
