"""Matched filters of a fit's residuals: the first-order gain of every effect that could be added to the fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy import stats
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear

from ...physics.effect import Parameter, load
from ..fitting.fit import Fit, Fitter
from ..fitting.problem import Problem
from ..fitting.templates import SMALL, data_changes, projected, strength, templates, varied, with_priors
from ..uncertainty.model_error import distortions_of_physics
from .processes import run_parallel
from .progress import RANKED, DiagnosisProgress

SIZES = (1 / 3, 3.0)  # factors by which a fit may change an effect without a neutral value from its start
ALIKE = 1e-4  # relative difference of two equal templates, from path lengths in single precision
SCREEN = 0.01  # significance level over all candidates below which an effect is fitted beside the selected ones
# Candidates that are fitted, by their filters' gain: the first FEW, and all with at least NEAR_BEST of the best gain.
# They must have at least LEAST_SHARE of the best gain, or of the gain of the effect that they replace.
FEW, LEAST_SHARE, NEAR_BEST = 6, 0.1, 0.5
# Share of its gain that an unconfounded effect must keep if model errors are fitted, too. In two scans of the blind
# validation (seed 16), row offsets kept 0.99 and 1.02, and a drift that was not there 0.24.
KEPT_BESIDE_MODEL_ERROR = 0.5


@dataclass(frozen=True)
class Screened:
    """Result of an effect's matched filter.

    Attributes
    ----------
    p : float
        p-value of the gain, over all shapes that were tried.
    gain : float
        First-order decrease of chi-square, priors included.
    blind : bool
        The template is zero, so only a full fit can detect the effect. An example is a typical slice thickness that
        equals the slice spacing.
    with_model_error : Screened or None
        Result if the models of declared physics are inexact, with `fitted_too` also models of fitted effects; None: no
        model errors were considered.
    """

    p: float
    gain: float
    blind: bool = False
    with_model_error: Screened | None = None

    @property
    def beside_model_error(self) -> Screened:
        """Result for the part of the residual that model errors cannot explain."""
        return self if self.with_model_error is None else self.with_model_error


@dataclass(frozen=True)
class Remainder:
    """Whitened residuals of the fitted data, followed by the residuals of the priors.

    Attributes
    ----------
    basis : ndarray, shape (data + numbers, directions)
        Orthonormal basis of what the fit's numbers can absorb, and model errors if they are counted.
    residual : ndarray, shape (data + numbers,)
        Orthogonal to `basis`.
    inward : ndarray, shape (bounds, data + numbers)
        Changes by numbers at a bound, toward the inside of their range, orthogonal to `basis`. The fit uses these
        changes only together with a further effect.
    """

    basis: np.ndarray
    residual: np.ndarray
    inward: np.ndarray

    @classmethod
    def of(
        cls, problem: Problem, columns: np.ndarray, residual: np.ndarray, errors: np.ndarray | None = None
    ) -> Remainder:
        """Return the remainder of a fit.

        Parameters
        ----------
        columns : ndarray, shape (data, numbers)
            From `data_changes`.
        residual : ndarray, shape (data,)
        errors : ndarray, shape (data, errors), optional
            Changes of the whitened data by model errors, one standard deviation each.
        """
        columns = with_priors(columns, problem)
        known = np.sqrt(problem.prior_precision) * (problem.center - problem.start)
        residual = np.concatenate([residual, known])
        outward = columns.T @ residual
        low, high = problem.start <= problem.low, problem.start >= problem.high
        at_bound = (low & (outward < 0)) | (high & (outward > 0))
        if errors is not None:
            count = errors.shape[1]
            errors = np.vstack([errors, np.zeros((len(known), count)), np.eye(count)])
            columns = np.hstack([np.pad(columns, ((0, count), (0, 0))), errors])
            residual = np.pad(residual, (0, count))
            low, high, at_bound = (np.pad(flags, (0, count)) for flags in (low, high, at_bound))
        basis = np.linalg.qr(columns[:, ~at_bound])[0]
        inward = (columns * np.where(low, 1, -1))[:, at_bound].T
        return cls(basis, residual - basis @ (basis.T @ residual), inward - (inward @ basis) @ basis.T)

    def gain(self, rows: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
        """Return the largest decrease of chi-square by templates (rows), orthogonal to `basis`, within bounds."""
        none, unbounded = np.zeros(len(self.inward)), np.full(len(self.inward), np.inf)
        low, high = np.concatenate([low, none]), np.concatenate([high, unbounded])
        return explained(np.vstack([rows, self.inward]), self.residual, low, high)


def screened(
    fitter: Fitter,
    fit: Fit,
    names: Sequence[str],
    processes: int = 1,
    progress: DiagnosisProgress | None = None,
    accuracy: Mapping[str, float] | None = None,
    fitted_too: bool = False,
) -> dict[str, Screened]:
    """Return every effect's matched filter of a fit's residuals, with the best of the shapes that fits start from.

    Parameters
    ----------
    accuracy : mapping of str to float, optional
        Relative errors of the models of declared physics, as `forward_selection.choose` takes it; None: not counted.
    fitted_too : bool, optional
        Whether errors of the fitted effects' models are considered, too.

    Raises
    ------
    InputError
        As `run_parallel`.
    """
    parts, here = fitter.data.residuals(fitter.predicted(fit)), Problem.at(fitter, fit)
    columns, residual = data_changes(here), here.whitened(parts)
    # An effect may change the priors of the nuisance parameters.
    problems = {name: Problem.at(fitter, fit, beside=name) for name in names}
    inexact = [*fitter.model.declared, *(fit.effects if fitted_too else ())]
    errors = distortions_of_physics(fitter, fit, columns, accuracy, inexact) if accuracy and inexact else None
    remainders: dict[tuple, list[Remainder]] = {}
    for problem in problems.values():
        if problem.nuisances not in remainders:
            remainders[problem.nuisances] = [Remainder.of(problem, columns, residual)]
            if errors is not None:
                remainders[problem.nuisances].append(Remainder.of(problem, columns, residual, errors))

    def screen(name: str) -> Screened:
        left = remainders[problems[name].nuisances]
        if load(name).pattern:
            found = [_pattern(fitter, parts[0]), *(_pattern(fitter, _of_mean(fitter, other)) for other in left[1:])]
        else:
            tried = shapes(fitter, name)
            rows, parameters = templates(fitter, fit, name, tried), fitter.model.parameters(name)
            found = [_best(parameters, rows, len(tried), other) for other in left]
        return found[0] if errors is None else replace(found[0], with_model_error=found[1])

    done = None if progress is None else progress.begin(RANKED, len(names), fit.effects)
    return dict(zip(names, run_parallel(screen, [(name,) for name in names], processes, done), strict=True))


def shapes(fitter: Fitter, name: str) -> list[dict[str, float]]:
    """Return all combinations of the starts of an effect's parameters without a neutral value."""
    unknowns = [unknown for unknown in fitter.model.unknowns((name,)) if unknown.neutral is None]
    return [
        {unknown.name: unknown.value(number) for unknown, number in zip(unknowns, values, strict=True)}
        for values in product(*(unknown.starts for unknown in unknowns))
    ]


