"""First-order distortions of effects: matched filters of what a fit leaves over.

A template is what an effect of typical strength changes of every part of the data, whitened by the weights, with all
that alignment and the effects already fitted could take up projected out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import stats

from ..physics.effect import load
from .fit import Fit, Fitter, Problem
from .model import stacked
from .pattern import estimate

SMALL = 1e-9  # of a template's square: what is left of one that the alignment takes up entirely


def whitened(parts: list[np.ndarray], weights: list[np.ndarray]) -> np.ndarray:
    return np.concatenate([part * np.sqrt(weight) for part, weight in zip(parts, weights, strict=True)])


def taken_up(fitter: Fitter, fit: Fit) -> np.ndarray:
    """Orthonormal basis (columns) of what alignment and fitted parameters change, whitened."""
    problem = Problem(fitter, fit.effects, fit)
    residuals = problem.residuals(problem.start, fit.pattern)
    columns = [
        whitened(problem.derivative(index, problem.start, residuals, fit.pattern), fitter.weights)
        for index in range(len(problem.start))
    ]
    # What is known of the alignment stands below as rows of their own, so that it can only be taken up as far.
    known = np.diag(np.sqrt(problem.knowledge))
    return np.linalg.qr(np.vstack([np.stack(columns, axis=1), known]))[0]


def templates(fitter: Fitter, fit: Fit, name: str) -> np.ndarray:
    """Change of the whitened data per unit of each parameter of an effect that has a neutral value, the others typical;
    of an effect without one, its change at typical values. Rows are parameters."""
    effect = load(name)
    now = fitter.model.predict(fit.physics, fit.place, fitter.data)
    before = stacked(fitter.data, now)
    ranges = {one.name: one for one in fitter.model.unknowns((name,))}
    typical = {
        parameter.name: min(max(parameter.typical, ranges[parameter.name].low), ranges[parameter.name].high)
        for parameter in effect.parameters
    }
    varied = [parameter for parameter in effect.parameters if parameter.neutral is not None]
    settings = [typical] if not varied else []
    for parameter in varied:
        strength = parameter.typical
        if strength == parameter.neutral:  # the typical case has none of it: its range says how much is much
            strength = parameter.neutral + (parameter.high - parameter.neutral) / 20
        off = {other.name: other.neutral for other in varied}
        settings.append(typical | off | {parameter.name: strength})
    rows = []
    for values in settings:
        after = stacked(fitter.data, fitter.model.predict(fit.physics | {name: values}, fit.place, fitter.data))
        rows.append(whitened([a - b for a, b in zip(before, after, strict=True)], fitter.weights))
    return np.stack(rows)


def screened(fitter: Fitter, fit: Fit, names: Sequence[str]) -> dict[str, float]:
    """p-value of every effect's matched filter on what a fit leaves over of the data that were fitted."""
    parts = fitter.residuals(fit, held_out=False)
    basis = taken_up(fitter, fit)
    known = basis.shape[0] - sum(part.size for part in parts)
    residual = np.concatenate([whitened(parts, fitter.weights), np.zeros(known)])
    residual = residual - basis @ (basis.T @ residual)
    found = {}
    for name in names:
        if load(name).pattern:
            shape = fitter.data.mean.shape
            pattern = estimate(parts[0].reshape(shape), fitter.weights[0].reshape(shape))
            found[name] = float(stats.norm.sf(pattern.rms / pattern.error)) if pattern.rms else 1.0
            continue
        rows = templates(fitter, fit, name)
        rows = np.hstack([rows, np.zeros((len(rows), known))])
        size = (rows**2).sum(axis=1)
        rows = rows - (rows @ basis) @ basis.T
        rows = rows[(rows**2).sum(axis=1) > SMALL * np.maximum(size, 1e-300)]
        if not len(rows):
            found[name] = 1.0
            continue
        gain = residual @ rows.T @ np.linalg.pinv(rows @ rows.T, hermitian=True) @ rows @ residual
        found[name] = float(stats.chi2.sf(gain, len(rows)))
    return found
