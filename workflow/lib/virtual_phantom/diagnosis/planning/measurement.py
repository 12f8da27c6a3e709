"""A candidate measurement: the scan to make, and its expected information."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import special

from ...base.geometry import OrbitGeometry
from ...physics.chain import Chain
from ...physics.effect import DARK_DRIFT, DARK_LEVEL, DARK_NOISE, load
from ...physics.scenes.scene import Scene
from ...physics.state import MAX_VARIANCE, PHOTONS
from ..fitting.fit import Fit, Fitter
from ..fitting.linearization import before_images
from ..fitting.nuisance import Nuisance, pose_of
from ..fitting.problem import Problem
from ..fitting.templates import neutral_values
from ..noise.condensed import Blocks
from ..projections.model import ScansModel
from ..projections.object_errors import ObjectErrors
from ..projections.observed import PARTS, ObservedScans, neighbors, white_shape
from ..workload import SAMPLES
from .information import MeasurementInformation, keys_of, measurement_information, slope

# Rays and views used for expectations, with weights for all rays. A choice that limits the run time.
MOST_RAYS, LEAST_VIEWS = 1.5e4, 24
# Steps of derivatives: object displacement in pixels, and largest share of a parameter's range. With a tenth of a pixel
# or more, detector offset and center of rotation of a centered disc, which are equivalent, had a correlation of 0.98.
MOVED, STEP = 1 / 60, 0.02
LEAST_STEP = 0.03  # least step relative to the step of a fit, for scans in which a displacement has no effect; a choice
# Uncertainty of the dark signal from dark frames before and after a scan, relative to the signal in air; a choice.
DARK_SD = 1e-5
ROUNDING = 1 / 12  # variance of a reading in whole units
MOST_KNOWN = 0.01  # uncertainty of the logarithm of a variance from very many readings
# Relative uncertainty of density and size of a phantom (docs/how-to/objects.md).
OBJECT_KNOWN = {"scale": 0.02, "size": 0.002}


@dataclass(frozen=True)
class Conditions:
    """Repeats of a recording, and the part that is fitted.

    Attributes
    ----------
    repeats : int
        Number of fitted repeats; the number of held-out repeats is the same.
    share : float
        Share of the views that is fitted.
    white : bool
        Whether the white field is part of the data.
    """

    repeats: int
    share: float = 1.0
    white: bool = False


@dataclass(frozen=True)
class FurtherScan:
    """A candidate scan.

    Attributes
    ----------
    words : str
        What to do.
    photons : float
        Photons per pixel and view, relative to the existing scan.
    known : mapping of str to float
        Standard deviations of the alignment, where they differ from the existing scan.
    scan : mapping
        Entries of section `scan` of recording.yaml that differ.
    nominal : mapping of str to float
        Factors of entries of section `nominal` of recording.yaml.
    section : mapping or None
        Section diagnosis.recordings.<name> of the configuration; None: as for the existing recording.
    """

    name: str
    words: str
    scene: Scene
    geometry: OrbitGeometry
    photons: float = 1.0
    known: Mapping[str, float] = field(default_factory=dict)
    scan: Mapping = field(default_factory=dict)
    nominal: Mapping[str, float] = field(default_factory=dict)
    section: Mapping | None = None

    def chain(self, like: Chain) -> Chain:
        """Return the chain that simulates the scan; `like` is the chain of the existing recording."""
        readout = like.readout
        if readout != PHOTONS:  # the reading in air is proportional to the photons
            readout = like.air_reading * self.photons
        photons = like.photons * self.photons
        # With a single ray per pixel, the change by a displacement depends on single rays that graze an edge.
        samples = like.samples if hasattr(self.scene, "slopes") else max(like.samples, SAMPLES)
        detector = like.illumination, like.sensor, readout, like.fewest_points
        return Chain(self.scene, self.geometry, photons, samples, *detector)

    def information(
        self,
        model: ScansModel,
        fit: Fit,
        conditions: Conditions,
        own: Collection[str] = (),
        *,
        existing: bool = False,
        beside: MeasurementInformation | None = None,
        noise_fit: Fit | None = None,
        protocol: str = "",
    ) -> MeasurementInformation:
        """Return the expected information about the parameters of one explanation.

        Parameters
        ----------
        model, fit : ScansModel, Fit
            Model of the existing recording, and its fit with the effects of the explanation.
        own : collection of str
            Effects that are specific to each scan and absent in this one.
        existing : bool, optional
            Whether this is the existing recording, with its fitted alignment and all its effects.
        beside : MeasurementInformation, optional
            Information of another explanation. Its steps of derivatives are used if it has the same parameters.
        noise_fit : Fit, optional
            Fit whose noise weights the data, the same for all explanations; None: `fit`.
        protocol : str, optional
            See information.keys_of.
        """
        problem = self.problem(model, fit, conditions, () if existing else own, existing, noise_fit)
        keys = keys_of(problem, self.name, own, protocol)
        known = {} if beside is None else dict(zip(beside.keys, beside.steps, strict=True))
        if set(keys) <= set(known):
            problem.steps = np.array([known[key] for key in keys])
        else:
            problem.steps = self._steps(problem)
        return measurement_information(problem, keys)

    def problem(
        self,
        model: ScansModel,
        fit: Fit,
        conditions: Conditions,
        off: Collection[str] = (),
        existing: bool = False,
        noise_fit: Fit | None = None,
    ) -> Problem:
        """Return the least-squares problem of a fit of the scan, for a subset of views, without the effects `off`."""
        chain = self.chain(model.chain)
        step = thinning(chain.geometry)
        chain = chain.copy(chain.geometry.every(step)) if step > 1 else chain
        aligned = self._aligned(model, noise_fit or fit)
        known = {"tube_kvp": model.tube_kvp, "density": model.density, "declared": model.declared}
        errors = self._object_errors(model, chain, aligned)
        further = ScansModel(chain, aligned, anode=model.anode, object_errors=errors, **known)

        def here(one: Fit) -> Fit:
            physics = {
                name: values | (neutral_values(further.parameters(name)) if name in off else {})
                for name, values in one.physics.items()
            }
            expected = {number.name: number.expected for number in further.nuisances_for(fit.effects)}
            nuisance = {name: one.nuisance[name] if existing else value for name, value in expected.items()}
            return replace(one, effects=fit.effects, physics=physics, nuisance=nuisance, linearization=model.nominal)

        fitter = _expecting(further, here(noise_fit or fit), conditions, step)
        return Problem(fitter, fit.effects, here(fit))

    def _steps(self, problem: Problem) -> np.ndarray:
        """Return steps of derivatives with which all parameters change the data as much as a small displacement.

        Two equivalent parameters then have the same derivatives even if data are nonlinear, such as at edges.
        """
        place = len(problem.unknowns) + [number.name for number in problem.nuisances].index("x_mm")
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
        for number in model.base_nuisances:
            if number.name in (*model.distortions, *model.object_errors.names):
                continue  # more rays and smaller voxels make them small; this scan has its own errors of the object
            expected = number.expected
            if number.name == "log_photons":
                expected = fit.nuisance[number.name] + np.log(self.photons)
            found.append(replace(number, expected=float(expected), sd=self.known.get(number.name, number.sd)))
        named = {number.name for number in found}
        found += [Nuisance(name, "1", 1.0, sd) for name, sd in self.known.items() if name not in named]
        return tuple(found)

    def _object_errors(self, model: ScansModel, chain: Chain, aligned: Sequence[Nuisance]) -> ObjectErrors:
        """Return the errors of the scanned object; scans of the existing recording's object share its errors."""
        stated = model.object_errors.stated
        if stated is None:  # it is known exactly
            return ObjectErrors()
        if self.scene is not model.chain.scene:
            stated = stated.another(self.scene)
        place = pose_of({number.name: number.expected for number in aligned})
        return stated.errors_without_edges(chain.geometry, chain.samples, place)


