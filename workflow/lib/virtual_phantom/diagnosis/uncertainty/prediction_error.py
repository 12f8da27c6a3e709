"""What the errors of a fit's own numbers add to residuals of data that it has not seen."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import numpy as np

from ..fitting.fit import Fit, Fitter, Problem
from ..fitting.steps import Known
from ..fitting.unknown import Unknown


def left_by_numbers(fitter: Fitter, fit: Fit) -> list[np.ndarray]:
    """Changes of the predictions of the data held out that the errors of a fit's numbers make.

    They are independent, and each is one standard error large. The residuals of data held out vary by the sum of their
    squares beside their own noise: r = n - J (theta - truth), and theta has the covariance (J'WJ + K)^-1 of the data
    fitted. Numbers of effects that were found elsewhere have the errors found there, as far as the numbers fitted here
    do not make up for them.

    Returns
    -------
    list of ndarray, shape (directions, data)
        By part.
    """
    problem = Problem(fitter, fit.effects, fit)
    fitted, held = of_both_halves(fitter, problem, fit)
    information, _ = problem.normal(fitted, problem.start, [np.zeros(rows.shape[1]) for rows in fitted])
    directions = _directions(problem, fit, information)
    return [(directions / problem.steps) @ rows for rows in held]


def of_both_halves(fitter: Fitter, problem: Problem, fit: Fit) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Changes of what a fit predicts of the data fitted and of those held out.

    Parameters
    ----------
    problem : Problem
        Of the data fitted, which begins where the fit ended.

    Returns
    -------
    fitted, held : list of ndarray, shape (numbers, data)
        As Problem.jacobian gives them.
    """
    fitted = problem.jacobian_at_start(fit.pattern)
    if fitter.held_out.usable is fitter.data.usable:
        return fitted, fitted
    other = copy.copy(fitter)
    other.data, other.weights = fitter.held_out, fitter.held_weights
    return fitted, Problem(other, fit.effects, fit).jacobian_at_start(fit.pattern)


def _directions(problem: Problem, fit: Fit, information: np.ndarray) -> np.ndarray:
    """Directions, the sum of whose outer products is the numbers' covariance, shape (directions, numbers)."""
    elsewhere = np.zeros(len(problem.start), bool)
    elsewhere[: len(problem.unknowns)] = [one.name in fit.elsewhere.get(one.effect, ()) for one in problem.unknowns]
    known = Known.of(information[np.ix_(~elsewhere, ~elsewhere)])
    fitted = np.zeros((len(known.values), len(elsewhere)))
    fitted[:, ~elsewhere] = known.root.T
    found = _found([problem.unknowns[place] for place in np.flatnonzero(elsewhere)], fit)
    outside = np.zeros((len(found), len(elsewhere)))
    outside[:, elsewhere] = found
    # What was fitted here answers to what is off from elsewhere.
    outside[:, ~elsewhere] = -found @ information[np.ix_(elsewhere, ~elsewhere)] @ known.covariance
    return np.vstack([outside, fitted])


def _found(numbers: Sequence[Unknown], fit: Fit) -> np.ndarray:
    """The same of numbers that were found elsewhere, shape (directions, numbers)."""
    rows = [fit.directions.get(one.effect, {}).get(one.name) for one in numbers]
    if numbers and None not in rows:  # voltage and filtration, say, are off together or not at all
        return np.linalg.qr(np.transpose(rows), mode="r")  # the same covariance, by no more directions than numbers
    spread = []
    for one in numbers:
        value, error = fit.physics[one.effect][one.name], fit.errors[one.effect][one.name]
        ends = np.clip([value - error, value + error], one.value(one.low), one.value(one.high))
        spread.append((one.of(float(ends[1])) - one.of(float(ends[0]))) / 2)
    return np.diag(spread) if spread else np.zeros((0, 0))
