"""Fit of effects to one recording, and its log score on held-out data."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ...base.lru_cache import LRUCache
from ...physics.effect import load
from ..noise.condensed import Observed, Prediction
from ..noise.gain_pattern import Pattern
from .linearization import BASE, Linearization
from .model import Model
from .problem import Problem, chi_square
from .solver import JointProblem, solve
from .steps import standard_errors

# A fit has stalled if its derivatives predict a decrease of chi-square larger than this, but no step achieves it. It is
# then repeated from starts farther away (problem.FARTHER).
STALLED = 8.0
SIGNIFICANT = 3.0  # standard deviations of chi-square by noise
CACHED_JACOBIANS = 4  # at the ends of fits, for rankings, tests and intervals: of two fits, on both halves of the data


@dataclass(frozen=True)
class Fit:
    """Fitted parameters, their standard errors, and chi-square.

    Attributes
    ----------
    effects : tuple of str
        In the order given, without declared effects.
    physics, errors : dict of str to dict of str to float
        {effect: {parameter: value or standard error}}, with declared effects. Before `finished`, there is only the
        error of a gain pattern.
    chi_square : float
        Chi-square of the fitted data and the priors.
    parts : tuple of float
        Chi-square by part of the data (Observed.parts).
    elsewhere : dict of str to list of str
        {effect: names of the parameters that are taken from other recordings}.
    directions : dict of str to dict of str to list of float
        {effect: {parameter: its row of a square root of the covariance}}, for joint fits and parameters from other
        recordings; empty: errors are independent.
    pulls : dict of str to float
        Deviations of the nuisance parameters from their priors, in standard deviations.
    corrected : float
        Chi-square of the corrections for numerical errors.
    pattern : Pattern or None
        Pattern of pixels, added to line integrals.
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
    pulls: dict[str, float] = field(default_factory=dict)
    linearization: Linearization = BASE
    corrected: float = 0.0
    pattern: Pattern | None = field(default=None, repr=False)

    @property
    def of_dark_signals(self) -> bool:
        """Whether the pattern is one of dark signals."""
        return self.pattern is not None and self.pattern.per_constant is not None

    @property
    def deviance(self) -> float:
        """Chi-square plus the penalty of a pattern: minus twice the log likelihood, up to a constant."""
        return self.chi_square + (0.0 if self.pattern is None else self.pattern.penalty)

    @classmethod
    def at(cls, problem: Problem, point: np.ndarray, errors: np.ndarray | None, residuals: Sequence[np.ndarray]) -> Fit:
        """Return the result of a fit that ended at a point.

        Parameters
        ----------
        errors : ndarray, shape (numbers,), or None
            Standard errors.
        residuals : sequence of ndarray, shape (data,)
            By part of the data.
        """
        model, count = problem.model, len(problem.unknowns)
        physics, nuisance = problem.named(point)
        spread: dict[str, dict[str, float]] = {name: {} for name in problem.all_effects}
        for unknown, number, error in zip(problem.unknowns, point, () if errors is None else errors, strict=False):
            spread[unknown.effect][unknown.name] = float(unknown.value_error(number, error))
        for name in problem.effects:
            if load(name).pattern:
                physics[name]["rms"], spread[name]["rms"] = problem.pattern.rms, problem.pattern.error
        ends = () if errors is None else map(float, errors[count:])
        corrected = np.ravel(model.distortion(nuisance, problem.linearization)) ** 2
        return cls(
            effects=problem.effects,
            physics=physics,
            errors=spread,
            nuisance=nuisance,
            nuisance_errors=dict(zip(nuisance, ends, strict=False)),
            chi_square=problem.chi_square(residuals, point),
            parts=tuple(float((w * r**2).sum()) for w, r in zip(problem.weights, residuals, strict=True)),
            free=count + bool(problem.pattern and problem.pattern.rms),
            elsewhere={name: list(model.fixed[name]) for name in problem.all_effects if name in model.fixed},
            pulls={
                number.name: float(number.pull(nuisance[number.name]))
                for number in problem.nuisances
                if np.isfinite(number.sd)
            },
            linearization=problem.linearization,
            corrected=float((problem.weights[0] * corrected).sum()),
            pattern=problem.pattern,
        )