def _of_mean(fitter: Fitter, left: Remainder) -> np.ndarray:
    """Return the remainder of the mean in units of the data, shape (data,)."""
    weight = fitter.weights[0]
    return left.residual[: weight.size] / np.sqrt(np.where(weight > 0, weight, np.inf))


def _pattern(fitter: Fitter, residual: np.ndarray) -> Screened:
    """Return the result for a gain pattern, which is estimated directly from the mean's residual."""
    data = fitter.data
    mean, weight = (values.reshape(data.mean.shape) for values in (residual, fitter.weights[0]))
    pattern = data.pattern(mean, weight)
    gain = float((weight * mean * data.whitened(data.pattern_field(pattern.values))).sum())  # priors included
    return Screened(pattern.p, gain)


def _best(parameters: Sequence[Parameter], rows: np.ndarray, count: int, left: Remainder) -> Screened:
    """Return the result for an effect with the best of `count` shapes; `rows` are its templates."""
    low, high = amounts(parameters)
    lengths = (rows**2).sum(axis=1).reshape(count, -1)
    rows = projected(rows, left.basis).reshape(count, len(low), -1)
    found = Screened(1.0, 0.0, blind=not lengths.any())
    for shape, length in zip(rows, lengths, strict=True):
        seen = (shape**2).sum(axis=1) > SMALL * np.maximum(length, 1e-300)
        if seen.any():
            gain = left.gain(shape[seen], low[seen], high[seen])
            p = min(1.0, float(stats.chi2.sf(gain, int(seen.sum()))) * count)
            found = max(found, Screened(p, gain), key=lambda tried: tried.gain)
    return found


