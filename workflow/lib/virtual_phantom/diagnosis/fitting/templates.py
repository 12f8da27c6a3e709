"""First-order distortions of effects, and what could take them up.

That is what one of typical strength changes of every part of the data, whitened by the weights, and what of that
alignment and the effects already fitted could take up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...physics.effect import Parameter, load
from .fit import MOVING_STEPS, SLOPE_REACH, Fit, Fitter, Problem
from .unknown import Unknown

SMALL = 1e-9  # of a template's square: what is left of one that the alignment takes up entirely


def whitened(parts: list[np.ndarray], weights: list[np.ndarray]) -> np.ndarray:
    """Parts of the data in standard deviations, one after the other, shape (data,)."""
    return np.concatenate([part * np.sqrt(weight) for part, weight in zip(parts, weights, strict=True)])


def data_changes(problem: Problem, pattern: np.ndarray | None) -> np.ndarray:
    """Change of the whitened data per unit of every parameter and number of the alignment.

    Parameters
    ----------
    pattern : ndarray, shape (rows, columns), or None

    Returns
    -------
    ndarray, shape (data, numbers)
    """
    jacobian = problem.jacobian_at_start(pattern)
    columns = [
        whitened([rows[index] for rows in jacobian], problem.weights) / step for index, step in enumerate(problem.steps)
    ]
    return np.stack(columns, axis=1)


def with_knowledge(columns: np.ndarray, problem: Problem) -> np.ndarray:
    """Changes of the data, and below them what is known of the numbers.

    Each number's knowledge is a row of its own, so that it can only be taken up as far.

    Parameters
    ----------
    columns : ndarray, shape (data, numbers)

    Returns
    -------
    ndarray, shape (data + numbers, numbers)
    """
    return np.vstack([columns, np.diag(np.sqrt(problem.knowledge))])


def changes(problem: Problem, pattern: np.ndarray | None) -> np.ndarray:
    """`with_knowledge` of `data_changes`."""
    return with_knowledge(data_changes(problem, pattern), problem)


def projected(rows: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """Whitened data less all that an orthonormal basis spans.

    Parameters
    ----------
    rows : ndarray, shape (rows, data)
    basis : ndarray, shape (data + numbers, columns)

    Returns
    -------
    ndarray, shape (rows, data + numbers)
    """
    known = basis.shape[0] - rows.shape[1]
    rows = np.hstack([rows, np.zeros((len(rows), known))])
    return rows - (rows @ basis) @ basis.T


def varied(parameters: Sequence[Parameter]) -> tuple[Parameter, ...]:
    """Those that have a neutral value: each has a template of its own."""
    return tuple(parameter for parameter in parameters if parameter.neutral is not None)


def strength(parameter: Parameter) -> float:
    """What a template has of a parameter; where the typical case has none of it, its range says how much is much."""
    if parameter.typical != parameter.neutral:
        return parameter.typical
    far = max(parameter.low, parameter.high, key=lambda end: abs(end - parameter.neutral))
    return parameter.neutral + (far - parameter.neutral) / 20


def templates(fitter: Fitter, fit: Fit, name: str, shapes: Sequence[Mapping[str, float]] = ({},)) -> np.ndarray:
    """Change of the whitened data that an effect makes.

    By each parameter alone that has a neutral value, at typical strength; of an effect without such a parameter, its
    change at typical values. Of what moves rays it is the slope times that strength: alignment trades against it to one
    part in a hundred, and what rays beyond the reach of others are off by would pass for something of its own.

    Parameters
    ----------
    name : str
        Of the effect.
    shapes : sequence of mapping of str to float, optional
        Values of parameters without a neutral value, where they are not typical.

    Returns
    -------
    ndarray, shape (shapes * parameters, data)
        Parameters are in the order of `varied`, and change faster than shapes.
    """
    every = fitter.model.parameters(name)
    before = fitter.data.residuals(fitter.predicted(fit))
    ranges = {one.name: one for one in fitter.model.unknowns((name,))}
    typical = {
        parameter.name: one.value(min(max(parameter.number(parameter.typical), one.low), one.high))
        for parameter, one in ((parameter, ranges[parameter.name]) for parameter in every)
    }
    typical |= fitter.model.known(name)
    parameters = varied(every)
    off = {parameter.name: parameter.neutral for parameter in parameters}
    steps = [_step(name, parameter, ranges[parameter.name]) for parameter in parameters]
    rows = []
    for shape in shapes:
        for strong, times, reach in steps or [({}, 1.0, 1.0)]:
            values = typical | dict(shape) | off | strong
            linearisation = replace(fit.linearisation, reach=reach)
            changed = fitter.model.predict(fit.physics | {name: values}, fit.nuisance, fitter.data, linearisation)
            after = fitter.data.residuals(changed)
            rows.append(times * whitened([a - b for a, b in zip(before, after, strict=True)], fitter.weights))
    return np.stack(rows)


def _step(name: str, parameter: Parameter, unknown: Unknown) -> tuple[dict[str, float], float, float]:
    """Of a template: the parameter's value, how often the change it makes is taken, and the reach of its rays."""
    strong = strength(parameter)
    if not load(name).moves(parameter):
        return {parameter.name: strong}, 1.0, 1.0
    step = MOVING_STEPS[load(name).stage] * (unknown.high - unknown.low)  # what moves is its own number
    step = min(step, abs(strong - parameter.neutral)) * np.sign(strong - parameter.neutral)
    return {parameter.name: parameter.neutral + step}, float((strong - parameter.neutral) / step), SLOPE_REACH