@dataclass(frozen=True)
class DarkFrames:
    """Readings without a beam, before and after a scan; attributes as in FurtherScan."""

    name: str
    words: str
    scan: Mapping = field(default_factory=dict)
    nominal: Mapping[str, float] = field(default_factory=dict)
    section: Mapping | None = None

    def information(self, model: ScansModel, fit: Fit, *_, **__) -> MeasurementInformation:
        """Return the information about dark signal, its drift and electronic noise.

        The arguments are as in FurtherScan.information; only the first two are used.
        """
        unknowns = model.unknowns(model.with_declared_effects(fit.effects))
        geometry = model.chain.geometry
        air = model.chain.air_reading
        half = (geometry.duration_s if geometry.view_interval_ms is not None else 1.0) / 2
        shown = {
            parameter.dark: values.get(parameter.name, 0.0)
            for name, values in fit.physics.items()
            for parameter in load(name).parameters
        }
        photons = float(shown.get(DARK_NOISE, 0.0))
        level, drift = shown.get(DARK_LEVEL, 0.0), shown.get(DARK_DRIFT, 0.0) * half
        variance = photons**2 + ROUNDING * (model.chain.photons / air) ** 2
        sd = DARK_SD * air
        predicted = np.array([(level - drift) / sd, (level + drift) / sd, np.log(variance) / MOST_KNOWN])
        slopes = {
            DARK_LEVEL: np.array([1 / sd, 1 / sd, 0]),
            DARK_DRIFT: np.array([-half / sd, half / sd, 0]),
            DARK_NOISE: np.array([0, 0, 2 * photons / variance / MOST_KNOWN]),
        }
        measured = [unknown for unknown in unknowns if unknown.parameter.dark in slopes]
        keys = tuple((unknown.effect, unknown.name) for unknown in measured)
        columns = [slopes[unknown.parameter.dark] for unknown in measured]
        changes = np.stack(columns, axis=1) if columns else np.zeros((3, 0))
        now = np.array([unknown.of(fit.physics[unknown.effect][unknown.name]) for unknown in measured])
        margins = np.array([[unknown.low, unknown.high] for unknown in measured]).reshape(-1, 2) - now[:, None]
        prior_precision = np.array([1 / unknown.sd**2 for unknown in measured])
        return MeasurementInformation(keys, changes, predicted, prior_precision, margins, now * 0)


