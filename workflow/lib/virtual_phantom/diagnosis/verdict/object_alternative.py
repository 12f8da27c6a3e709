"""Errors of the stated object as an alternative to missing physics, and physics as an alternative to such errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ...physics.effect import applicable_effects
from ..fitting.fit import Fit, Fitter
from ..fitting.problem import Problem, chi_square
from ..fitting.steps import ScaledEigenvalues
from ..fitting.trial import Trial
from ..projections.object_errors import words_of
from ..selection.forward_selection import AS_GOOD, LEAST_GAIN, Choice
from ..selection.screening import screened, stands_out

FREED = 5.0  # factor of the stated standard deviations within which errors of the object are an alternative
MOST_NAMED = 2  # errors that are named, by their share of the change


def object_alternatives(fitter: Fitter, choice: Choice) -> dict[str, dict]:
    """Return differences of the object that explain the data as well as an effect, by effect.

    Errors may be FREED times as large as stated. Gains are of first order.
    """
    found = {}
    if not fitter.model.object_errors.names:
        return found
    for effect, fit in choice.without.items():
        gain, errors, what = _freed(fitter, fit)
        loses = choice.gains[effect] - gain
        if loses < max(AS_GOOD, choice.tolerance):
            found[effect] = {"what": what, "loses": loses, "errors": errors}
    return found


def imitating_effects(fitter: Fitter, baseline: Trial, effects: Sequence[str]) -> dict:
    """Return the fitted errors of the object, and the effects that would explain the same with an exact object.

    The result is empty if the data do not need errors of the object.
    """
    model = fitter.model
    if not model.object_errors.names:
        return {}
    exact = fitter.of(model.with_exact_object())
    fit = exact.fit(())
    gain = baseline.score - exact.score(fit)
    if gain < LEAST_GAIN:
        return {}
    tried = applicable_effects(effects, model.with_declared_effects(()))
    alike = screened(exact, fit, tried) if tried else {}
    names = [
        name
        for name, found in alike.items()
        if stands_out(found, len(alike), 2 * LEAST_GAIN) and found.gain / 2 > gain - AS_GOOD
    ]
    errors = {name: baseline.fit.nuisance[name] for name in model.object_errors.names}
    sizes = np.linalg.norm(model.object_errors.whitened(fitter.data) * np.sqrt(fitter.weights[0]), axis=1)
    return {"what": _words(errors, sizes), "gain": gain, "errors": errors, "imitated_by": names}


def _freed(fitter: Fitter, fit: Fit) -> tuple[float, dict[str, float], str]:
    """Return the difference of the object that explains most beyond a fit, to first order.

    It is given by its gain in held-out log score, the errors of the object by name, and the largest ones in words.
    """
    problem = Problem.at(fitter, fit)
    names = fitter.model.object_errors.names
    place = problem.positions(names)
    problem.prior_precision[place] /= FREED**2
    fitted, held = problem.jacobians_of_halves()
    residuals = fitter.residuals(fit, held_out=True)
    before = problem.beside_pattern(fitter.data.residuals(fitter.predicted(fit)))
    information, gradient = problem.normal(fitted, problem.start, before)
    step = ScaledEigenvalues.of(information).covariance @ gradient
    after = [part - (step / problem.steps) @ rows for part, rows in zip(residuals, held, strict=True)]
    gain = (chi_square(fitter.held_weights, residuals) - chi_square(fitter.held_weights, after)) / 2
    errors = dict(zip(names, map(float, (problem.start + step)[place]), strict=True))
    return gain, errors, _words(errors, np.sqrt(np.diag(information)[place]))


def _words(errors: Mapping[str, float], sizes: np.ndarray) -> str:
    """Return the errors that change the data most; `sizes` are the changes per unit."""
    changes = {name: abs(error) * size for (name, error), size in zip(errors.items(), sizes, strict=True)}
    largest = sorted(changes, key=changes.get, reverse=True)[:MOST_NAMED]
    return " and ".join(words_of(name, errors[name]) for name in largest)
