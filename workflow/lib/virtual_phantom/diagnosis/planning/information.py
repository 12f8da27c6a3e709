"""What measurements tell of effects that look alike: expected information, and the log score that parts them.

All is of first order, about fits that stand: the Fisher information of numbers that measurements share, with all that
is each measurement's own profiled out, and the part of a difference that no numbers of the other explanation take up.
Designs by these two are called D_s-optimal (A. C. Atkinson and A. N. Donev, Optimum Experimental Designs, Oxford, 1992)
and T-optimal (A. C. Atkinson and V. V. Fedorov, Biometrika 62, 57, 1975).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from ..fitting.fit import Problem
from ..fitting.templates import whitened

# Added to the diagonal of matrices scaled to 1: numbers of which nothing is known and nothing is told stay solvable.
RIDGE = 1e-12

Key = tuple[str, ...]  # of a number: (effect, parameter) if measurements share it, or with the measurement's name first


@dataclass(frozen=True)
class MeasurementInformation:
    """What one measurement tells of its numbers, to first order.

    Attributes
    ----------
    keys : tuple of tuple of str
        Of the numbers.
    changes : ndarray, shape (data, numbers)
        Of the whitened data, per unit of each number.
    predicted : ndarray, shape (data,)
        Whitened, less a constant that is the same for all explanations of the measurement.
    knowledge : ndarray, shape (numbers,)
        Inverse variance of what is known of each beforehand.
    room : ndarray, shape (numbers, 2)
        How far each may move down and up.
    steps : ndarray, shape (numbers,)
        Over which `changes` were taken.
    """

    keys: tuple[Key, ...]
    changes: np.ndarray
    predicted: np.ndarray
    knowledge: np.ndarray
    room: np.ndarray
    steps: np.ndarray

    def of(self, keys: Collection[Key]) -> MeasurementInformation:
        """Of some of the numbers alone."""
        some = [place for place, key in enumerate(self.keys) if key in keys]
        return MeasurementInformation(
            tuple(self.keys[place] for place in some),
            self.changes[:, some],
            self.predicted,
            self.knowledge[some],
            self.room[some],
            self.steps[some],
        )


def told(problem: Problem, name: str, own: Collection[str] = (), protocol: str = "") -> MeasurementInformation:
    """What a measurement tells of the numbers of one choice of effects, where they begin.

    Parameters
    ----------
    name : str
        Of the measurement.
    own : collection of str, optional
        Effects that each measurement has for itself, as it has parameters of one scan.
    protocol : str, optional
        Of the measurement; those of other protocols have other numbers of what belongs to a protocol. Empty: there is
        one protocol alone.
    """
    problem.follow(problem.start)
    predicted = -whitened(problem.residuals(problem.start, None), problem.weights)
    room = np.stack([problem.low - problem.start, problem.high - problem.start], axis=1)
    return MeasurementInformation(
        keys_of(problem, name, own, protocol), changes(problem), predicted, problem.knowledge, room, problem.steps
    )


def keys_of(problem: Problem, name: str, own: Collection[str] = (), protocol: str = "") -> tuple[Key, ...]:
    """The keys of a measurement's numbers, as `told` takes it."""
    owners = [name if one.effect in own else one.owner(name, protocol) for one in problem.unknowns]
    numbers = ((one.effect, one.name) for one in problem.unknowns)
    keys = [(owner, *number) if owner else number for owner, number in zip(owners, numbers, strict=True)]
    return (*keys, *((name, "alignment", one.name) for one in problem.aligned))


def changes(problem: Problem) -> np.ndarray:
    """Change of the whitened data per unit of every number, by differences to both sides where both are in range.

    To one side alone, two numbers of which one moves an edge to the left and one to the right would see different rays
    graze it, and not look as alike as they are.

    Returns
    -------
    ndarray, shape (data, numbers)
    """
    return np.stack([slope(problem, index, step) for index, step in enumerate(problem.steps)], axis=1)


def slope(problem: Problem, index: int, step: float) -> np.ndarray:
    """Change of the whitened data per unit of one number, over a step about its start, shape (data,)."""
    ends = np.clip(problem.start[index] + np.array([-step, step]) / 2, problem.low[index], problem.high[index])
    sides = []
    for end in ends:
        point = problem.start.copy()
        point[index] = end
        sides.append(whitened(problem.residuals(point, None), problem.weights))
    return (sides[0] - sides[1]) / (ends[1] - ends[0])


