"""Preparation of projections for fits: split into fitted and held-out data, noise, and numerical errors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np
from scipy.sparse import sparray

from ...physics.beam.spectra import TUNGSTEN, Anode
from ...physics.chain import Chain
from ...physics.scenes.sampling import sources
from ..fitting.fit import Fit, Fitter
from ..fitting.linearization import LinearizationPoint, before_images
from ..fitting.nuisance import NOMINAL_PHOTONS_SD, PIECE, Nuisance, nuisances, pose_of
from ..fitting.priors import Statement, stated_physics
from ..noise.condensed import FEWEST, Blocks
from ..noise.whitening import WHITE, Correlations, Whitening, estimated, of_state
from ..residuals.dataset import LocalMismatch, Prepared, ResidualMaps
from ..residuals.residual_tests import DomainTest, HalfResiduals
from ..uncertainty.prediction_error import changes_by_parameter_errors
from .change_kinds import kinds
from .discretization import Numerical
from .first_noise import SHARE_BY_DISTANCE, every, filled, first_noise, has_rows
from .local_mismatch import FitResidual, Piece, best_piece, object_radius_mm, refined_piece
from .lost_rays import lost_rays_remark, truncation_of
from .model import ScansModel
from .object_errors import SHARP_EDGES, STEP_MM, SURFACE, ObjectErrors, StatedObject
from .observed import ObservedScans, Scans, observe, with_noise_of_views
from .residual_maps import domain_tests, excess_at_edges

HALVES = 4  # repeats from which every second one is held out; with fewer, every second view
SIZE_SD = 5e-4  # of the object, 0.1 mm in 200 mm; with a fixed size, errors of 1 in 20,000 look like source distances
BY_VIEW = "every second view"
MOST_MOVES = 6  # refinements of a local object mismatch, each with a fit of the alignment
SETTLED = 1.0  # gain in chi-square that ends the refinement
# Standard deviations of a surface beyond which physics is missing rather than the object wrong. The stated surfaces are
# then kept.
MOST_PULL = 3.0
DISPLAY = ResidualMaps(
    unit="line_integral",
    summed=1,
    down="view",
    across="detector column",
    profiles=(
        ("columns", "detector column", 0),
        ("views", "view", 0),
        ("path length", "rays by line integral (tenths)", 1),
    ),
    one_repeat="was estimated from second differences of neighboring views, and of rows if there are four or more. "
    "With rows, its variance from view to view was tested; otherwise it was not tested",
    ranked=True,
)


@dataclass(frozen=True)
class PreparedScans(Prepared):
    """Projections prepared for fits.

    The noise of a single repeat is estimated from differences of neighboring views.

    Attributes
    ----------
    second_difference : float
        Variance of second differences relative to the variance of a view, for the noise estimate of a single repeat.
    about : callable or None
        Returns the recording with errors of the object linearized at a fit. It is None for an exact object, for one
        ray per pixel, and for a recording that was changed.
    """

    display: ClassVar[ResidualMaps] = DISPLAY

    second_difference: float = WHITE.of_second_differences()
    about: Callable[[Fit], PreparedScans] | None = None

    @property
    def usable(self) -> np.ndarray:
        """Fitted or held-out rays with a signal, shape (views, rows, columns)."""
        if self.held_out_text == BY_VIEW:  # each half leaves out the other's views
            return self.data.usable | self.held_out.usable
        return super().usable

    def domains(
        self, half: HalfResiduals, fit: Fit, fitted: HalfResiduals | None = None, more: Sequence[DomainTest] = ()
    ) -> list[DomainTest]:
        """See Prepared.domains."""
        uncertain = None if fitted is None else changes_by_parameter_errors(self.fitter, fit)
        return domain_tests(half, fit.pattern, fitted, more, uncertain, self.step)

    def share_at_edges(self, fit: Fit) -> float:
        """See Prepared.share_at_edges."""
        return excess_at_edges(self.half(fit, held_out=True))

    def kinds(self, fit: Fit) -> Iterable[tuple[str, np.ndarray | sparray]]:
        """See Prepared.kinds."""
        model = self.fitter.model
        lines = self.fitter.predicted(fit).mean
        return kinds(lines, model.source_angles_rad, self.usable, self.held_out_text != BY_VIEW)

    def local_mismatch(self, fit: Fit) -> LocalMismatch | None:
        """See Prepared.local_mismatch."""
        left = self._fit_residual(fit)
        piece = best_piece(left)
        return None if piece is None else self._mismatch_of(piece, left)

    def with_mismatch(self, mismatch: LocalMismatch, fit: Fit) -> PreparedScans:
        """See Prepared.with_mismatch."""
        name, moved = f"{PIECE}{len(self.fitter.model.pieces) + 1}", mismatch.piece
        best, least = self, np.inf
        for _ in range(MOST_MOVES):
            model = self.fitter.model.with_piece(Nuisance(name, "1/mm", 0.0, np.inf), moved)
            corrected = replace(self, fitter=self.fitter.of(model), whole=self.whole.of(model), about=None)
            if name not in fit.nuisance:  # the alignment was biased by the mismatch
                expected = {number.name: number.expected for number in model.nuisances_for(fit.effects)}
                fit = replace(fit, nuisance=expected)
            fit = corrected.fitter.fit(fit.effects, fit)
            gained, least = least - fit.chi_square, min(least, fit.chi_square)
            if gained > 0:
                best = corrected
            if gained < SETTLED:
                break
            left = corrected._fit_residual(fit)
            fitted = fit.nuisance[name] * left.lengths_mm(moved)
            moved = refined_piece(moved, replace(left, residual=left.residual + fitted)) or moved
        return best

    def mismatches(self, fit: Fit) -> list[LocalMismatch]:
        """See Prepared.mismatches."""
        left, pieces = self._fit_residual(fit), self.fitter.model.pieces.items()
        fitted = [replace(inclusion.key, more_per_mm=fit.nuisance[name]) for name, inclusion in pieces]
        return [self._mismatch_of(piece, left) for piece in fitted]

    def _fit_residual(self, fit: Fit) -> FitResidual:
        """Return the residuals of the fitted data with their geometry."""
        chain, shape = self.fitter.model.chain, self.data.mean.shape
        half, predicted = self.half(fit, held_out=False), self.fitter.predicted(fit)
        residual, weight = (values[0].reshape(shape) for values in (half.residuals, half.weights))
        places = [geometry for geometry, _ in sources(predicted.state)]
        middle_of_spot, reach_mm = places[len(places) // 2], object_radius_mm(predicted.design[0], chain.geometry)
        moved = pose_of(fit.nuisance), chain.samples, middle_of_spot, predicted.state.motion_mm
        return FitResidual(self.data.as_recorded(residual), weight, chain.geometry, reach_mm, *moved)

    def _mismatch_of(self, piece: Piece, left: FitResidual) -> LocalMismatch:
        energy_kev = self.fitter.model.chain.scene.energy_kev
        lengths = left.lengths_mm(piece).reshape(-1, 1)
        return LocalMismatch(piece.words(energy_kev), piece.content(energy_kev), lengths, piece)

    def recorded(self, held_out: bool = False) -> np.ndarray:
        """See Prepared.recorded."""
        data = self.held_out if held_out else self.data
        return data.mean[data.usable]

    def difference(self, fit: Fit, held_out: bool) -> np.ndarray:
        """See Prepared.difference."""
        data = self.held_out if held_out else self.data
        whitened = self.fitter.residuals(fit, held_out)[0].reshape(data.mean.shape)
        return data.as_recorded(whitened)[data.usable]

    def with_noise_of(self, fit: Fit) -> PreparedScans:
        """Return the recording with the noise correlations of a fit; itself if nothing changes.

        Only a single repeat is changed: it does not determine the correlations, which first come from declared physics.
        """
        if not self.single:
            return self
        model, data = self.fitter.model, self.data
        state = self.fitter.predicted(fit).state
        correlations, before = of_state(state), WHITE if data.whitening is None else data.whitening.noise
        if not correlations.stands_out(before, int(self.usable.sum())):
            return self
        stated = before_images(stated_physics(model.declared))
        place = pose_of(model.nominal.rays.nuisance)
        clean = model.chain.state(stated, place, photons=1.0, anode=model.anode).line_integrals()
        parts = [
            _whitened(replace(part, whitening=None), correlations, clean, map(part.as_recorded, part.numerical))
            for part in (data, self.held_out, self.whole.data)
        ]
        now = of_state(state, apart=1).of_second_differences(has_rows(self.data.usable))
        variance = self.variance * self.second_difference / now
        fitter, whole = _fitters(model, *parts, partial(_whitened_variance, variance, clean=clean))
        return replace(self, fitter=fitter, whole=whole, variance=variance, second_difference=now, about=None)

    def linearized_at(self, fit: Fit, most_error: float) -> PreparedScans:
        """See Prepared.linearized_at."""
        if self.about is None or self._surfaces_stay(fit) or largest_surface_pull(fit) > MOST_PULL:
            return self
        again = self.about(fit)
        expected = {number.name: number.expected for number in again.fitter.model.base_nuisances}
        there = again.whole.predicted(replace(fit, nuisance=expected | fit.nuisance))
        change = there.mean - self.whole.predicted(fit).mean
        error = float((again.whole.weights[0] * self.whole.data.whitened(change).ravel() ** 2).sum())
        return again if error > most_error else self

    def _surfaces_stay(self, fit: Fit) -> bool:
        """Return whether a fit leaves surfaces and object where errors are linearized, or whether there are none."""
        if SHARP_EDGES in fit.nuisance:  # it decides whether labels have surfaces
            return False
        surfaces, first = [name for name in fit.nuisance if name.startswith(SURFACE)], self.fitter.model.first
        before = self.fitter.model.nominal.errors.nuisance if first is None else first.nuisance
        moved = (abs(fit.nuisance[name] - before.get(name, 0.0)) for name in (*surfaces, "x_mm", "y_mm"))
        return not surfaces or max(moved) < STEP_MM

    def caveats(self, fit: Fit) -> list[str]:
        """See Prepared.caveats."""
        chain = self.fitter.model.chain
        return lost_rays_remark(self.usable) + truncation_of(chain.scene, chain.geometry).remark


def largest_surface_pull(fit: Fit) -> float:
    """Return the largest displacement of a surface of the object in a fit, in standard deviations."""
    return max((abs(pull) for name, pull in fit.pulls.items() if name.startswith(SURFACE)), default=0.0)


def split(taken: Scans, further: Scans | None) -> tuple[Scans, Scans, str]:
    """Return fitted data, held-out data, and a description of the held-out part."""
    if further is not None:
        return taken, further, "repeats kept for it"
    if len(taken) >= HALVES:
        parts = [replace(taken, repeats=taken.repeats[first::2]) for first in (0, 1)]
        return *parts, "every second repeat"
    views = np.arange(taken.usable.shape[0])[:, None, None]
    parts = [replace(taken, usable=taken.usable & (views % 2 == odd)) for odd in (0, 1)]
    return *parts, BY_VIEW


def prepare(
    taken: Scans,
    further: Scans | None,
    chain: Chain,
    *,
    anode: Anode = TUNGSTEN,
    tube_kvp: float | None = None,
    nominal_photons: float | None = None,
    known: dict[str, float] | None = None,
    floor_chain: Chain | None = None,
    coarse_chain: Chain | None = None,
    step: int = 1,
    declared: Mapping[str, Mapping[str, Statement]] | None = None,
    location: Mapping[str, float] | None = None,
    uncertain: StatedObject | None = None,
    first: Fit | None = None,
) -> PreparedScans:
    """Estimate noise, numerical errors and alignment of a recording.

    Parameters
    ----------
    further : Scans or None
        See `split`.
    nominal_photons : float, optional
        Stated photons per pixel in air.
    known : dict of str to float, optional
        Standard deviations of the alignment that replace the defaults.
    floor_chain, coarse_chain : Chain, optional
        Chains with more rays and coarser voxels (Numerical). Their differences are fitted as numerical distortions.
    step : int, optional
        Every `step`-th view is fitted or held out. Noise is estimated from all views, in large scans from these views
        and their neighbors.
    anode, tube_kvp, declared
        See Model.
    location : mapping of str to float, optional
        See fitting.nuisance.nuisances.
    uncertain : StatedObject, optional
        Uncertainty of the object; None: the object is exact.
    first : Fit, optional
        Fit without effects, at which errors of the object and of edges are linearized, and from which other fits begin;
        None: these are the expected values.

    Raises
    ------
    InputError
        If the repeats do not vary.
    """
    stated, place = before_images(stated_physics(declared or {})), pose_of(location or {})
    taken, noise = first_noise(taken, chain, stated, place, anode, step)
    if step > 1:
        further = None if further is None else further.every(step)
        chain, floor_chain, coarse_chain = (
            None if one is None else every(one, step) for one in (chain, floor_chain, coarse_chain)
        )
    numerical = Numerical(chain, floor_chain, coarse_chain, anode)
    about = {} if first is None else first.nuisance
    linearized = LinearizationPoint.of({}, about or location or {})
    errors, found = ObjectErrors(), pose_of(linearized.nuisance)
    if uncertain is not None:
        physics = stated if first is None else before_images(first.physics)
        errors = uncertain.errors(chain.geometry_with(physics, anode), chain.samples, found, about)
    left = (*numerical.left(linearized), *errors.remaining(found))

    fitted, held, words = split(taken, further)
    if noise.single:
        correlations = of_state(chain.state(stated, place, photons=noise.photons, anode=anode))
    else:
        correlations = _correlations(taken, noise.clean, noise.variance)
    parts = [
        _whitened(observe(part, noise.reference, noise.blocks, correlations), correlations, noise.clean, left)
        for part in (fitted, held, taken)
    ]
    if noise.single:
        variance_of = partial(_whitened_variance, noise.variance, clean=noise.clean)
        if noise.of_views is not None:
            squares, of_rows = noise.of_views
            apart = (2 * step, 2 * step, step) if words == BY_VIEW else 3 * (step,)
            parts = [
                with_noise_of_views(part, squares, of_rows * SHARE_BY_DISTANCE.get(distance, 1.0))
                for part, distance in zip(parts, apart, strict=True)
            ]
    else:
        apart = [taken] if words == BY_VIEW else [fitted, held]
        variance, freedom = _of_one_repeat(apart, noise.reference, noise.clean, correlations, noise.blocks)
        parts = [replace(part, block_weight_variance=2 / np.maximum(freedom, 1)) for part in parts]

        def variance_of(part: ObservedScans) -> np.ndarray:
            return variance if part.whitening is None else variance * part.whitening.correlations.amplification

    aligned = nuisances(
        # The noise of a single repeat is not fitted, so the photons need a prior.
        np.log(nominal_photons or noise.photons),
        NOMINAL_PHOTONS_SD if nominal_photons or noise.single else np.inf,
        {"size": SIZE_SD} | ({} if uncertain is None else uncertain.alignment) | (known or {}),
        numerical.names,
        location,
    )
    label = {"anode": anode, "tube_kvp": tube_kvp, "declared": declared}
    model = ScansModel(chain, aligned, numerical=numerical, object_errors=errors, first=first, **label)
    fitter, whole = _fitters(model, *parts, variance_of)
    more = {"step": step, "second_difference": noise.second_difference}
    return PreparedScans(fitter, whole, noise.variance, words, noise.single, noise.photons, **more)


def _fitters(
    model: ScansModel,
    fitted: ObservedScans,
    held_out: ObservedScans,
    whole: ObservedScans,
    variance_of: Callable[[ObservedScans], np.ndarray],
) -> tuple[Fitter, Fitter]:
    """Return the fitter of a part of the data, and the fitter of all data.

    Parameters
    ----------
    variance_of : callable
        Returns the variance of every whitened ray of one repeat for one of these data.
    """
    return tuple(
        Fitter(model, data, judged, variance_of(data), _floor(data))
        for data, judged in ((fitted, held_out), (whole, whole))
    )


def _floor(data: ObservedScans) -> np.ndarray:
    """Return the SD of the whitened numerical error of predictions, shape (views, rows, columns)."""
    return np.sqrt(sum((error**2 for error in data.numerical), np.zeros(data.mean.shape)))


def _correlations(taken: Scans, clean: np.ndarray, variance: np.ndarray) -> Correlations:
    """Estimate the noise correlation from differences of repeats."""
    mean, sd = taken.repeats.mean(axis=0, dtype=np.float64), np.sqrt(variance)
    return estimated([(repeat - mean) / sd for repeat in taken.repeats], clean, taken.usable, len(taken) - 1)


def _whitened(data: ObservedScans, correlations: Correlations, clean: np.ndarray, numerical) -> ObservedScans:
    """Return the data with their whitening and with whitened numerical distortions."""
    if correlations.white:
        return replace(data, numerical=tuple(numerical))
    data = replace(data, whitening=Whitening(correlations, clean, data.usable))
    return replace(data, numerical=tuple(map(data.whitened, numerical)))


def _whitened_variance(variance: np.ndarray, data: ObservedScans, clean: np.ndarray) -> np.ndarray:
    """Return the variance of every whitened ray of a single repeat, shape (views, rows, columns).

    Parameters
    ----------
    variance, clean : ndarray, shape (views, rows, columns)
        Variance of one repeat, and line integrals, of the first model.
    """
    white = data.whitening
    if white is None:
        return variance
    return variance * np.exp(-clean) * white.variance(clean) * white.correlations.amplification


def _of_one_repeat(
    parts: Sequence[Scans], reference: np.ndarray, clean: np.ndarray, correlations: Correlations, blocks: Blocks
) -> tuple[np.ndarray, np.ndarray]:
    """Return the variance of every whitened ray of one repeat, over the amplification of the whitening.

    It is the variance of a first model times one factor per block, from the repeats. The factor is scaled so that the
    weight, the inverse variance, is unbiased: the mean of 1 / chi-square with n degrees of freedom is 1 / (n - 2).

    Parameters
    ----------
    parts : sequence of Scans
        Fitted and held-out repeats. Each part is compared with its own mean: with a common mean, the products of fitted
        and held-out residuals would not be 0 on average.
    reference, clean : ndarray, shape (views, rows, columns)
        Variance and line integrals of the first model.

    Returns
    -------
    variance : ndarray, shape (views, rows, columns)
    freedom : ndarray, shape (blocks,)
        Degrees of freedom.
    """
    square, freedom = np.zeros(blocks.count), np.zeros(blocks.count)
    shape = reference
    for part in parts:
        white = None if correlations.white else Whitening(correlations, clean, part.usable)
        counted = part.usable
        if white is not None:
            shape, counted = white.variance(clean) * reference / np.exp(clean), white.counted
        mean = part.repeats.mean(axis=0, dtype=np.float64)
        for repeat in part.repeats:
            deviation = np.where(part.usable, repeat - mean, 0)
            deviation = deviation if white is None else white(deviation)
            square += blocks.sum(np.where(counted, deviation**2 / shape, 0))
        freedom += blocks.sum(counted) * (len(part) - 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        level = square / np.where(freedom > FEWEST, freedom - 2, freedom)
    if not correlations.white:
        level = level / white.correlations.amplification
    return shape * blocks.spread(filled(level)), freedom
