"""Uncertainty of predictions for held-out data that comes from errors of the fitted parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..fitting.fit import Fit, Fitter
from ..fitting.problem import Problem
from ..fitting.steps import ScaledEigenvalues
from ..fitting.unknown import Unknown


def changes_by_parameter_errors(fitter: Fitter, fit: Fit) -> list[np.ndarray]:
    """Return changes of held-out predictions by errors of fitted parameters, by part, shape (directions, data).

    The directions are independent, and each is one standard error. A residual of held-out data is
    r = n - J (theta - truth), so the sum of the squared directions adds to the variance of its noise n. Here theta has
    the covariance (J'WJ + K)^-1 of the fitted data. Parameters from other recordings have the errors of those
    recordings, less the part that the fitted parameters compensate for.
    """
    problem = Problem.at(fitter, fit)
    fitted, held = problem.jacobians_of_halves()
    information, _ = problem.normal(fitted, problem.start, [np.zeros(rows.shape[1]) for rows in fitted])
    directions = _directions(problem, fit, information)
    return [(directions / problem.steps) @ rows for rows in held]


def _directions(problem: Problem, fit: Fit, information: np.ndarray) -> np.ndarray:
    """Return rows whose outer products sum to the covariance of the parameters, shape (directions, parameters)."""
    elsewhere = np.zeros(len(problem.start), bool)
    names = [(number.effect, number.name) for number in problem.unknowns]
    elsewhere[: len(names)] = [name in fit.elsewhere.get(effect, ()) for effect, name in names]
    known = ScaledEigenvalues.of(information[np.ix_(~elsewhere, ~elsewhere)])
    fitted = np.zeros((len(known.values), len(elsewhere)))
    fitted[:, ~elsewhere] = known.root.T
    found = _found([problem.unknowns[place] for place in np.flatnonzero(elsewhere)], fit)
    outside = np.zeros((len(found), len(elsewhere)))
    outside[:, elsewhere] = found
    # The fitted parameters respond to errors of the parameters from other recordings.
    outside[:, ~elsewhere] = -found @ information[np.ix_(elsewhere, ~elsewhere)] @ known.covariance
    return np.vstack([outside, fitted])


def _found(numbers: Sequence[Unknown], fit: Fit) -> np.ndarray:
    """Return the rows of `_directions` for parameters from other recordings, shape (directions, parameters)."""
    rows = [fit.directions.get(number.effect, {}).get(number.name) for number in numbers]
    if numbers and None not in rows:  # their errors are correlated, as for voltage and filtration
        return np.linalg.qr(np.transpose(rows), mode="r")  # the same covariance, by no more directions than numbers
    spread = []
    for number in numbers:
        value, error = fit.physics[number.effect][number.name], fit.errors[number.effect][number.name]
        ends = np.clip([value - error, value + error], number.value(number.low), number.value(number.high))
        spread.append((number.of(float(ends[1])) - number.of(float(ends[0]))) / 2)
    return np.diag(spread) if spread else np.zeros((0, 0))