@dataclass(frozen=True)
class Sums:
    """Normal equations of several measurements.

    Attributes
    ----------
    information : ndarray, shape (numbers, numbers)
        With what is known beforehand, of shared numbers once.
    gradient : ndarray, shape (numbers,)
        Of minus half of chi-square.
    square : float
        Chi-square at the start.
    room : ndarray, shape (numbers, 2)
    """

    keys: tuple[Key, ...]
    information: np.ndarray
    gradient: np.ndarray
    square: float
    room: np.ndarray


def summed(parts: Sequence[MeasurementInformation], differences: Sequence[np.ndarray] | None = None) -> Sums:
    """The normal equations of measurements together.

    Parameters
    ----------
    differences : sequence of ndarray, optional
        Of each, shape (data,): what is to be taken up; None: nothing.
    """
    keys = tuple(dict.fromkeys(key for part in parts for key in part.keys))
    place = {key: i for i, key in enumerate(keys)}
    information, gradient, square = np.zeros((len(keys), len(keys))), np.zeros(len(keys)), 0.0
    known, room = np.zeros(len(keys)), np.tile([-np.inf, np.inf], (len(keys), 1))
    for number, part in enumerate(parts):
        index = [place[key] for key in part.keys]
        information[np.ix_(index, index)] += part.changes.T @ part.changes
        known[index] = np.maximum(known[index], part.knowledge)
        room[index] = np.stack(
            [np.maximum(room[index, 0], part.room[:, 0]), np.minimum(room[index, 1], part.room[:, 1])], 1
        )
        if differences is not None:
            gradient[index] += part.changes.T @ differences[number]
            square += float(differences[number] @ differences[number])
    return Sums(keys, information + np.diag(known), gradient, square, room)


def profiled(sums: Sums, group: Sequence[Key]) -> np.ndarray:
    """The Fisher information of some numbers, all others fitted.

    Returns
    -------
    ndarray, shape (group, group)
        The Schur complement of the others' block.
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


def information_gain(before: Sums, after: Sums, group: Sequence[Key]) -> float:
    """Half of the logarithm of the determinant of the group's Fisher information, after less before.

    Returns
    -------
    float
        In nats: of Gaussian knowledge, how much narrower it becomes.
    """
    (_, low), (_, high) = (np.linalg.slogdet(profiled(one, group)) for one in (before, after))
    return 0.5 * float(high - low)


def parted(sums: Sums) -> float:
    """Log score by which an explanation is expected to fall behind the right one.

    Half of the least chi-square that its numbers, moved within their ranges, leave of what the right one predicts
    otherwise.

    Parameters
    ----------
    sums : Sums
        Of the wrong explanation's numbers, and differences of the right one's predictions to its own.
    """
    scale = np.sqrt(np.maximum(np.diag(sums.information), np.finfo(float).tiny))
    unit = sums.information / np.outer(scale, scale)
    root = np.linalg.cholesky(unit + RIDGE * np.eye(len(scale))).T
    target = np.linalg.solve(root.T, sums.gradient / scale)
    low, high = (sums.room * scale[:, None]).T
    solved = lsq_linear(root, target, (np.minimum(low, 0), np.maximum(high, np.finfo(float).tiny)), method="bvls")
    return 0.5 * max(0.0, sums.square - float(target @ target) + 2 * solved.cost)


def cosines(matrix: np.ndarray) -> np.ndarray:
    """|Cosines| between what numbers change, of their Fisher information; NaN of a number that changes nothing."""
    length = np.sqrt(np.maximum(np.diag(matrix), 0))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.abs(matrix / np.outer(length, length))


def correlation(sums: Sums, one: Sequence[Key], other: Sequence[Key]) -> float:
    """How alike what two effects change is, beside all other numbers.

    Parameters
    ----------
    one, other : sequence of tuple of str
        Numbers of each.

    Returns
    -------
    float
        The largest |cosine| of a number of the one and a number of the other; NaN where one changes nothing.
    """
    between = cosines(profiled(sums, [*one, *other]))[: len(one), len(one) :]
    return float(np.nanmax(between)) if np.isfinite(between).any() else float("nan")


def expected(parts: Mapping[str, Sequence[MeasurementInformation]], right: str, wrong: str) -> float:
    """`parted` of two explanations of the same measurements.

    Parameters
    ----------
    parts : mapping of str to sequence of MeasurementInformation
        By explanation, measurements in one order.
    """
    differences = [a.predicted - b.predicted for a, b in zip(parts[right], parts[wrong], strict=True)]
    return parted(summed(parts[wrong], differences))
