"""Expected information of measurements about similar effects, and the log score that distinguishes them.

Both are of first order at the fitted parameters. The first is the Fisher information of shared parameters, with the
parameters of each measurement profiled out. Designs by it are called D_s-optimal (A. C. Atkinson and A. N. Donev,
Optimum Experimental Designs, Oxford, 1992). The second is the part of a difference that no parameter of the other
explanation can describe: T-optimal designs (A. C. Atkinson and V. V. Fedorov, Biometrika 62, 57, 1975).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from ..fitting.problem import Problem
from ..fitting.templates import whitened

# Added to the diagonal of matrices scaled to a diagonal of 1. Undetermined parameters then do not make them singular.
RIDGE = 1e-12

Key = tuple[str, ...]  # of a parameter: (effect, parameter) if measurements share it, else the measurement's name first


@dataclass(frozen=True)
class MeasurementInformation:
    """First-order information of one measurement about its parameters.

    Attributes
    ----------
    keys : tuple of tuple of str
        Keys of the parameters.
    changes : ndarray, shape (data, parameters)
        Change of the whitened data per unit of each parameter.
    predicted : ndarray, shape (data,)
        Whitened prediction, up to a constant that all explanations of the measurement share.
    prior_precision : ndarray, shape (parameters,)
        Inverse prior variance.
    margins : ndarray, shape (parameters, 2)
        Distances of the lower and the upper bound of each parameter from its start.
    steps : ndarray, shape (parameters,)
        Steps of the finite differences in `changes`.
    """

    keys: tuple[Key, ...]
    changes: np.ndarray
    predicted: np.ndarray
    prior_precision: np.ndarray
    margins: np.ndarray
    steps: np.ndarray


def measurement_information(problem: Problem, keys: tuple[Key, ...]) -> MeasurementInformation:
    """Return the information of a measurement about the parameters of its problem, at their start."""
    problem.follow(problem.start)
    predicted = -whitened(problem.residuals(problem.start), problem.weights)
    margins = np.stack([problem.low - problem.start, problem.high - problem.start], axis=1)
    return MeasurementInformation(keys, changes(problem), predicted, problem.prior_precision, margins, problem.steps)


def keys_of(problem: Problem, name: str, own: Collection[str], protocol: str) -> tuple[Key, ...]:
    """Return the keys of the parameters of a measurement.

    Parameters
    ----------
    own : collection of str
        Effects whose parameters belong to one measurement and are not shared.
    protocol : str
        Protocol of the measurement, within which parameters of a protocol are shared. Empty: a single protocol.
    """
    owners = [name if unknown.effect in own else unknown.owner(name, protocol) for unknown in problem.unknowns]
    numbers = ((unknown.effect, unknown.name) for unknown in problem.unknowns)
    keys = [(owner, *number) if owner else number for owner, number in zip(owners, numbers, strict=True)]
    # Scans of one object share its errors.
    shared, scanned = problem.model.object_errors.names, f"object {id(problem.model.chain.scene)}"
    aligned = [(scanned if number.name in shared else name, "alignment", number.name) for number in problem.nuisances]
    return (*keys, *aligned)


def changes(problem: Problem) -> np.ndarray:
    """Return the change of the whitened data per unit of every parameter, shape (data, parameters).

    Differences are central where the range allows. One-sided differences would make two parameters that move an edge in
    opposite directions look less similar than they are, as other rays graze the edge.
    """
    return np.stack([slope(problem, index, step) for index, step in enumerate(problem.steps)], axis=1)


def slope(problem: Problem, index: int, step: float) -> np.ndarray:
    """Return the change of the whitened data per unit of one parameter, over a step about its start, shape (data,)."""
    ends = np.clip(problem.start[index] + np.array([-step, step]) / 2, problem.low[index], problem.high[index])
    sides = []
    for end in ends:
        point = problem.start.copy()
        point[index] = end
        sides.append(whitened(problem.residuals(point), problem.weights))
    return (sides[0] - sides[1]) / (ends[1] - ends[0])


@dataclass(frozen=True)
class NormalEquations:
    """Normal equations of several measurements.

    Attributes
    ----------
    information : ndarray, shape (parameters, parameters)
        With prior information, counted once for shared parameters.
    gradient : ndarray, shape (parameters,)
        Gradient of minus half of chi-square.
    square : float
        Chi-square at the start.
    margins : ndarray, shape (parameters, 2)
    """

    keys: tuple[Key, ...]
    information: np.ndarray
    gradient: np.ndarray
    square: float
    margins: np.ndarray


def normal_equations(
    parts: Sequence[MeasurementInformation], differences: Sequence[np.ndarray] | None = None
) -> NormalEquations:
    """Return the joint normal equations of measurements.

    Parameters
    ----------
    differences : sequence of ndarray, optional
        By measurement, shape (data,): difference that the parameters describe; None: zero.
    """
    keys = tuple(dict.fromkeys(key for part in parts for key in part.keys))
    place = {key: i for i, key in enumerate(keys)}
    information, gradient, square = np.zeros((len(keys), len(keys))), np.zeros(len(keys)), 0.0
    known, margins = np.zeros(len(keys)), np.tile([-np.inf, np.inf], (len(keys), 1))
    for number, part in enumerate(parts):
        index = [place[key] for key in part.keys]
        information[np.ix_(index, index)] += part.changes.T @ part.changes
        known[index] = np.maximum(known[index], part.prior_precision)
        margins[index] = np.stack(
            [np.maximum(margins[index, 0], part.margins[:, 0]), np.minimum(margins[index, 1], part.margins[:, 1])], 1
        )
        if differences is not None:
            gradient[index] += part.changes.T @ differences[number]
            square += float(differences[number] @ differences[number])
    return NormalEquations(keys, information + np.diag(known), gradient, square, margins)


def profiled_information(sums: NormalEquations, group: Sequence[Key]) -> np.ndarray:
    """Return the Fisher information of a group of parameters with all others profiled out, shape (group, group).

    This is the Schur complement of the block of the others.
    """
    inside = [sums.keys.index(key) for key in group]
    outside = [i for i in range(len(sums.keys)) if i not in inside]
    scale = np.sqrt(np.maximum(np.diag(sums.information), np.finfo(float).tiny))
    unit = sums.information / np.outer(scale, scale) + RIDGE * np.eye(len(scale))
    block = unit[np.ix_(inside, inside)]
    if outside:
        cross = unit[np.ix_(inside, outside)]
        block = block - cross @ np.linalg.solve(unit[np.ix_(outside, outside)], cross.T)
    return block * np.outer(scale[inside], scale[inside])


def information_gain(before: NormalEquations, after: NormalEquations, group: Sequence[Key]) -> float:
    """Return the gain of information about a group of parameters, in nats.

    This is half the difference of the log determinants of their Fisher information.
    """
    (_, low), (_, high) = (np.linalg.slogdet(profiled_information(sums, group)) for sums in (before, after))
    return 0.5 * float(high - low)


def expected_log_score_loss(sums: NormalEquations) -> float:
    """Return the log score by which a wrong explanation is expected to fall behind the right one.

    Half of the smallest chi-square of the difference of their predictions, with the parameters of the wrong explanation
    fitted within their ranges.

    Parameters
    ----------
    sums : NormalEquations
        For the parameters of the wrong explanation and the difference of the predictions.
    """
    scale = np.sqrt(np.maximum(np.diag(sums.information), np.finfo(float).tiny))
    unit = sums.information / np.outer(scale, scale)
    root = np.linalg.cholesky(unit + RIDGE * np.eye(len(scale))).T
    target = np.linalg.solve(root.T, sums.gradient / scale)
    low, high = (sums.margins * scale[:, None]).T
    solved = lsq_linear(root, target, (np.minimum(low, 0), np.maximum(high, np.finfo(float).tiny)), method="bvls")
    return 0.5 * max(0.0, sums.square - float(target @ target) + 2 * solved.cost)


def cosines(matrix: np.ndarray) -> np.ndarray:
    """Return |cosines| between the changes that parameters make, from their Fisher information; NaN for no change."""
    length = np.sqrt(np.maximum(np.diag(matrix), 0))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.abs(matrix / np.outer(length, length))


def correlation(sums: NormalEquations, one: Sequence[Key], other: Sequence[Key]) -> float:
    """Return the similarity of two effects with all other parameters profiled out.

    This is the largest |cosine| between a parameter of one effect and a parameter of the other; NaN if an effect
    changes nothing.

    Parameters
    ----------
    one, other : sequence of tuple of str
        Keys of the parameters of each effect.
    """
    between = cosines(profiled_information(sums, [*one, *other]))[: len(one), len(one) :]
    return float(np.nanmax(between)) if np.isfinite(between).any() else float("nan")


def expected(parts: Mapping[str, Sequence[MeasurementInformation]], right: str, wrong: str) -> float:
    """Return expected_log_score_loss for two explanations of the same measurements.

    Parameters
    ----------
    parts : mapping of str to sequence of MeasurementInformation
        By explanation, with the measurements in the same order.
    """
    differences = [a.predicted - b.predicted for a, b in zip(parts[right], parts[wrong], strict=True)]
    return expected_log_score_loss(normal_equations(parts[wrong], differences))
