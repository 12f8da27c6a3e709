"""Unmodeled changes: tests of a fit's residual against a basis without physics.

A kind of change is a span of directions in data space. The fitted data determine the best direction that no parameter
of the fit describes. This direction is tested with the held-out data. Their noise is independent, so their residual
along the direction is normal for any span.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy import stats
from scipy.sparse import issparse, sparray

from ..fitting.fit import Fit
from ..fitting.problem import Problem
from ..fitting.steps import ScaledEigenvalues
from ..fitting.templates import SMALL, whitened, whitened_columns
from ..noise.condensed import Observed
from ..noise.gain_pattern import Pattern
from ..residuals import KINDS
from ..residuals.dataset import Change, LocalMismatch, Prepared
from ..residuals.residual_tests import DomainTest, HalfResiduals
from ..selection.forward_selection import Choice

ALIKE = 1e-6  # of the largest eigenvalue of a span of unit vectors; less is rounding
Directions = np.ndarray | sparray


@dataclass(frozen=True)
class _Side:
    """Fitted or held-out data at a fit, whitened, all parts.

    Attributes
    ----------
    residual : ndarray, shape (data,)
    columns : ndarray, shape (data, numbers)
        Derivatives by the parameters of the fit and by numerical distortions.
    root : ndarray, shape (mean data,)
        Square roots of the weights of the mean.
    weight_variance : ndarray, shape (mean data,), or float
        Relative variance of these weights.
    """

    residual: np.ndarray
    columns: np.ndarray
    root: np.ndarray
    weight_variance: np.ndarray | float
    data: Observed

    @classmethod
    def of(cls, half: HalfResiduals, jacobian: list[np.ndarray], steps: np.ndarray) -> _Side:
        """Return the data of a half from its residuals and from changes of the prediction by steps of parameters."""
        changes, root = whitened_columns(jacobian, half.weights, steps), np.sqrt(half.weights[0])
        residual = whitened(half.residuals, half.weights)
        none = np.zeros(residual.size - root.size)
        changes += [np.concatenate([root * error.ravel(), none]) for error in half.data.numerical]
        return cls(residual, np.stack(changes, axis=1), root, np.ravel(half.data.weight_variance), half.data)

    def standardized(self, directions: Directions) -> Directions:
        """Return directions of the mean in standard deviations."""
        root = self.root[:, None]
        if issparse(directions):  # directions of single views, which whitening would spread to other views
            return directions.multiply(root).tocsr()
        fields = (direction.reshape(self.data.mean.shape) for direction in directions.T)
        return np.stack([self.data.whitened(field).ravel() for field in fields], axis=1) * root


def changes(prepared: Prepared, fit: Fit, numerical: float = 0.0) -> list[Change]:
    """Test every kind of change that no parameter of a fit describes; the most significant first.

    A gain pattern counts as known, with errors of its constants in held-out data.

    Parameters
    ----------
    numerical : float, optional
        Relative error of the discretization corrections, of any shape.
    """
    problem = Problem.at(prepared.fitter, fit)
    halves = zip(prepared.halves(fit), problem.changes_of_halves(), strict=True)
    fitted, held = (_Side.of(half, jacobian, problem.steps) for half, jacobian in halves)
    # The amplitude of a distortion has a prior SD of 1.
    distortions = np.zeros(len(fitted.data.numerical))
    prior_precision = np.concatenate([problem.prior_precision, distortions + 1])
    off = np.concatenate([problem.prior_precision * (problem.center - problem.start), distortions])
    information = fitted.columns.T @ fitted.columns + np.diag(prior_precision)
    inverse = ScaledEigenvalues.of(information).covariance
    # One more step completes the fit, and fits the remaining amplitudes of numerical distortions.
    step = inverse @ (fitted.columns.T @ fitted.residual + off)
    residuals = fitted.residual - fitted.columns @ step, held.residual - held.columns @ step
    found, of_steps = [], numerical**2 * fit.corrected
    for words, directions, mismatch in _tried(prepared, fit):
        change = _change(fitted, held, residuals, inverse, directions, fit.pattern, of_steps)
        if change is not None:
            found.append(Change(words, *change, mismatch))
    return sorted(found, key=lambda change: change.p)


class ChangesOfFits:
    """Cache of `changes` for the fits of one recording.

    The cache is emptied for another recording, or for the same recording with other noise or another object.
    """

    def __init__(self):
        self._prepared: Prepared | None = None
        self._found: dict[tuple, list[Change]] = {}

    def __call__(self, prepared: Prepared, fit: Fit, numerical: float) -> list[Change]:
        """Return `changes`, by the effects of the fit."""
        if prepared is not self._prepared:
            self._prepared, self._found = prepared, {}
        key = fit.effects, numerical
        if key not in self._found:
            self._found[key] = changes(prepared, fit, numerical)
        return self._found[key]


def _tried(prepared: Prepared, fit: Fit) -> Iterator[tuple[str, Directions, LocalMismatch | None]]:
    """Yield all kinds of change, and the local object mismatch."""
    for words, directions in prepared.kinds(fit):
        yield words, directions, None
    mismatch = prepared.local_mismatch(fit)
    if mismatch is not None:
        yield mismatch.words, mismatch.directions, mismatch


def _change(
    fitted: _Side,
    held: _Side,
    residuals: tuple[np.ndarray, np.ndarray],
    inverse: np.ndarray,
    directions: Directions,
    pattern: Pattern | None,
    of_steps: float,
) -> tuple[float, float, float] | None:
    """Return z, p and gain of one kind of change; None if the fit describes all of it.

    A pattern adds one constant per pixel to the parameters of the fit.

    Parameters
    ----------
    residuals : tuple of 2 ndarray, shape (data,)
        Fitted and held-out residuals after the last step of the fit.
    inverse : ndarray, shape (parameters, parameters)
        Covariance of the parameters.
    directions : ndarray or sparse array, shape (mean data, directions)
    of_steps : float
        Variance of discretization errors along any direction, relative to the data.
    """
    count = fitted.root.size
    seen = fitted.standardized(directions)
    crossed = fitted.columns[:count].T @ seen  # (numbers, directions)
    gram = seen.T @ seen
    gram = np.asarray(gram.todense()) if issparse(gram) else gram
    lengths = np.sqrt(np.diag(gram))
    inside = gram - crossed.T @ inverse @ crossed
    known = np.diag(inside) > SMALL * np.maximum(lengths**2, 1e-300)
    if not known.any():
        return None
    units = np.where(known, 1 / np.where(lengths > 0, lengths, 1), 0)
    values, vectors = np.linalg.eigh(inside * np.outer(units, units))
    kept = values > ALIKE * values[-1]
    along = units * (seen.T @ residuals[0][:count])
    inner = vectors[:, kept].T @ along
    amounts = units * (vectors[:, kept] @ (inner / values[kept]))
    explained, freedom = float((inner**2 / values[kept]).sum()), int(kept.sum())
    if not explained:
        return None
    # The response of the parameters to the change, from the fitted data.
    answered = inverse @ (crossed @ amounts)
    change = -(held.columns @ answered)
    change[: held.root.size] += held.standardized(directions) @ amounts
    taken_up = held.columns.T @ change  # for the variance from errors of the parameters
    mean = change[: held.root.size]
    variance = float(
        (1 + of_steps) * (change @ change) + (held.weight_variance * mean**2).sum() + taken_up @ inverse @ taken_up
    )
    if pattern is not None:  # variance from errors of its constants
        changed = (held.root * mean).reshape(-1, *pattern.variance.shape)
        variance += float((pattern.variance * pattern.over_data(changed).sum(axis=0) ** 2).sum())
    along = float(change @ residuals[1])
    shrunk = max(0.0, 1 - freedom / explained)
    gain = shrunk * along - shrunk**2 * float(change @ change) / 2
    z = float(along / np.sqrt(variance))
    return z, float(stats.norm.sf(z)), gain


def kinds_test(found: list[Change], least_gain: float) -> list[DomainTest]:
    """Return the test of all kinds of change as one domain, as a list; empty without a kind.

    Parameters
    ----------
    least_gain : float
        Log score. Kinds with a smaller gain may come from model errors and are not significant.
    """
    if not found:
        return []
    standing = [change for change in found if change.gain > least_gain] or found[:1]
    best = standing[0]
    p = min(1.0, best.p * len(found)) if best.gain > least_gain else 1.0
    return [DomainTest(KINDS, best.words, best.z, p, np.array([change.z for change in found]))]


def better_changes(choice: Choice, found: Mapping[str, list[Change]], least: float) -> dict[str, Change]:
    """Return {effect: best unmodeled change} for effects that gain less than this change.

    Parameters
    ----------
    found : mapping of str to list of Change
        {effect: `changes` of the fit without it}.
    """
    beaten = {}
    for effect, kinds in found.items():
        best = max(kinds, key=lambda change: change.gain, default=None)
        if best is not None and best.gain > choice.gains[effect] + least:
            beaten[effect] = best
    return beaten
