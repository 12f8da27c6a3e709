"""Matched filters of what a fit leaves over: what every effect would gain beside it, to first order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy import stats
from scipy.optimize import lsq_linear

from ..physics.effect import load
from .fit import Fit, Fitter, Problem
from .pattern import estimate
from .templates import SMALL, changes, projected, templates, varied, whitened

SIZES = (1 / 3, 3.0)  # by which a fit may change an effect without a neutral value from the best of its starts


@dataclass(frozen=True)
class Screened:
    """An effect's matched filter on what a fit leaves over: its p-value, and what chi-square gains to first order."""

    p: float
    gain: float


def screened(fitter: Fitter, fit: Fit, names: Sequence[str]) -> dict[str, Screened]:
    """Every effect's matched filter on what a fit leaves over of the data that were fitted, with the shape that serves
    it best of those that fits begin with."""
    parts = fitter.residuals(fit, held_out=False)
    residual, basis = left_over(fitter, fit, parts)
    found = {}
    for name in names:
        if load(name).pattern:
            found[name] = _pattern(fitter, parts)
            continue
        found[name] = Screened(1.0, 0.0)
        for shape in shapes(fitter, name):
            rows = templates(fitter, fit, name, shape)
            tried = _faint(name, rows, residual, basis) if varied(name) else _whole(rows, residual, basis)
            found[name] = max(found[name], tried, key=lambda one: one.gain)
    return found


def left_over(fitter: Fitter, fit: Fit, parts: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """What a fit leaves over of the data that were fitted, whitened, and below them of what is known of its numbers;
    and the basis of what these can still take up, with that taken out.

    parts   residuals of the data that were fitted
    A number that the data press against its bound takes up nothing there. One that they have pulled away from what is
    known of it is a difference too, which an effect may relieve.
    """
    problem = Problem(fitter, fit.effects, fit)
    columns = changes(problem, fit.pattern)
    known = np.sqrt(problem.knowledge) * (problem.centre - problem.start)
    residual = np.concatenate([whitened(parts, fitter.weights), known])
    pull = columns.T @ residual
    held = ((problem.start <= problem.low) & (pull < 0)) | ((problem.start >= problem.high) & (pull > 0))
    basis = np.linalg.qr(columns[:, ~held])[0]
    return residual - basis @ (basis.T @ residual), basis


def shapes(fitter: Fitter, name: str) -> list[dict[str, float]]:
    """Where fits of an effect may begin, of its parameters without a neutral value: all combinations."""
    unknowns = [one for one in fitter.model.unknowns((name,)) if one.neutral is None]
    return [
        {one.name: value for one, value in zip(unknowns, values, strict=True)}
        for values in product(*(one.starts for one in unknowns))
    ]


def _pattern(fitter: Fitter, parts: list[np.ndarray]) -> Screened:
    """Of a gain pattern, which is estimated at once."""
    shape = fitter.data.mean.shape
    mean, weight = parts[0].reshape(shape), fitter.weights[0].reshape(shape)
    pattern = estimate(mean, weight)
    gain = float((weight * (2 * mean - pattern.values) * pattern.values).sum())
    return Screened(float(stats.norm.sf(pattern.rms / pattern.error)) if pattern.rms else 1.0, gain)


def _whole(rows: np.ndarray, residual: np.ndarray, basis: np.ndarray) -> Screened:
    """Of an effect that cannot be faint: as large as it is at a start, or SIZES times that."""
    (row,) = projected(rows, basis)
    square, along = float(row @ row), float(row @ residual)
    size = float(np.clip(along / max(square, 1e-300), *SIZES))
    gain = max(0.0, 2 * size * along - size**2 * square)
    return Screened(float(stats.chi2.sf(gain, 1)), gain)


def _faint(name: str, rows: np.ndarray, residual: np.ndarray, basis: np.ndarray) -> Screened:
    """Of an effect whose parameters can have any size, as templates of `varied`."""
    size = (rows**2).sum(axis=1)
    rows = projected(rows, basis)
    seen = (rows**2).sum(axis=1) > SMALL * np.maximum(size, 1e-300)
    if not seen.any():
        return Screened(1.0, 0.0)
    one_sided = np.array([parameter.neutral in (parameter.low, parameter.high) for parameter in varied(name)])
    gain = explained(rows[seen], residual, one_sided[seen])
    return Screened(float(stats.chi2.sf(gain, int(seen.sum()))), gain)


def explained(rows: np.ndarray, residual: np.ndarray, one_sided: np.ndarray) -> float:
    """How much of a residual's square templates [row, datum] explain at best.

    one_sided   bool (row,): templates of which there cannot be less than nothing
    """
    unit = rows / np.sqrt((rows**2).sum(axis=1, keepdims=True))
    basis, triangle = np.linalg.qr(unit.T)
    inside = basis.T @ residual
    solved = lsq_linear(triangle, inside, (np.where(one_sided, 0, -np.inf), np.inf))
    return max(0.0, float(inside @ inside - 2 * solved.cost))