def amounts(parameters: Sequence[Parameter]) -> tuple[np.ndarray, np.ndarray]:
    """Return the smallest and largest multiples of an effect's templates within its range, shape (templates,)."""
    parameters = varied(parameters)
    if not parameters:  # it cannot be faint
        return np.array([SIZES[0]]), np.array([SIZES[1]])
    ends = [
        sorted((one.to_variable(end) - one.to_variable(one.neutral)) / size for end in (one.low, one.high))
        for one, size in ((one, one.to_variable(strength(one)) - one.to_variable(one.neutral)) for one in parameters)
    ]
    return tuple(np.array(ends).T)


def explained(rows: np.ndarray, residual: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """Return the largest decrease of a residual's square by templates (rows) within bounds on their amounts."""
    lengths = np.sqrt((rows**2).sum(axis=1))
    rows, low, high = rows[lengths > 0], low[lengths > 0], high[lengths > 0]
    lengths = lengths[lengths > 0]
    # A small penalty on the amounts, so that rounding errors of two equal templates do not act as a third template.
    products = (rows @ rows.T) / np.outer(lengths, lengths) + ALIKE**2 * np.eye(len(rows))
    root = np.linalg.cholesky(products)
    target = solve_triangular(root, rows @ residual / lengths, lower=True)
    solved = lsq_linear(root.T, target, (low * lengths, high * lengths), method="bvls")
    return max(0.0, float(target @ target - 2 * solved.cost))


def stands_out(filtered: Screened, count: int, least_gain: float) -> bool:
    """Return whether a filter is significant over `count` candidates and gains more than a decrease of chi-square."""
    return filtered.p * count < SCREEN and filtered.gain > least_gain


def differs_in_kind(effect: str, fitted: Sequence[str]) -> bool:
    """Return whether model errors of fitted effects cannot look like an effect.

    Errors of signals cannot move rays or the object, but those of a fitted effect that moves them can. The error of a
    filter is a filter, which keeps uniform areas.
    """
    moves = load(effect).kinematic and not any(load(name).kinematic for name in fitted)
    return moves or (load(effect).shades and all(load(name).mtf is not None for name in fitted))


def is_unconfounded(
    effect: str, fitted: Sequence[str], beside: Mapping[str, Screened], least_gain: float, lead: float
) -> bool:
    """Return whether an effect differs in kind, and neither model errors nor other effects explain its gain.

    Parameters
    ----------
    fitted : sequence of str
        Fitted effects without this one.
    beside : mapping of str to Screened
        Matched filters of the effect and of all others, with model errors.
    least_gain, lead : float
        Decrease of chi-square that model errors must not explain, and least lead of the effect over the others.
    """
    own = beside[effect].beside_model_error
    others = max((filtered.beside_model_error.gain for name, filtered in beside.items() if name != effect), default=0.0)
    keeps = stands_out(own, len(beside), least_gain) and own.gain >= KEPT_BESIDE_MODEL_ERROR * beside[effect].gain
    return differs_in_kind(effect, fitted) and keeps and own.gain - others >= lead


def worth_fitting(
    found: Mapping[str, Screened], needed: float = 0.0, model_error_gain: float | None = None
) -> list[str]:
    """Return the effects worth a fit: the best few, and effects that a filter cannot see.

    Parameters
    ----------
    model_error_gain : float, optional
        Decrease of chi-square that model errors must not explain; None: model errors are not considered.
    """
    likely = {
        name: filtered
        for name, filtered in found.items()
        if model_error_gain is None
        or filtered.with_model_error is None
        or stands_out(filtered.with_model_error, len(found), model_error_gain)
    }
    blind = [name for name, filtered in found.items() if filtered.blind]
    return list(dict.fromkeys([*best_few(likely, needed), *blind]))


def best_few(found: Mapping[str, Screened], needed: float = 0.0) -> list[str]:
    """Return the effects with the largest first-order gains, the best first.

    `needed` is the gain of an effect that they would replace.
    """
    ranked = sorted(found, key=lambda name: -found[name].gain)
    best = found[ranked[0]].gain if ranked else 0.0
    least = LEAST_SHARE * max(best, needed)
    return [
        name
        for rank, name in enumerate(ranked)
        if found[name].gain >= least and (rank < FEW or found[name].gain >= NEAR_BEST * best)
    ]