def thinning(geometry: OrbitGeometry) -> int:
    """Return the step between views that are used: an odd number, as a focal spot may alternate between views."""
    rays = geometry.views * geometry.rows * geometry.columns
    step = max(1, min(int(rays / MOST_RAYS), geometry.views // LEAST_VIEWS))
    return step - (step % 2 == 0)


def _expecting(model: ScansModel, fit: Fit, conditions: Conditions, step: int) -> Fitter:
    """Return a fitter with the weights that the expected noise of a scan gives."""
    state = model.chain.state(
        before_images(fit.physics), photons=float(np.exp(fit.nuisance["log_photons"])), anode=model.anode
    )
    first = state.variance()
    usable = first < MAX_VARIANCE
    variance = np.where(usable, state.log_noise()[1], 1.0)
    blocks, n = Blocks.of(usable.shape, PARTS), conditions.repeats
    spread, spread_error, alike, alike_error = None, None, None, None
    if n > 1:
        rays = np.maximum(blocks.sum(usable), 1)
        spread = np.where(blocks.sum(usable) > 0, 1.0, np.nan)
        spread_error = np.sqrt(special.polygamma(1, rays * (n - 1) / 2))
        pairs = [int(neighbors(usable, axis).sum()) for axis in (2, 1, 0)]
        alike = np.array([0.0 if count else np.nan for count in pairs])
        alike_error = np.array([1 / np.sqrt(count * (n - 1)) if count else np.nan for count in pairs])
    white = np.zeros_like(white_shape(state.measured_air[0])) if conditions.white else None
    data = ObservedScans(
        np.zeros(usable.shape), n, usable, blocks, variance, spread, spread_error, alike, alike_error, white=white
    )
    fitter = Fitter(model, data, data, variance, np.zeros(usable.shape))
    of_views = len(fitter.weights) - conditions.white  # the white field does not depend on the number of views
    more = [step * conditions.share if part < of_views else 1.0 for part in range(len(fitter.weights))]
    fitter.weights = [weight * factor for weight, factor in zip(fitter.weights, more, strict=True)]
    return fitter
