"""First-order distortions of effects: matched filters of what a fit leaves over.

A template is what an effect of typical strength changes of every part of the data, whitened by the weights, with all
that alignment and the effects already fitted could take up projected out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy import stats
from scipy.optimize import lsq_linear

from ..physics.effect import Parameter, load
from .fit import Fit, Fitter, Problem
from .model import stacked
from .pattern import estimate

SIZES = (1 / 3, 3.0)  # by which a fit may change an effect without a neutral value from the best of its starts
SMALL = 1e-9  # of a template's square: what is left of one that the alignment takes up entirely


def whitened(parts: list[np.ndarray], weights: list[np.ndarray]) -> np.ndarray:
    return np.concatenate([part * np.sqrt(weight) for part, weight in zip(parts, weights, strict=True)])


def changes(problem: Problem, pattern: np.ndarray | None) -> np.ndarray:
    """Change of the whitened data per unit of every parameter and number of the alignment: [row, unknown].

    What is known of the unknowns stands below the data as rows of their own, so that each can only be taken up as far.
    """
    residuals = problem.residuals(problem.start, pattern)
    columns = [
        whitened(problem.derivative(index, problem.start, residuals, pattern), problem.weights)
        for index in range(len(problem.start))
    ]
    return np.vstack([np.stack(columns, axis=1), np.diag(np.sqrt(problem.knowledge))])


def taken_up(fitter: Fitter, fit: Fit) -> np.ndarray:
    """Orthonormal basis (columns) of what alignment and fitted parameters change, whitened."""
    return np.linalg.qr(changes(Problem(fitter, fit.effects, fit), fit.pattern))[0]


def left_over(fitter: Fitter, fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    """What a fit leaves over of the data that were fitted, whitened, and below them of what is known of its numbers;
    and the basis of what these can still take up.

    A number that the data press against its bound takes up nothing there. One that they have pulled away from what is
    known of it is a difference too, which an effect may relieve.
    """
    problem = Problem(fitter, fit.effects, fit)
    columns = changes(problem, fit.pattern)
    parts = fitter.residuals(fit, held_out=False)
    known = np.sqrt(problem.knowledge) * (problem.centre - problem.start)
    residual = np.concatenate([whitened(parts, fitter.weights), known])
    pull = columns.T @ residual
    held = ((problem.start <= problem.low) & (pull < 0)) | ((problem.start >= problem.high) & (pull > 0))
    return residual, np.linalg.qr(columns[:, ~held])[0]


def projected(rows: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """Whitened data [row, datum] less all that a basis of `taken_up` takes up: [row, datum and piece of knowledge]."""
    known = basis.shape[0] - rows.shape[1]
    rows = np.hstack([rows, np.zeros((len(rows), known))])
    return rows - (rows @ basis) @ basis.T


def varied(name: str) -> tuple[Parameter, ...]:
    """The parameters of an effect that have a neutral value: each has a template of its own."""
    return tuple(parameter for parameter in load(name).parameters if parameter.neutral is not None)


def strength(parameter: Parameter) -> float:
    """What a template has of a parameter; where the typical case has none of it, its range says how much is much."""
    if parameter.typical != parameter.neutral:
        return parameter.typical
    return parameter.neutral + (parameter.high - parameter.neutral) / 20


def templates(fitter: Fitter, fit: Fit, name: str, shape: Mapping[str, float] | None = None) -> np.ndarray:
    """Change of the whitened data that an effect makes by each parameter alone that has a neutral value, at typical
    strength; of an effect without such a parameter, its change at typical values. Rows are as `varied` names them.

    shape   values of parameters without a neutral value, where they are not typical
    """
    effect = load(name)
    now = fitter.model.predict(fit.physics, fit.place, fitter.data)
    before = stacked(fitter.data, now)
    ranges = {one.name: one for one in fitter.model.unknowns((name,))}
    typical = {
        parameter.name: min(max(parameter.typical, ranges[parameter.name].low), ranges[parameter.name].high)
        for parameter in effect.parameters
    } | dict(shape or {})
    parameters = varied(name)
    settings = [typical] if not parameters else []
    for parameter in parameters:
        off = {other.name: other.neutral for other in parameters}
        settings.append(typical | off | {parameter.name: strength(parameter)})
    rows = []
    for values in settings:
        after = stacked(fitter.data, fitter.model.predict(fit.physics | {name: values}, fit.place, fitter.data))
        rows.append(whitened([a - b for a, b in zip(before, after, strict=True)], fitter.weights))
    return np.stack(rows)


@dataclass(frozen=True)
class Screened:
    """An effect's matched filter on what a fit leaves over: its p-value, and what chi-square gains to first order."""

    p: float
    gain: float