class Fitter:
    """Fits and log scores for one recording.

    Parameters
    ----------
    data, held_out : Observed
        Data that are fitted, and data that are predicted. If both are the same object, scores are estimates (`score`).
    variance : ndarray
        Variance of one repeat, whitened, along the data's three axes. Weights follow from it: they are the same for
        all models, so that scores compare.
    floor : ndarray
        Numerical error of the predictions, whitened, one standard deviation, along the data's three axes.
    """

    def __init__(self, model: Model, data: Observed, held_out: Observed, variance: np.ndarray, floor: np.ndarray):
        self.model, self.data, self.held_out = model, data, held_out
        self.variance, self.floor = variance, floor
        self.weights = data.weights(variance, floor)
        self.held_weights = held_out.weights(variance, floor)
        self.jacobians = LRUCache(CACHED_JACOBIANS)

    def of(self, model: Model) -> Fitter:
        """Return the fitter of another model for the same data with the same weights."""
        found = copy.copy(self)
        found.model, found.jacobians = model, LRUCache(CACHED_JACOBIANS)
        return found

    def fit(
        self,
        effects: tuple[str, ...],
        given: Fit | None = None,
        from_farther: bool = True,
        final: bool = True,
        needed: float = np.inf,
    ) -> Fit:
        """Fit all parameters of these effects and the nuisance parameters.

        Parameters
        ----------
        from_farther : bool, optional
            Whether a fit that has stalled is repeated from starts farther away.
        final : bool, optional
            False: the fit only serves for a comparison with others. It ends earlier and has no standard errors.
        needed : float, optional
            Chi-square above which such a fit does not matter, so that it ends as soon as it cannot be reached.
        """
        problem = Problem(self, effects, given)
        found, predicted_decrease = self._solve(problem, final, needed)
        if predicted_decrease > STALLED and from_farther:
            others = [self._solve(Problem(self, effects, start), final, needed)[0] for start in problem.farther(found)]
            found = min([found, *others], key=lambda fit: fit.chi_square)
        return self._with_errors(found) if final else found

    def _solve(self, problem: Problem, final: bool, needed: float) -> tuple[Fit, float]:
        """Return a fit, and the decrease of chi-square that its derivatives still predict; 0 if it converged."""
        point = problem.best_start()
        problem.follow(point)
        alone = JointProblem({"": problem}, {"": ""})
        found = solve(alone, alone.recompute(point), compared=not final, needed=needed)
        errors = standard_errors(found.information) if final and found.information is not None else None
        return Fit.at(problem, found.point, errors, found.residuals[""]), found.predicted_decrease

    def finished(self, fit: Fit) -> Fit:
        """Return a fit that was made for a comparison as a final one."""
        return fit if fit.nuisance_errors else self.fit(fit.effects, fit)

    def _with_errors(self, fit: Fit) -> Fit:
        if fit.nuisance_errors:
            return fit
        problem = Problem.at(self, fit)
        residuals = problem.residuals(problem.start)
        information, _ = problem.normal(problem.jacobian_at_start(), problem.start, residuals)
        found = Fit.at(problem, problem.start, standard_errors(information), residuals)
        return replace(fit, errors=found.errors, nuisance_errors=found.nuisance_errors)

    def predicted(self, fit: Fit, held_out: bool = False) -> Prediction:
        """Return a fit's prediction of the fitted or the held-out data, without its gain pattern."""
        data = self.held_out if held_out else self.data
        return self.model.predict(fit.physics, fit.nuisance, data, fit.linearization)

    def residuals(self, fit: Fit, held_out: bool) -> list[np.ndarray]:
        """Return observed minus predicted data, by part, shape (data,); the mean's noise is whitened."""
        data = self.held_out if held_out else self.data
        mean, *rest = data.residuals(self.predicted(fit, held_out))
        if fit.pattern is not None:
            change = fit.pattern.over_data(data.pattern_field(fit.pattern.values))
            mean = (mean.reshape(data.mean.shape) - data.whitened(change)).ravel()
        return [mean, *rest]

    def comparable(self, fit: Fit, without: Fit) -> Fit:
        """Return a fit with the pattern of the fit without its last effect, and with its chi-square by this pattern.

        An effect that explains a part of the pattern makes the priors narrower, which would raise chi-square.
        """
        if without.pattern is None or fit.of_dark_signals != without.of_dark_signals:
            return fit
        problem = Problem.at(self, fit)
        problem.pattern = without.pattern
        chi_square = problem.chi_square(problem.residuals(problem.start), problem.start)
        return replace(fit, chi_square=chi_square, pattern=without.pattern)

    def score(self, fit: Fit) -> float:
        """Return the log score of the held-out data up to a constant: minus half of chi-square.

        If no data are held out, it is estimated: every fitted number costs 1 [1]_, and a gain pattern the logarithm of
        its marginal likelihood (Pattern.penalty). Chi-square includes the priors.

        References
        ----------
        .. [1] H. Akaike, IEEE Trans. Autom. Control 19, 716, 1974.
        """
        if self.held_out is self.data:
            return -0.5 * fit.deviance - fit.free
        return -0.5 * chi_square(self.held_weights, self.residuals(fit, held_out=True))

    def significant_excess(self, score: float) -> float:
        """Return the log score that held-out data lose beyond noise, for the score of a fit; 0 if not significant."""
        count = sum(int((weights > 0).sum()) for weights in self.held_weights)
        return max(0.0, -score - (count + SIGNIFICANT * math.sqrt(2 * count)) / 2)
