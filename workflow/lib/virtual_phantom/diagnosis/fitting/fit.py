"""Fits of effects to condensed repeats: Gauss-Newton with Broyden's updates, within plausible ranges."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from ...base.recent import Kept
from ...physics.effect import FOCAL_SPOT, GEOMETRY, MOTION, load
from ..noise import gain_pattern as patterns
from ..noise.condensed import Observed
from ..noise.prediction import Prediction
from .linearization import BASE, Linearisation, LinearisationPoint
from .model import Model
from .nuisance import POSES, SURE, Nuisance
from .steps import bounded_step, standard_errors, updated

# Of a fit, so that it ends. Nearly all settle within 25; along a narrow valley, as of a detector that is a row off its
# place beside an object that may be displaced, 40 are wanted.
ITERATIONS = 60
MOST_LINEARISATIONS = 3  # times that numerical errors are computed again in a fit, each when it has settled
# Of chi-square between two iterations: in units of noise, and of its excess over noise where the model lacks much.
CONVERGED, CONVERGED_SHARE = 0.02, 1e-5
# Share of the expected gain that a step must make for its Jacobian to stay in use.
AS_EXPECTED = (0.7, 1.4)
# Chi-square that slopes must promise where no step gains anything, for a fit to be tried from farther off, and how far:
# shares of the range.
STALLED, FARTHER = 8.0, (-0.5, -0.1, 0.1, 0.5)
# For derivatives: shares of the plausible range and of the alignment's standard deviation. Path lengths are in single
# precision, so that smaller steps would measure rounding.
STEP, ALIGNMENT_STEP = 2e-3, 4e-3
# The same by stage, of what moves rays or the object, which trades against size, scale and place to one part in ten. By
# slopes over eight times these steps, 3 to 5 % off, fits of source distances ended 3 to 24 above the least chi-square.
MOVING_STEPS = {GEOMETRY: 2.5e-4, MOTION: 2.5e-4, FOCAL_SPOT: 2e-3}
# Times as far as usual that rays follow others for these slopes and those of the alignment: all are of the same rays. A
# blur has no slope of first order, so that its rays are followed no farther than usual.
SLOPE_REACH = 2.0
UNKNOWN_STEP = 1e-3  # of an alignment of which nothing is known
SIZE_STEP = 4e-5  # 4 um at 100 mm, as for places
# Marquardt's damping: from none, first to LEAST_DAMPING, then by factors of DAMPING while a step makes the fit worse.
LEAST_DAMPING, DAMPING, MOST_DAMPING = 1e-4, 10.0, 1e4
# Jacobians where fits have ended, for which rankings, kinds of change and intervals ask in turn: so many (of two fits,
# in both halves), as long as each has no more bytes than that.
KEPT, MOST_KEPT = 4, 1e8


@dataclass(frozen=True)
class Fit:
    """What was fitted, and how well.

    Attributes
    ----------
    effects : tuple of str
        In the order in which they were given, without those declared.
    physics : dict of str to dict of str to float
        {effect: {parameter: value}}, of those declared too.
    errors : dict of str to dict of str to float
        {effect: {parameter: standard error}}.
    nuisance, nuisance_errors : dict of str to float
        Nuisance parameters and their standard errors.
    chi_square : float
        Of the data that were fitted, and of the Gaussian knowledge.
    parts : tuple of float
        Chi-square by part of the data (Observed.parts).
    free : int
        Number of effects' parameters.
    elsewhere : dict of str to list of str
        {effect: parameters that were found on other recordings, and not fitted}.
    directions : dict of str to dict of str to list of float
        {effect: {parameter: the row of its number in a root of the covariance}}, of a fit to several recordings, or of
        what was found elsewhere; empty: not told, as if independent.
    pulled : dict of str to float
        How far the nuisance parameters lie off what the fit knew of them, in standard deviations, where anything was
        known.
    linearisation : Linearisation
        Of the predictions.
    corrected : float
        Chi-square that the model's numerical errors make up.
    pattern : ndarray, shape (rows, columns), or None
        Gain pattern, added to line integrals.
    pattern_variance : ndarray, shape (rows, columns), or None
        Variance that each of its constants is left with.
    """

    effects: tuple[str, ...]
    physics: dict[str, dict[str, float]]
    errors: dict[str, dict[str, float]]
    nuisance: dict[str, float]
    nuisance_errors: dict[str, float]
    chi_square: float
    parts: tuple[float, ...]
    free: int
    elsewhere: dict[str, list[str]] = field(default_factory=dict)
    directions: dict[str, dict[str, list[float]]] = field(default_factory=dict, repr=False)
    pulled: dict[str, float] = field(default_factory=dict)
    linearisation: Linearisation = BASE
    corrected: float = 0.0
    pattern: np.ndarray | None = field(default=None, repr=False)
    pattern_variance: np.ndarray | None = field(default=None, repr=False)


class Fitter:
    """Fits and scores of models of one recording.

    Parameters
    ----------
    data : Observed
        What is fitted.
    held_out : Observed
        What is predicted.
    variance : ndarray
        Of one repeat, whitened, along the data's three axes, for the weights: the same for all models, so that scores
        compare.
    floor : ndarray
        Numerical error of the predictions, whitened, standard deviation, along the data's three axes.
    """

    def __init__(self, model: Model, data: Observed, held_out: Observed, variance: np.ndarray, floor: np.ndarray):
        self.model, self.data, self.held_out = model, data, held_out
        self.weights = data.weights(variance, floor)
        self.held_weights = held_out.weights(variance, floor)
        self.kept = Kept(KEPT)

    def of(self, model: Model) -> Fitter:
        """The same data with the same weights, of another model."""
        found = copy.copy(self)
        found.model, found.kept = model, Kept(KEPT)
        return found

    def fit(self, effects: tuple[str, ...], given: Fit | None = None, from_farther: bool = True) -> Fit:
        """Refit all parameters of these effects and the alignment.

        Parameters
        ----------
        given : Fit, optional
            Where to begin.
        from_farther : bool, optional
            Begin again from farther off where the fit has stalled.
        """
        problem = Problem(self, effects, given)
        found, promised = self._settled(problem)
        if promised <= STALLED or not from_farther:
            return found
        others = [self._settled(Problem(self, effects, one))[0] for one in problem.farther(found)]
        return min([found, *others], key=lambda one: one.chi_square)

    def _settled(self, problem: Problem) -> tuple[Fit, float]:
        """Where a fit ends; and what slopes promise there of chi-square though no step gains anything."""
        jacobian = None
        point = problem.best_start()
        problem.follow(point)
        pattern, residuals = problem.recompute_residuals(point)
        current, damping, as_expected = problem.chi_square(residuals, point), 0.0, False
        for _ in range(ITERATIONS):
            fresh = jacobian is None
            if fresh:
                jacobian = problem.jacobian(point, residuals, pattern)
            information, gradient = problem.normal(jacobian, point, residuals)
            before, enough = current, max(CONVERGED, CONVERGED_SHARE * (current - problem.count))
            promised = 0.0  # by the slopes, without damping
            while True:
                damped = information + damping * np.diag(np.diag(information))
                step = bounded_step(damped, gradient, point, problem.low, problem.high)
                expected = float(2 * gradient @ step - step @ information @ step)
                promised = promised or expected
                if expected < enough:
                    break
                trial, tried = problem.solve_scale_and_offset(np.clip(point + step, problem.low, problem.high), pattern)
                reached = problem.chi_square(tried, trial)
                if reached <= current:
                    jacobian = updated(jacobian, (trial - point) / problem.steps, residuals, tried)
                    point, residuals, current = trial, tried, reached
                    if problem.follow(point):
                        residuals = problem.residuals(point, pattern)
                        current = problem.chi_square(residuals, point)
                    damping = damping / DAMPING if damping > LEAST_DAMPING else 0.0
                    break
                damping = max(LEAST_DAMPING, damping * DAMPING)
                if damping > MOST_DAMPING or not fresh:
                    break
            gained = before - current
            settled = expected < enough and (fresh or as_expected)
            if not settled:
                as_expected = AS_EXPECTED[0] * expected < gained < AS_EXPECTED[1] * expected
                if problem.patterned:
                    pattern, residuals = problem.recompute_residuals(point)
                    current = problem.chi_square(residuals, point)
                settled = gained < enough and fresh
            # A pattern is estimated in turn with the numbers, which settles slowly.
            strayed = (settled or problem.patterned) and problem.needs_new_corrections(point)
            if settled and not strayed:
                break
            if strayed:
                pattern, residuals = problem.recompute_residuals(point)
                current = problem.chi_square(residuals, point)
            if strayed or not as_expected:
                jacobian = None
        if not fresh:  # updates serve the next step: of numbers that moved far, slopes may be off by far
            information, _ = problem.normal(problem.jacobian(point, residuals, pattern), point, residuals)
        errors = standard_errors(information)
        stuck = promised if fresh and settled and not gained else 0.0
        return problem.result(point, errors, residuals, current, pattern), stuck

    def predicted(self, fit: Fit, held_out: bool = False) -> Prediction:
        """What a fit predicts of the data fitted, or of those held out; a gain pattern is no part of it."""
        data = self.held_out if held_out else self.data
        return self.model.predict(fit.physics, fit.nuisance, data, fit.linearisation)

    def residuals(self, fit: Fit, held_out: bool = True) -> list[np.ndarray]:
        """Observed less predicted, by part; the mean's noise made white.

        Parameters
        ----------
        held_out : bool, optional
            Of the data held out; False: of those fitted.

        Returns
        -------
        list of ndarray, shape (data,)
        """
        data = self.held_out if held_out else self.data
        return less_pattern(data.residuals(self.predicted(fit, held_out)), fit.pattern, data)

    def score(self, fit: Fit) -> float:
        """Log score of the data held out, up to a constant: minus half of chi-square."""
        return -0.5 * chi_square(self.held_weights, self.residuals(fit))


class Problem:
    """One choice of effects: its unknowns, what is known of them, and their residuals.

    A point holds the numbers of the effects (`unknowns`), then those of the alignment (`aligned`).

    Parameters
    ----------
    given : Fit or None
        Where the numbers begin.
    beside : str, optional
        A further effect that is not fitted, beside which the alignment is known otherwise.
    """

    def __init__(self, fitter: Fitter, effects: tuple[str, ...], given: Fit | None, beside: str | None = None):
        self.fitter, self.effects = fitter, tuple(effects)
        self.model, self.data, self.weights = fitter.model, fitter.data, fitter.weights
        self.patterned = any(load(name).pattern for name in effects)
        self.linearisation, self.linearised = self.model.nominal if given is None else given.linearisation, 0
        self.whole = self.model.whole(self.effects)
        self.unknowns = self.model.unknowns(self.whole)
        aligned = self.model.alignment(self.effects if beside is None else (*self.effects, beside))
        self.fresh = [given is None or one.effect not in given.physics for one in self.unknowns]
        values = [
            one.start if fresh else one.of(given.physics[one.effect][one.name])
            for one, fresh in zip(self.unknowns, self.fresh, strict=True)
        ]
        nuisance = {one.name: one.expected for one in aligned} if given is None else given.nuisance
        start = np.array([*values, *(nuisance[one.name] for one in aligned)], float)
        self.low = np.array([one.low for one in self.unknowns] + [one.expected - SURE * one.sd for one in aligned])
        self.high = np.array([one.high for one in self.unknowns] + [one.expected + SURE * one.sd for one in aligned])
        self.start = np.clip(start, self.low, self.high)
        self.aligned = aligned
        self.count = sum(int((weight > 0).sum()) for weight in self.weights)
        self.centre = np.array([one.expected for one in (*self.unknowns, *aligned)])
        width = np.array([one.sd for one in (*self.unknowns, *aligned)])
        self.knowledge = np.where(np.isfinite(width), 1 / width**2, 0)
        spans = [
            (MOVING_STEPS[load(one.effect).stage] if one.moves else STEP) * (one.high - one.low)
            for one in self.unknowns
        ]
        spans += [alignment_step(one) for one in aligned]
        self.steps = np.array(spans)
        self.moving = [one.moves for one in self.unknowns] + [one.name in POSES for one in aligned]

    def best_start(self) -> np.ndarray:
        """Where to begin.

        Numbers of new effects that have several starts are tried at all of them, with the alignment given and the one
        expected. Elsewhere a fit could end beside the best one.

        Returns
        -------
        ndarray, shape (numbers,)
        """
        count = len(self.unknowns)
        choices = [
            one.starts if fresh else (value,)
            for one, fresh, value in zip(self.unknowns, self.fresh, self.start, strict=False)
        ]
        if all(len(choice) == 1 for choice in choices):
            return self.start
        faint = any(self._new_strengths())
        places = [self.start[count:], np.array([one.expected for one in self.aligned])]
        begun = []
        for place in places:
            full = [self.solve_scale_and_offset(np.array([*values, *place]), None) for values in product(*choices)]
            begun += full
            if faint:
                off = self.solve_scale_and_offset(self._switched_off(np.array([*self.start[:count], *place])), None)
                begun += [self._between(off, one) for one in full]
        return min(begun, key=lambda one: self.chi_square(one[1], one[0]))[0]

    def _new_strengths(self) -> list[bool]:
        """Of every unknown, whether it is of a new effect and has a value where that changes nothing."""
        return [fresh and one.neutral is not None for one, fresh in zip(self.unknowns, self.fresh, strict=True)]

    def _switched_off(self, point: np.ndarray) -> np.ndarray:
        """A point with new effects at the values where they change nothing, as far as they have such values."""
        point = point.copy()
        for place, new in enumerate(self._new_strengths()):
            if new:
                point[place] = self.unknowns[place].neutral
        return point

    def _between(
        self, off: tuple[np.ndarray, list[np.ndarray]], full: tuple[np.ndarray, list[np.ndarray]]
    ) -> tuple[np.ndarray, list[np.ndarray]]:
        """Between two points, one as if residuals were straight there.

        Of a strength that starts far too high, the wrong shape would look best that does the least harm.

        Parameters
        ----------
        off, full : tuple of ndarray and list of ndarray
            A point with new effects off or at full strength, and its residuals.

        Returns
        -------
        point : ndarray, shape (numbers,)
        residuals : list of ndarray, shape (data,)
        """
        change = [here - there for here, there in zip(off[1], full[1], strict=True)]
        square = chi_square(self.weights, change)
        if not square:
            return full
        along = sum(float((w * r * c).sum()) for w, r, c in zip(self.weights, off[1], change, strict=True))
        point = full[0].copy()
        for place, new in enumerate(self._new_strengths()):
            if new:
                point[place] = off[0][place] + along / square * (full[0][place] - off[0][place])
        return self.solve_scale_and_offset(np.clip(point, self.low, self.high), None)

    def farther(self, fit: Fit) -> list[Fit]:
        """Where a fit of this problem may begin again that has stalled.

        What moves rays trades against the alignment along valleys that are narrow, and rough: errors of finite steps
        are alike nowhere along them. New numbers of such effects are set off, and what was fitted stays.
        """
        found = []
        for index, new in enumerate(self._new_strengths()):
            one = self.unknowns[index]
            if not new or load(one.effect).stage != GEOMETRY:
                continue
            here = one.of(fit.physics[one.effect][one.name])
            numbers = [here + share * (self.high[index] - self.low[index]) for share in FARTHER]
            for number in dict.fromkeys(np.clip(numbers, self.low[index], self.high[index])):
                moved = fit.physics[one.effect] | {one.name: float(one.value(number))}
                found.append(replace(fit, physics=fit.physics | {one.effect: moved}))
        return found

    def needs_new_corrections(self, point: np.ndarray) -> bool:
        """Whether predictions of a point lie off those of which numerical errors were computed.

        If so, these errors are computed there from then on.

        Parameters
        ----------
        point : ndarray, shape (numbers,)
        """
        if self.linearised == MOST_LINEARISATIONS:
            return False
        physics, nuisance = self._named(point)
        prediction = self.model.predict(physics, nuisance, self.data, self.linearisation)
        if not self.model.strayed(self.linearisation.errors, nuisance, prediction, self.weights[0]):
            return False
        self.linearisation = replace(self.linearisation, errors=LinearisationPoint.of(physics, nuisance))
        self.linearised += 1
        return True

    def follow(self, point: np.ndarray) -> bool:
        """Let rays follow those of a point, if its own are too far off those that they follow.

        Parameters
        ----------
        point : ndarray, shape (numbers,)

        Returns
        -------
        bool
            Whether they were.
        """
        physics, nuisance = self._named(point)
        if self.model.follows(physics, nuisance, self.linearisation.rays):
            return False
        self.linearisation = replace(self.linearisation, rays=LinearisationPoint.of(physics, nuisance))
        return True

    def residuals(self, point: np.ndarray, pattern: np.ndarray | None, reach: float = 1.0) -> list[np.ndarray]:
        """Observed less predicted and less a gain pattern, by part; the mean's noise made white.

        Parameters
        ----------
        point : ndarray, shape (numbers,)
        pattern : ndarray, shape (rows, columns), or None
        reach : float, optional
            As Linearisation has it.

        Returns
        -------
        list of ndarray, shape (data,)
        """
        linearisation = replace(self.linearisation, reach=reach)
        prediction = self.model.predict(*self._named(point), self.data, linearisation)
        return less_pattern(self.data.residuals(prediction), pattern, self.data)

    def _named(self, point: np.ndarray) -> tuple[dict[str, dict[str, float]], dict[str, float]]:
        """Effects' parameters and the alignment of a point, by name."""
        physics = {name: self.model.known(name) for name in self.whole}
        for one, value in zip(self.unknowns, point, strict=False):
            physics[one.effect][one.name] = float(one.value(value))
        aligned = point[len(self.unknowns) :]
        return physics, {one.name: float(value) for one, value in zip(self.aligned, aligned, strict=True)}

    def solve_scale_and_offset(
        self, point: np.ndarray, pattern: np.ndarray | None
    ) -> tuple[np.ndarray, list[np.ndarray]]:
        """A point with the best scale and offset for its other numbers, in closed form, and its residuals.

        Both are linear, and most effects trade against them: without this, fits creep along narrow curved valleys.

        Parameters
        ----------
        point : ndarray, shape (numbers,)
        pattern : ndarray, shape (rows, columns), or None

        Returns
        -------
        point : ndarray, shape (numbers,)
        residuals : list of ndarray, shape (data,)
        """
        physics, nuisance = self._named(point)
        prediction = self.model.predict(physics, nuisance, self.data, self.linearisation)
        residuals = less_pattern(self.data.residuals(prediction), pattern, self.data)
        first = len(self.unknowns)
        index = [first + [one.name for one in self.aligned].index(name) for name in ("scale", "offset")]
        changes = (self.data.whitened(np.where(self.data.usable, column, 0)) for column in prediction.design)
        design, weight = np.stack([column.ravel() for column in changes]), self.weights[0]
        information = (design * weight) @ design.T + np.diag(self.knowledge[index])
        gradient = (design * weight) @ residuals[0] + self.knowledge[index] * (self.centre[index] - point[index])
        step = bounded_step(information, gradient, point[index], self.low[index], self.high[index])
        point = point.copy()
        point[index] = np.clip(point[index] + step, self.low[index], self.high[index])
        return point, [np.where(weight > 0, residuals[0] - step @ design, 0), *residuals[1:]]

    def recompute_residuals(self, point: np.ndarray) -> tuple[np.ndarray | None, list[np.ndarray]]:
        """The gain pattern at a point, and the residuals that it leaves.

        Parameters
        ----------
        point : ndarray, shape (numbers,)

        Returns
        -------
        pattern : ndarray, shape (rows, columns), or None
            None if there is none.
        residuals : list of ndarray, shape (data,)
        """
        residuals = self.residuals(point, None)
        if not self.patterned:
            return None, residuals
        shape = self.data.mean.shape
        self.found = patterns.estimate(residuals[0].reshape(shape), self.weights[0].reshape(shape), self.data.whitening)
        return self.found.values, less_pattern(residuals, self.found.values, self.data)

    def chi_square(self, residuals: list[np.ndarray], point: np.ndarray) -> float:
        """Of residuals, and of how far a point lies off what is known of it."""
        return chi_square(self.weights, residuals) + float((self.knowledge * (point - self.centre) ** 2).sum())

    def jacobian(self, point, residuals, pattern) -> list[np.ndarray]:
        """Change of what is predicted per `steps`, by part.

        Parameters
        ----------
        point : ndarray, shape (numbers,)
        residuals : list of ndarray, shape (data,)
            Of the point.
        pattern : ndarray, shape (rows, columns), or None

        Returns
        -------
        list of ndarray, shape (numbers, data)
        """
        columns = [self.derivative(index, point, residuals, pattern) for index in range(len(point))]
        return [
            np.stack([step * column[part] for step, column in zip(self.steps, columns, strict=True)])
            for part in range(len(residuals))
        ]

    def jacobian_at_start(self, pattern: np.ndarray | None) -> list[np.ndarray]:
        """As `jacobian`, where the problem begins: it is kept for who asks next, unless it is large.

        Parameters
        ----------
        pattern : ndarray, shape (rows, columns), or None

        Returns
        -------
        list of ndarray, shape (numbers, data)
        """

        def made() -> list[np.ndarray]:
            return self.jacobian(self.start, self.residuals(self.start, pattern), pattern)

        if 8 * len(self.start) * self.data.mean.size > MOST_KEPT:
            return made()
        numbers = (self.start, self.steps, self.high, *(() if pattern is None else (pattern,)))
        linearised = self.linearisation.errors.key, self.linearisation.rays.key
        held = self.data is self.fitter.held_out
        key = self.effects, held, linearised, tuple(one.tobytes() for one in numbers)
        return self.fitter.kept.get(key, made)

    def normal(self, jacobian, point, residuals) -> tuple[np.ndarray, np.ndarray]:
        """Information matrix and gradient at a point.

        Parameters
        ----------
        jacobian : list of ndarray, shape (numbers, data)
            As from `jacobian`.
        point : ndarray, shape (numbers,)
        residuals : list of ndarray, shape (data,)

        Returns
        -------
        information : ndarray, shape (numbers, numbers)
        gradient : ndarray, shape (numbers,)
            Of minus half of chi-square.
        """
        information, gradient = np.diag(self.knowledge), self.knowledge * (self.centre - point)
        for rows, weight, residual in zip(jacobian, self.weights, residuals, strict=True):
            weighted = rows * weight
            information = information + (weighted @ rows.T) / np.outer(self.steps, self.steps)
            gradient = gradient + (weighted @ residual) / self.steps
        return information, gradient

    def derivative(self, index, point, residuals, pattern) -> list[np.ndarray]:
        """Change of what is predicted per unit of one number, by part.

        Parameters
        ----------
        index : int
            Of the number.
        point : ndarray, shape (numbers,)
        residuals : list of ndarray, shape (data,)
            Of the point.
        pattern : ndarray, shape (rows, columns), or None

        Returns
        -------
        list of ndarray, shape (data,)
        """
        step = self.steps[index] if point[index] + self.steps[index] <= self.high[index] else -self.steps[index]
        moved = point.copy()
        moved[index] += step
        there = self.residuals(moved, pattern, SLOPE_REACH if self.moving[index] else 1.0)
        return [(one - other) / step for one, other in zip(residuals, there, strict=True)]

    def result(self, point, errors, residuals, total, pattern) -> Fit:
        """The fit that ended at a point.

        Parameters
        ----------
        point, errors : ndarray, shape (numbers,)
            Numbers, and their standard errors.
        residuals : list of ndarray, shape (data,)
        total : float
            Chi-square.
        pattern : ndarray, shape (rows, columns), or None
        """
        physics = {name: self.model.known(name) for name in self.whole}
        spread: dict[str, dict[str, float]] = {name: {} for name in self.whole}
        for one, number, error in zip(self.unknowns, point, errors, strict=False):
            physics[one.effect][one.name] = float(one.value(number))
            spread[one.effect][one.name] = float(one.value_error(number, error))
        for name in self.effects:
            if load(name).pattern:
                physics[name]["rms"], spread[name]["rms"] = self.found.rms, self.found.error
        count, aligned = len(self.unknowns), [one.name for one in self.aligned]
        known = zip(self.aligned, point[count:], strict=True)
        nuisance = dict(zip(aligned, map(float, point[count:]), strict=True))
        corrected = np.ravel(self.model.distortion(nuisance, self.linearisation)) ** 2
        return Fit(
            effects=self.effects,
            physics=physics,
            errors=spread,
            nuisance=nuisance,
            nuisance_errors=dict(zip(aligned, map(float, errors[count:]), strict=True)),
            chi_square=total,
            parts=tuple(float((w * r**2).sum()) for w, r in zip(self.weights, residuals, strict=True)),
            free=count + self.patterned,
            elsewhere={name: list(self.model.fixed[name]) for name in self.whole if name in self.model.fixed},
            pulled={one.name: float(one.off(value)) for one, value in known if np.isfinite(one.sd)},
            linearisation=self.linearisation,
            corrected=float((self.weights[0] * corrected).sum()),
            pattern=pattern,
            pattern_variance=self.found.variance if self.patterned else None,
        )


def alignment_step(one: Nuisance) -> float:
    """The step by which a number of the alignment is varied for derivatives."""
    if one.name == "size":
        return SIZE_STEP
    return ALIGNMENT_STEP * one.sd if np.isfinite(one.sd) else UNKNOWN_STEP


def chi_square(weights: list[np.ndarray], residuals: list[np.ndarray]) -> float:
    """Sum of squared residuals times weights, over all parts."""
    return sum(float((weight * residual**2).sum()) for weight, residual in zip(weights, residuals, strict=True))


def less_pattern(parts: list[np.ndarray], pattern: np.ndarray | None, data: Observed) -> list[np.ndarray]:
    """Residuals by part, less a gain pattern in the mean's if there is one."""
    if pattern is None:
        return parts
    mean = parts[0].reshape(data.mean.shape) - data.whitened(np.where(data.usable, pattern, 0))
    return [mean.ravel(), *parts[1:]]