def shapes(fitter: Fitter, name: str) -> list[dict[str, float]]:
    """Where fits of an effect may begin, of its parameters without a neutral value: all combinations."""
    unknowns = [one for one in fitter.model.unknowns((name,)) if one.neutral is None]
    return [
        {one.name: value for one, value in zip(unknowns, values, strict=True)}
        for values in product(*(one.starts for one in unknowns))
    ]


def whole_changes(fitter: Fitter, fit: Fit, name: str) -> np.ndarray:
    """Change of the whitened data by an effect without a neutral value, [start, datum], at all starts of a fit."""
    before = stacked(fitter.data, fitter.model.predict(fit.physics, fit.place, fitter.data))
    rows = []
    for setting in shapes(fitter, name):
        after = stacked(fitter.data, fitter.model.predict(fit.physics | {name: setting}, fit.place, fitter.data))
        rows.append(whitened([a - b for a, b in zip(before, after, strict=True)], fitter.weights))
    return np.stack(rows)


def _whole(rows: np.ndarray, residual: np.ndarray) -> Screened:
    """Matched filter of an effect that cannot be faint: at the best of its starts, made SIZES times as large."""
    square, along = (rows**2).sum(axis=1), rows @ residual
    size = np.clip(along / np.maximum(square, 1e-300), *SIZES)
    gain = float((2 * size * along - size**2 * square).max(initial=0.0))
    return Screened(float(stats.chi2.sf(gain, 1)), gain)


def screened(fitter: Fitter, fit: Fit, names: Sequence[str]) -> dict[str, Screened]:
    """Every effect's matched filter on what a fit leaves over of the data that were fitted, with the shape that serves
    it best of those that fits begin with."""
    parts = fitter.residuals(fit, held_out=False)
    residual, basis = left_over(fitter, fit)
    residual = residual - basis @ (basis.T @ residual)
    found = {}
    for name in names:
        if load(name).pattern:
            shape = fitter.data.mean.shape
            mean, weight = parts[0].reshape(shape), fitter.weights[0].reshape(shape)
            pattern = estimate(mean, weight)
            gain = float((weight * (2 * mean - pattern.values) * pattern.values).sum())
            found[name] = Screened(float(stats.norm.sf(pattern.rms / pattern.error)) if pattern.rms else 1.0, gain)
            continue
        if not varied(name):
            found[name] = _whole(projected(whole_changes(fitter, fit, name), basis), residual)
            continue
        one_sided = np.array([parameter.neutral in (parameter.low, parameter.high) for parameter in varied(name)])
        tried = []
        for shape in shapes(fitter, name):
            rows = templates(fitter, fit, name, shape)
            size = (rows**2).sum(axis=1)
            rows = projected(rows, basis)
            seen = (rows**2).sum(axis=1) > SMALL * np.maximum(size, 1e-300)
            if seen.any():
                gain = explained(rows[seen], residual, one_sided[seen])
                tried.append(Screened(float(stats.chi2.sf(gain, int(seen.sum()))), gain))
        found[name] = max(tried, key=lambda one: one.gain, default=Screened(1.0, 0.0))
    return found


def explained(rows: np.ndarray, residual: np.ndarray, one_sided: np.ndarray) -> float:
    """How much of a residual's square templates [row, datum] explain at best.

    one_sided   bool (row,): templates of which there cannot be less than nothing
    """
    unit = rows / np.sqrt((rows**2).sum(axis=1, keepdims=True))
    basis, triangle = np.linalg.qr(unit.T)
    inside = basis.T @ residual
    solved = lsq_linear(triangle, inside, (np.where(one_sided, 0, -np.inf), np.inf))
    return max(0.0, float(inside @ inside - 2 * solved.cost))
