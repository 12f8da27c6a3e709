"""Matched filters of what a fit leaves over: what every effect would gain beside it, to first order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy import stats
from scipy.optimize import lsq_linear

from ...physics.effect import Parameter, load
from ..fitting.fit import Fit, Fitter, Problem
from ..fitting.templates import SMALL, data_changes, projected, strength, templates, varied, whitened, with_knowledge
from ..noise.gain_pattern import chance, estimate
from ..uncertainty.model_error import distortions_of_physics
from .processes import side_by_side
from .progress import RANKED, DiagnosisProgress

SIZES = (1 / 3, 3.0)  # by which a fit may change an effect without a neutral value from where it begins
ALIKE = 1e-4  # of a template's length: by how much path lengths in single precision let two differ that are alike


@dataclass(frozen=True)
class Screened:
    """An effect's matched filter on what a fit leaves over.

    Attributes
    ----------
    p : float
        Chance of such a gain without the effect, over all shapes that were tried.
    gain : float
        Of chi-square and of what is known of the fit's numbers, to first order.
    blind : bool
        Its template is nothing, so that only a fit can tell: slices of typical thickness that lie as far apart.
    beside_errors : Screened or None
        The same if models of declared physics (and of effects fitted, where `screened` was asked) are as inexact as
        they are trusted to be; None: there are none.
    """

    p: float
    gain: float
    blind: bool = False
    beside_errors: Screened | None = None

    @property
    def sure(self) -> Screened:
        """What errors of models cannot make up."""
        return self if self.beside_errors is None else self.beside_errors


@dataclass(frozen=True)
class Remainder:
    """What a fit leaves over of the data that were fitted, whitened, with what is known of its numbers below.

    Attributes
    ----------
    basis : ndarray, shape (data + numbers, directions)
        Orthonormal: what the fit's numbers can take up, and errors of models if they are counted among these.
    residual : ndarray, shape (data + numbers,)
        Without that.
    inward : ndarray, shape (bounds, data + numbers)
        What numbers change that the data press against their bounds, back into their range, without that: an effect may
        relieve them, but by themselves they take up nothing more.
    """

    basis: np.ndarray
    residual: np.ndarray
    inward: np.ndarray

    @classmethod
    def of(
        cls, problem: Problem, columns: np.ndarray, residual: np.ndarray, errors: np.ndarray | None = None
    ) -> Remainder:
        """From changes and residuals of the whitened data.

        Parameters
        ----------
        columns : ndarray, shape (data, numbers)
            From `data_changes`.
        residual : ndarray, shape (data,)
            Of the fit.
        errors : ndarray, shape (data, errors), optional
            Changes of the whitened data that errors of models may make, one standard deviation each.
        """
        columns = with_knowledge(columns, problem)
        known = np.sqrt(problem.knowledge) * (problem.centre - problem.start)
        residual = np.concatenate([residual, known])
        outward = columns.T @ residual
        low, high = problem.start <= problem.low, problem.start >= problem.high
        at_bound = (low & (outward < 0)) | (high & (outward > 0))
        if errors is not None:
            count = errors.shape[1]
            errors = np.vstack([errors, np.zeros((len(known), count)), np.eye(count)])
            columns = np.hstack([np.pad(columns, ((0, count), (0, 0))), errors])
            residual = np.pad(residual, (0, count))
            low, high, at_bound = (np.pad(one, (0, count)) for one in (low, high, at_bound))
        basis = np.linalg.qr(columns[:, ~at_bound])[0]
        inward = (columns * np.where(low, 1, -1))[:, at_bound].T
        return cls(basis, residual - basis @ (basis.T @ residual), inward - (inward @ basis) @ basis.T)

    def gain(self, rows: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
        """What templates gain at best.

        Parameters
        ----------
        rows : ndarray, shape (templates, data + numbers)
            Without what the fit takes up.
        low, high : ndarray, shape (templates,)
            Least and most amounts.
        """
        none, any_ = np.zeros(len(self.inward)), np.full(len(self.inward), np.inf)
        return explained(
            np.vstack([rows, self.inward]), self.residual, np.concatenate([low, none]), np.concatenate([high, any_])
        )


def screened(
    fitter: Fitter,
    fit: Fit,
    names: Sequence[str],
    processes: int = 1,
    how_far: DiagnosisProgress | None = None,
    accuracy: Mapping[str, float] | None = None,
    fitted_too: bool = False,
) -> dict[str, Screened]:
    """Every effect's matched filter on what a fit leaves over of the data that were fitted.

    It has the shape that serves it best of those that fits begin with.

    Parameters
    ----------
    names : sequence of str
        Of effects.
    processes : int, optional
        That work side by side, at most.
    how_far : DiagnosisProgress, optional
        What is told of every effect that is done.
    accuracy : mapping of str to float, optional
        As `attribute.choose` takes it: of models of declared physics. None: they are not asked about.
    fitted_too : bool, optional
        Models of the fit's effects may be as inexact.

    Raises
    ------
    InputError
        As `side_by_side`.
    """
    parts = fitter.residuals(fit, held_out=False)
    columns = data_changes(Problem(fitter, fit.effects, fit), fit.pattern)
    # Beside a spectrum other things are known of the alignment.
    problems = {name: Problem(fitter, fit.effects, fit, beside=name) for name in names}
    residual = whitened(parts, fitter.weights)
    inexact = [*fitter.model.declared, *(fit.effects if fitted_too else ())]
    errors = distortions_of_physics(fitter, fit, columns, accuracy, inexact) if accuracy and inexact else None
    remainders: dict[tuple, list[Remainder]] = {}
    for problem in problems.values():
        if problem.aligned not in remainders:
            remainders[problem.aligned] = [Remainder.of(problem, columns, residual)]
            if errors is not None:
                remainders[problem.aligned].append(Remainder.of(problem, columns, residual, errors))

    def one(name: str) -> Screened:
        left = remainders[problems[name].aligned]
        if load(name).pattern:
            found = [_pattern(fitter, parts[0]), *(_pattern(fitter, _of_mean(fitter, other)) for other in left[1:])]
        else:
            tried = shapes(fitter, name)
            rows, parameters = templates(fitter, fit, name, tried), fitter.model.parameters(name)
            found = [_best(parameters, rows, len(tried), other) for other in left]
        return found[0] if errors is None else replace(found[0], beside_errors=found[1])

    done = None if how_far is None else how_far.begin(RANKED, len(names), fit.effects)
    return dict(zip(names, side_by_side(one, [(name,) for name in names], processes, done), strict=True))


def shapes(fitter: Fitter, name: str) -> list[dict[str, float]]:
    """Where fits of an effect may begin, of its parameters without a neutral value: all combinations."""
    unknowns = [one for one in fitter.model.unknowns((name,)) if one.neutral is None]
    return [
        {one.name: one.value(number) for one, number in zip(unknowns, values, strict=True)}
        for values in product(*(one.starts for one in unknowns))
    ]


def _of_mean(fitter: Fitter, left: Remainder) -> np.ndarray:
    """What is left over of the mean, not in standard deviations, shape (data,)."""
    weight = fitter.weights[0]
    return left.residual[: weight.size] / np.sqrt(np.where(weight > 0, weight, np.inf))


def _pattern(fitter: Fitter, residual: np.ndarray) -> Screened:
    """Of a gain pattern, which is estimated at once from what is left over of the mean."""
    shape = fitter.data.mean.shape
    mean, weight = residual.reshape(shape), fitter.weights[0].reshape(shape)
    pattern = estimate(mean, weight, fitter.data.whitening)
    found = fitter.data.whitened(np.where(fitter.data.usable, pattern.values, 0))
    gain = float((weight * (2 * mean - found) * found).sum())
    return Screened(chance(pattern.rms, pattern.error), gain)


def _best(parameters: Sequence[Parameter], rows: np.ndarray, count: int, left: Remainder) -> Screened:
    """Of an effect, with the best of its shapes.

    Parameters
    ----------
    rows : ndarray, shape (shapes * parameters, data)
        Templates.
    count : int
        Of shapes.
    """
    low, high = amounts(parameters)
    lengths = (rows**2).sum(axis=1).reshape(count, -1)
    rows = projected(rows, left.basis).reshape(count, len(low), -1)
    found = Screened(1.0, 0.0, blind=not lengths.any())
    for one, length in zip(rows, lengths, strict=True):
        seen = (one**2).sum(axis=1) > SMALL * np.maximum(length, 1e-300)
        if seen.any():
            gain = left.gain(one[seen], low[seen], high[seen])
            p = min(1.0, float(stats.chi2.sf(gain, int(seen.sum()))) * count)
            found = max(found, Screened(p, gain), key=lambda tried: tried.gain)
    return found


def amounts(parameters: Sequence[Parameter]) -> tuple[np.ndarray, np.ndarray]:
    """The least and the most that an effect's range allows of each of its templates.

    Returns
    -------
    low, high : ndarray, shape (templates,)
    """
    parameters = varied(parameters)
    if not parameters:  # it cannot be faint
        return np.array([SIZES[0]]), np.array([SIZES[1]])
    ends = [
        sorted((one.number(end) - none) / (one.number(strength(one)) - none) for end in (one.low, one.high))
        for one, none in ((one, one.number(one.neutral)) for one in parameters)
    ]
    return tuple(np.array(ends).T)


def explained(rows: np.ndarray, residual: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """By how much templates can lower a residual's square.

    Parameters
    ----------
    rows : ndarray, shape (templates, data)
    residual : ndarray, shape (data,)
    low, high : ndarray, shape (templates,)
        Least and most amounts.

    Returns
    -------
    float
        At least 0.
    """
    lengths = np.sqrt((rows**2).sum(axis=1))
    rows, low, high = rows[lengths > 0], low[lengths > 0], high[lengths > 0]
    lengths = lengths[lengths > 0]
    basis, triangle = np.linalg.qr((rows / lengths[:, None]).T)
    inside = basis.T @ residual
    # Without a price on amounts, the difference of two templates that are alike would count as a third.
    matrix = np.vstack([triangle, ALIKE * np.eye(len(rows))])
    target = np.concatenate([inside, np.zeros(len(rows))])
    solved = lsq_linear(matrix, target, (low * lengths, high * lengths), method="bvls")
    return max(0.0, float(inside @ inside - 2 * solved.cost))
