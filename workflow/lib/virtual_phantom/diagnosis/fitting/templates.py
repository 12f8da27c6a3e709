"""First-order changes of the data by effects (templates), and what a fit can absorb of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...physics.effect import Parameter, load
from .fit import Fit, Fitter
from .problem import MOVING_STEPS, SLOPE_REACH, Problem, whitened
from .unknown import Unknown

SMALL = 1e-9  # share of a template's square that remains by rounding if nuisance parameters absorb it entirely


def data_changes(problem: Problem) -> np.ndarray:
    """Return the change of the whitened data per unit of every number, shape (data, numbers)."""
    return np.stack(whitened_columns(problem.jacobian_at_start(), problem.weights, problem.steps), axis=1)


def whitened_columns(jacobian: list[np.ndarray], weights: list[np.ndarray], steps: np.ndarray) -> list[np.ndarray]:
    """Return the change of the whitened data per unit of every number, from a Jacobian per step."""
    return [whitened([rows[index] for rows in jacobian], weights) / step for index, step in enumerate(steps)]


def with_priors(columns: np.ndarray, problem: Problem) -> np.ndarray:
    """Append the priors of the numbers as rows to the changes of the data, shape (data + numbers, numbers).

    A number then absorbs only as much of a change as its prior allows.
    """
    return np.vstack([columns, np.diag(np.sqrt(problem.prior_precision))])


def projected(rows: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """Return whitened data orthogonal to a basis, shape (rows, data + numbers)."""
    known = basis.shape[0] - rows.shape[1]
    rows = np.hstack([rows, np.zeros((len(rows), known))])
    return rows - (rows @ basis) @ basis.T


def varied(parameters: Sequence[Parameter]) -> tuple[Parameter, ...]:
    """Return the parameters with a neutral value; each of them has its own template."""
    return tuple(parameter for parameter in parameters if parameter.neutral is not None)


def neutral_values(parameters: Sequence[Parameter]) -> dict[str, float]:
    """Return the neutral values of the parameters that have one, by name."""
    return {parameter.name: parameter.neutral for parameter in varied(parameters)}


def strength(parameter: Parameter) -> float:
    """Return a parameter's strength in its template: the typical value, or a part of the range if that is neutral."""
    if parameter.typical != parameter.neutral:
        return parameter.typical
    far = max(parameter.low, parameter.high, key=lambda end: abs(end - parameter.neutral))
    return parameter.neutral + (far - parameter.neutral) / 20


def templates(fitter: Fitter, fit: Fit, name: str, shapes: Sequence[Mapping[str, float]] = ({},)) -> np.ndarray:
    """Return the changes of the whitened data by an effect, shape (shapes * parameters, data).

    Each parameter with a neutral value is changed alone, to its typical strength. An effect without such a parameter is
    at typical values. For parameters that move rays, the template is the derivative times the strength. The pose
    compensates for 99 % of their effect, so linearization errors of a large change would look like another effect.

    Parameters
    ----------
    shapes : sequence of mapping of str to float, optional
        Values of parameters without a neutral value, where they are not typical. Parameters, in the order of `varied`,
        change faster than shapes.
    """
    problem, every = Problem.at(fitter, fit), fitter.model.parameters(name)
    before = fitter.data.residuals(fitter.predicted(fit))
    ranges = {unknown.name: unknown for unknown in fitter.model.unknowns((name,))}
    typical = {}
    for parameter in every:
        unknown = ranges[parameter.name]
        number = min(max(parameter.to_variable(parameter.typical), unknown.low), unknown.high)
        typical[parameter.name] = unknown.value(number)
    typical |= fitter.model.known(name)
    off = neutral_values(every)
    steps = [_step(name, parameter, ranges[parameter.name]) for parameter in varied(every)]
    rows = []
    for shape in shapes:
        for strong, times, reach in steps or [({}, 1.0, 1.0)]:
            values = typical | dict(shape) | off | strong
            linearization = replace(fit.linearization, reach=reach)
            changed = fitter.model.predict(fit.physics | {name: values}, fit.nuisance, fitter.data, linearization)
            after = fitter.data.residuals(changed)
            rows.append(times * problem.whitened([a - b for a, b in zip(before, after, strict=True)]))
    return np.stack(rows)


def _step(name: str, parameter: Parameter, unknown: Unknown) -> tuple[dict[str, float], float, float]:
    """Return a template's parameter, the factor of its change, and the reach of its rays."""
    strong = strength(parameter)
    if not load(name).moves(parameter):
        return {parameter.name: strong}, 1.0, 1.0
    step = MOVING_STEPS[load(name).stage] * (unknown.high - unknown.low)  # the variable is the parameter itself
    step = min(step, abs(strong - parameter.neutral)) * np.sign(strong - parameter.neutral)
    return {parameter.name: parameter.neutral + step}, float((strong - parameter.neutral) / step), SLOPE_REACH
