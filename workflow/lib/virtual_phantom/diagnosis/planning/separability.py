"""Predict how well a recording distinguishes effects.

For each effect: which data change, the part of the change that nuisance parameters absorb, and the similarity of the
remaining part with other effects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.cluster import hierarchy
from scipy.optimize import lsq_linear
from scipy.spatial.distance import squareform

from ...physics.effect import load
from ..fitting.fit import Fit, Fitter
from ..fitting.problem import Problem
from ..fitting.templates import SMALL, data_changes, projected, templates, varied, whitened, with_priors


@dataclass(frozen=True)
class Template:
    """First-order change that one parameter of an effect makes at typical strength.

    Attributes
    ----------
    parameter : str or None
        None if the effect has no parameter with a neutral value.
    change : ndarray, shape (data,)
        Change of the whitened data; its length is in standard deviations.
    left : ndarray, shape (data + parameters,)
        Part of the change that the fit does not absorb to first order. After the data, there is one entry per prior.
    """

    effect: str
    parameter: str | None
    change: np.ndarray
    left: np.ndarray

    @property
    def absorbed(self) -> float:
        """Absorbed share of the squared length; NaN for an effect without a change."""
        square = float(self.change @ self.change)
        return 1 - float(self.left @ self.left) / square if square else float("nan")


def templates_of_effects(fitter: Fitter, fit: Fit, names: Sequence[str]) -> list[Template]:
    """Return the templates of effects at a fit; a gain pattern has the template of one random realization."""
    problem, found = Problem.at(fitter, fit), []
    basis = np.linalg.qr(with_priors(data_changes(problem), problem))[0]
    for name in names:
        if load(name).pattern:
            labels, rows = [None], _gain_pattern_template(fitter, fit, name)[None]
        else:
            labels = [parameter.name for parameter in varied(fitter.model.parameters(name))] or [None]
            rows = templates(fitter, fit, name)
        left = projected(rows, basis)
        found += [Template(name, *row) for row in zip(labels, rows, left, strict=True)]
    return found


def _gain_pattern_template(fitter: Fitter, fit: Fit, name: str) -> np.ndarray:
    """Return the template of a gain pattern of typical strength, computed by the chain: predictions have no pattern."""
    effect, data = load(name), fitter.data
    photons = float(np.exp(fit.nuisance["log_photons"]))
    without, with_it = (
        fitter.model.chain.state(physics, photons=photons, anode=fitter.model.anode).line_integrals()
        for physics in (fit.physics, fit.physics | {name: effect.values({})})
    )
    mean = data.whitened(with_it - without).ravel()
    rest = data.residuals(fitter.predicted(fit))[1:]
    return whitened([mean, *(np.zeros_like(part) for part in rest)], fitter.weights)


def split(fitter: Fitter, row: np.ndarray) -> dict[str, np.ndarray]:
    """Split a whitened row by the parts of the data, without the entries for priors."""
    names = fitter.data.parts
    ends = np.cumsum([weight.size for weight in fitter.weights])
    return {name: row[end - w.size : end] for name, end, w in zip(names, ends, fitter.weights, strict=True)}


def shares(fitter: Fitter, row: np.ndarray) -> dict[str, float]:
    """Return the share of a whitened row's squared length in every part of the data; NaN for a row of length 0."""
    squares = {name: float(part @ part) for name, part in split(fitter, row).items()}
    total = sum(squares.values())
    return {name: square / total if total else float("nan") for name, square in squares.items()}


def absorbed_in_range(fitter: Fitter, fit: Fit, rows: np.ndarray) -> np.ndarray:
    """Return the share of rows' squared lengths that a fit absorbs within its plausible ranges, shape (rows,).

    This is a bounded least-squares fit. Unlike a first-order projection, it depends on the strength of the effect.

    Parameters
    ----------
    rows : ndarray, shape (rows, data)
        Whitened.
    """
    problem = Problem.at(fitter, fit)
    basis, triangle = np.linalg.qr(with_priors(data_changes(problem), problem))
    scale = np.linalg.norm(triangle, axis=0)
    bounds = (problem.low - problem.start) * scale, (problem.high - problem.start) * scale
    found = []
    for row in rows:
        inside = basis[: row.size].T @ row
        solved = lsq_linear(triangle / scale, inside, bounds, method="bvls")
        found.append((inside @ inside - 2 * solved.cost) / (row @ row))
    return np.array(found)


def correlations(found: Sequence[Template]) -> np.ndarray:
    """Return cosines between the remaining parts of templates, shape (templates, templates).

    NaN for a template that is fully absorbed.
    """
    rows = np.stack([template.left for template in found])
    squares = (rows**2).sum(axis=1)
    whole = np.array([template.change @ template.change for template in found])
    length = np.sqrt(np.where(squares > SMALL * whole, squares, np.nan))
    return rows @ rows.T / np.outer(length, length)


def grouped(correlation: np.ndarray) -> list[int]:
    """Return an order of templates with similar ones adjacent: average linkage of 1 - |correlation|."""
    distance = 1 - np.abs(np.nan_to_num(correlation))
    np.fill_diagonal(distance, 0)
    near = squareform((distance + distance.T) / 2, checks=False)
    return hierarchy.leaves_list(hierarchy.linkage(near, "average", optimal_ordering=True)).tolist()
