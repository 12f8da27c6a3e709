"""What kind of change a fit leaves over, by a basis that knows no physics: what is outside of the library shows there.

A kind of change is a span of directions of the data. The data fitted say which direction of it would serve best, beyond
what the fit's numbers take up, and the data held out say whether it does: their noise is independent, so that their
residual along that direction is normal whatever the span.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy import stats
from scipy.sparse import issparse, sparray

from ..fitting.fit import Fit, Problem
from ..fitting.steps import Known
from ..fitting.templates import SMALL, whitened
from ..noise.condensed import Observed
from ..residuals.change import Change, PieceOfObject
from ..residuals.dataset import Prepared
from ..residuals.residual_tests import KINDS, Half, Location
from ..selection.forward_selection import Choice
from ..uncertainty.prediction_error import of_both_halves

ALIKE = 1e-6  # of the largest eigenvalue of a span, each direction of length 1: less is rounding
Directions = np.ndarray | sparray


@dataclass(frozen=True)
class _Side:
    """One half of the data about a fit, whitened, all parts.

    Attributes
    ----------
    residual : ndarray, shape (data,)
    columns : ndarray, shape (data, numbers)
        Changes with the fit's numbers and with numerical distortions.
    root : ndarray, shape (mean data,)
        Roots of the mean's weights.
    scatter : ndarray, shape (mean data,), or float
        Relative variance of these weights.
    """

    residual: np.ndarray
    columns: np.ndarray
    root: np.ndarray
    scatter: np.ndarray | float
    data: Observed

    @classmethod
    def of(cls, half: Half, jacobian: list[np.ndarray], steps: np.ndarray) -> _Side:
        """From what a fit leaves of the half, and changes of what it predicts over steps of its numbers."""
        changes = [whitened([rows[number] for rows in jacobian], half.weights) for number in range(len(steps))]
        root = np.sqrt(half.weights[0])
        none = np.zeros(len(changes[0]) - root.size)
        changes = [change / step for change, step in zip(changes, steps, strict=True)]
        changes += [np.concatenate([root * one.ravel(), none]) for one in half.data.numerical]
        residual = whitened(half.residuals, half.weights)
        return cls(residual, np.stack(changes, axis=1), root, np.ravel(half.data.scatter), half.data)

    def weighed(self, directions: Directions) -> Directions:
        """Directions of the mean's data in standard deviations."""
        root = self.root[:, None]
        if issparse(directions):  # of single views, and as they are: whitening would spread them to others
            return directions.multiply(root).tocsr()
        fields = (one.reshape(self.data.mean.shape) for one in directions.T)
        white = [self.data.whitened(np.where(self.data.usable, one, 0)).ravel() for one in fields]
        return np.stack(white, axis=1) * root


def changes(prepared: Prepared, fit: Fit, numerical: float = 0.0) -> list[Change]:
    """What every kind of change does for a fit, beyond what its numbers take up.

    Parameters
    ----------
    prepared : Prepared
        Whose kinds are tried.
    numerical : float, optional
        Share of the corrections for finite steps by which they may be off, in any shape.

    Returns
    -------
    list of Change
        The most certain first.
    """
    problem = Problem(prepared.fitter, fit.effects, fit)
    jacobians = of_both_halves(prepared.fitter, problem, fit)
    halves = zip(prepared.halves(fit), jacobians, strict=True)
    fitted, held = (_Side.of(half, jacobian, problem.steps) for half, jacobian in halves)
    # Of a distortion its size is known to one standard deviation.
    distortions = np.zeros(len(fitted.data.numerical))
    knowledge = np.concatenate([problem.knowledge, distortions + 1])
    off = np.concatenate([problem.knowledge * (problem.centre - problem.start), distortions])
    information = fitted.columns.T @ fitted.columns + np.diag(knowledge)
    inverse = Known.of(information).covariance
    # A fit has settled but for its last step, and has not fitted the sizes that numerical distortions are left with.
    step = inverse @ (fitted.columns.T @ fitted.residual + off)
    residuals = fitted.residual - fitted.columns @ step, held.residual - held.columns @ step
    found, of_steps = [], numerical**2 * fit.corrected
    for words, directions, piece in _tried(prepared, fit):
        change = _change(fitted, held, residuals, inverse, directions, fit.pattern_variance, of_steps)
        if change is not None:
            found.append(Change(words, *change, piece))
    return sorted(found, key=lambda one: one.p)


