"""What a recording can tell apart: where effects show, how much of them alignment takes up, and how alike they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.cluster import hierarchy
from scipy.optimize import lsq_linear
from scipy.spatial.distance import squareform

from ...physics.effect import load
from ..fitting.fit import Fit, Fitter, Problem
from ..fitting.templates import SMALL, changes, projected, templates, varied, whitened


@dataclass(frozen=True)
class Template:
    """First-order change that one parameter of an effect makes at typical strength.

    Attributes
    ----------
    parameter : str or None
        None where the effect has no parameter with a neutral value.
    whole : ndarray, shape (data,)
        Whitened, so that its length counts standard deviations.
    left : ndarray, shape (data + numbers,)
        The same less all that the fit takes up to first order; each number's piece of knowledge stands below the data.
    """

    effect: str
    parameter: str | None
    whole: np.ndarray
    left: np.ndarray

    @property
    def taken_up(self) -> float:
        """Share of the squared length that is taken up; NaN of an effect that changes nothing."""
        square = float(self.whole @ self.whole)
        return 1 - float(self.left @ self.left) / square if square else float("nan")


def described(fitter: Fitter, fit: Fit, names: Sequence[str]) -> list[Template]:
    """The templates of effects beside a fit.

    A gain pattern has that of one draw: it is fitted pixel by pixel.

    Parameters
    ----------
    names : sequence of str
        Of effects.
    """
    basis, found = np.linalg.qr(changes(Problem(fitter, fit.effects, fit), fit.pattern))[0], []
    for name in names:
        if load(name).pattern:
            labels, rows = [None], _drawn(fitter, fit, name)[None]
        else:
            labels = [one.name for one in varied(fitter.model.parameters(name))] or [None]
            rows = templates(fitter, fit, name)
        left = projected(rows, basis)
        found += [Template(name, *one) for one in zip(labels, rows, left, strict=True)]
    return found


def _drawn(fitter: Fitter, fit: Fit, name: str) -> np.ndarray:
    """What a gain pattern of typical strength changes: predictions have none, so that it is asked of the chain."""
    effect, data = load(name), fitter.data
    photons = float(np.exp(fit.nuisance["log_photons"]))
    without, with_it = (
        fitter.model.chain.state(physics, photons=photons, anode=fitter.model.anode).line_integrals()
        for physics in (fit.physics, fit.physics | {name: effect.values({})})
    )
    mean = data.whitened(np.where(data.usable, with_it - without, 0)).ravel()
    rest = data.residuals(fitter.predicted(fit))[1:]
    return whitened([mean, *(np.zeros_like(part) for part in rest)], fitter.weights)


def split(fitter: Fitter, row: np.ndarray) -> dict[str, np.ndarray]:
    """A whitened row by the parts of the data that are there.

    Parameters
    ----------
    row : ndarray, shape (data or more,)
        What stands below the data is left out.
    """
    names = fitter.data.parts
    ends = np.cumsum([weight.size for weight in fitter.weights])
    return {name: row[end - w.size : end] for name, end, w in zip(names, ends, fitter.weights, strict=True)}


def shares(fitter: Fitter, row: np.ndarray) -> dict[str, float]:
    """Share of a whitened row's squared length that lies in every part of the data.

    Parameters
    ----------
    row : ndarray
        As for `split`.

    Returns
    -------
    dict of str to float
        NaN for a row of length 0.
    """
    squares = {name: float(part @ part) for name, part in split(fitter, row).items()}
    total = sum(squares.values())
    return {name: square / total if total else float("nan") for name, square in squares.items()}


def taken_up_in_range(fitter: Fitter, fit: Fit, rows: np.ndarray) -> np.ndarray:
    """Share of rows' squared lengths that a fit takes up within its plausible ranges.

    Least squares with bounds: unlike a first-order projection this depends on the strength of what is taken up.

    Parameters
    ----------
    rows : ndarray, shape (rows, data)
        Whitened.

    Returns
    -------
    ndarray, shape (rows,)
    """
    problem = Problem(fitter, fit.effects, fit)
    basis, triangle = np.linalg.qr(changes(problem, fit.pattern))
    scale = np.linalg.norm(triangle, axis=0)
    bounds = (problem.low - problem.start) * scale, (problem.high - problem.start) * scale
    found = []
    for row in rows:
        inside = basis[: row.size].T @ row
        solved = lsq_linear(triangle / scale, inside, bounds, method="bvls")
        found.append((inside @ inside - 2 * solved.cost) / (row @ row))
    return np.array(found)


def correlations(found: Sequence[Template]) -> np.ndarray:
    """Cosines between what is left of templates.

    Returns
    -------
    ndarray, shape (templates, templates)
        NaN where all of one is taken up.
    """
    rows = np.stack([one.left for one in found])
    squares = (rows**2).sum(axis=1)
    whole = np.array([one.whole @ one.whole for one in found])
    length = np.sqrt(np.where(squares > SMALL * whole, squares, np.nan))
    return rows @ rows.T / np.outer(length, length)


def grouped(correlation: np.ndarray) -> list[int]:
    """Order of templates in which those alike stand together: average linkage of 1 - |correlation|.

    Parameters
    ----------
    correlation : ndarray, shape (templates, templates)
        From `correlations`.
    """
    distance = 1 - np.abs(np.nan_to_num(correlation))
    np.fill_diagonal(distance, 0)
    near = squareform((distance + distance.T) / 2, checks=False)
    return hierarchy.leaves_list(hierarchy.linkage(near, "average", optimal_ordering=True)).tolist()