class ChangesOfFits:
    """`changes` of fits, each worked out once: who chooses asks for them, and who judges.

    Of one recording made ready at a time: with other noise or another object it takes the place of the one before.
    """

    def __init__(self):
        self._prepared: Prepared | None = None
        self._found: dict[tuple, list[Change]] = {}

    def __call__(self, prepared: Prepared, fit: Fit, numerical: float) -> list[Change]:
        """As `changes`; there is one fit of a set of effects."""
        if prepared is not self._prepared:
            self._prepared, self._found = prepared, {}
        key = fit.effects, numerical
        if key not in self._found:
            self._found[key] = changes(prepared, fit, numerical)
        return self._found[key]


def _tried(prepared: Prepared, fit: Fit) -> Iterator[tuple[str, Directions, PieceOfObject | None]]:
    """All kinds of change one after the other, and the piece of the object as one more."""
    for words, directions in prepared.kinds(fit):
        yield words, directions, None
    piece = prepared.piece(fit)
    if piece is not None:
        yield piece.words, piece.directions, piece


def _change(
    fitted: _Side,
    held: _Side,
    residuals: tuple[np.ndarray, np.ndarray],
    inverse: np.ndarray,
    directions: Directions,
    of_pattern: np.ndarray | None,
    of_steps: float,
) -> tuple[float, float, float] | None:
    """z, p and gain of one kind; None where the fit takes up all of it.

    A gain pattern has a constant of every pixel that is no number of the fit: it has taken what is constant out of the
    residuals, and is known to the variance `of_pattern`.

    Parameters
    ----------
    residuals : tuple of 2 ndarray, shape (data,)
        Of the data fitted and held out, less what the fit's numbers could still take up of the data fitted.
    inverse : ndarray, shape (numbers, numbers)
        Covariance of the numbers.
    directions : ndarray or sparse array, shape (mean data, directions)
    of_pattern : ndarray, shape (rows, columns), or None
    of_steps : float
        Square of what finite steps may leave along any direction, in standard deviations of the data.

    Returns
    -------
    tuple of 3 float, or None
    """
    count = fitted.root.size
    seen = fitted.weighed(directions)
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
    # What the numbers do about a change is known of the data fitted.
    answered = inverse @ (crossed @ amounts)
    change = -(held.columns @ answered)
    change[: held.root.size] += held.weighed(directions) @ amounts
    taken_up = held.columns.T @ change  # what errors of the numbers add along it
    mean = change[: held.root.size]
    variance = float(
        (1 + of_steps) * (change @ change) + (held.scatter * mean**2).sum() + taken_up @ inverse @ taken_up
    )
    if of_pattern is not None:  # what errors of its constants add along it
        variance += float((of_pattern.ravel() * (held.root * mean).reshape(-1, of_pattern.size).sum(axis=0) ** 2).sum())
    along = float(change @ residuals[1])
    shrunk = max(0.0, 1 - freedom / explained)
    gain = shrunk * along - shrunk**2 * float(change @ change) / 2
    z = float(along / np.sqrt(variance))
    return z, float(stats.norm.sf(z)), gain


def standing_out(found: list[Change], least_gain: float) -> list[Location]:
    """The kinds of change as one more domain of difference, by the most certain.

    Parameters
    ----------
    found : list of Change
        As `changes` gives them.
    least_gain : float
        Log score: kinds that gain less may be what inexact models leave, and count for nothing.

    Returns
    -------
    list of Location
        One, or none where there is no kind.
    """
    if not found:
        return []
    standing = [one for one in found if one.gain > least_gain] or found[:1]
    best = standing[0]
    p = min(1.0, best.p * len(found)) if best.gain > least_gain else 1.0
    return [Location(KINDS, best.words, best.z, p, np.array([one.z for one in found]))]


def better(choice: Choice, found: Mapping[str, list[Change]], least: float) -> dict[str, Change]:
    """Effects that a kind of change beats in their place: each may be something outside of the library.

    Parameters
    ----------
    found : mapping of str to list of Change
        {effect: the kinds beside the fit without it}.
    least : float
        Log score by which a kind must be better.

    Returns
    -------
    dict of str to Change
        {effect: the best of the kinds}.
    """
    beaten = {}
    for effect, kinds in found.items():
        best = max(kinds, key=lambda one: one.gain, default=None)
        if best is not None and best.gain > choice.gains[effect] + least:
            beaten[effect] = best
    return beaten
