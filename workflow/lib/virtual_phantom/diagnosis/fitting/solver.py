"""Levenberg-Marquardt least squares with Broyden updates, for one recording or for several that share parameters.

Recordings of one scanner share its physics. Recordings of one protocol may share further parameters, such as the tube
voltage. Nuisance parameters belong to each recording. The normal equations of several recordings have arrow form: a
block of shared parameters, and one block of nuisance parameters for each recording.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from .problem import Problem
from .steps import bounded_step, updated

# Bound on the iterations. Nearly all fits converge within 25; along narrow valleys, as between a detector that is off
# by a row and an object that is displaced, they need 40.
ITERATIONS = 60
# Convergence: change of chi-square between two iterations, and the same as a share of its excess over noise.
CONVERGED, CONVERGED_SHARE = 0.02, 1e-5
# The same for fits that are only compared with others: half a unit of log score at most, an eighth of the least gain of
# an effect (forward_selection.LEAST_GAIN).
COMPARED, COMPARED_SHARE = 1.0, 1e-4
# A fit with a needed chi-square ends after this many iterations if even this many times the decrease that an undamped
# step predicts would not reach it. A detector tilt in the place of a motion took 28 Jacobians and ended at a chi-square
# of 76 082 where 12 612 were needed (case 128 of seed 5421).
HOPELESS_AFTER, HOPE = 2, 10.0
# A Jacobian stays in use while the gain of a step over the predicted gain is in this range.
AS_EXPECTED = (0.7, 1.4)
# Marquardt's damping starts at 0, then LEAST_DAMPING, and grows by DAMPING while steps raise chi-square.
LEAST_DAMPING, DAMPING, MOST_DAMPING = 1e-4, 10.0, 1e4
# A search ends after this many steps in a row that gain less than this although their Jacobian is new, and less than
# expected or with a high damping. Without this rule, a view blur took 16 steps of 0.02 to 0.2 (case 24 of seed 1 of the
# blind validation). Steps of a focal spot gained 0.04 instead of 0.8 (case 92 of seed 5421).
SMALL_STEPS, SMALL_GAIN, HIGH_DAMPING = 3, 0.25, 1.0

Jacobians = dict[str, list[np.ndarray]]  # by recording and part of the data


@dataclass(frozen=True)
class Iterate:
    """A point with its residuals.

    Attributes
    ----------
    point : ndarray, shape (numbers,)
    residuals : dict of str to list of ndarray, shape (data,)
        By recording and part of the data.
    """

    point: np.ndarray
    residuals: dict[str, list[np.ndarray]]
    chi_square: float


@dataclass(frozen=True)
class Solution(Iterate):
    """The point where a search has ended.

    Attributes
    ----------
    information : ndarray, shape (numbers, numbers), or None
        None if the last Jacobian was made by Broyden's updates.
    predicted_decrease : float
        Decrease of chi-square that the derivatives predict although no step achieves it; 0 if the search converged.
    """

    information: np.ndarray | None
    predicted_decrease: float


class JointProblem:
    """Least-squares problem of one recording, or of several that share parameters.

    Parameters
    ----------
    problems : mapping of str to Problem
        By recording, for the same effects. Bounds and priors of shared parameters are made common.

    Attributes
    ----------
    indices : dict of str to ndarray of int, shape (numbers,)
        By recording, positions of its numbers in a joint point; the first recording's numbers come first.
    """

    def __init__(self, problems: Mapping[str, Problem], protocols: Mapping[str, str]):
        self.problems, self.indices = dict(problems), joint_indices(problems, protocols)
        indices = np.concatenate(list(self.indices.values()))
        times = np.bincount(indices)
        # Bounds from one scan do not limit the others, and the prior of a shared number counts once.
        self.low, self.high = np.full(len(times), np.inf), np.full(len(times), -np.inf)
        np.minimum.at(self.low, indices, np.concatenate([problem.low for problem in problems.values()]))
        np.maximum.at(self.high, indices, np.concatenate([problem.high for problem in problems.values()]))
        for name, problem in self.problems.items():
            own = self.indices[name]
            problem.low, problem.high = self.low[own], self.high[own]
            problem.prior_precision = problem.prior_precision / times[own]
        self.count = sum(problem.count for problem in self.problems.values())
        self.patterned = any(problem.patterned for problem in self.problems.values())

    @property
    def smooth(self) -> bool:
        """Whether a gain pattern has a smooth part (Pattern.smooth)."""
        return any(problem.pattern is not None and problem.pattern.smooth for problem in self.problems.values())

    def parts(self, point: np.ndarray) -> Iterator[tuple[str, Problem, np.ndarray]]:
        """Yield each recording's name, problem, and part of a joint point."""
        for name, problem in self.problems.items():
            yield name, problem, point[self.indices[name]]

    def common_start(self) -> Iterate:
        """Return a start for several recordings: shared parameters of the first one, with solved scale and offset."""
        point = np.empty(len(self.low))
        for name, problem in reversed(self.problems.items()):
            start = np.clip(problem.start, problem.low, problem.high)
            problem.follow(start)
            point[self.indices[name]] = start
        return self.solve_scale_and_offset(point)

    def recompute(self, point: np.ndarray) -> Iterate:
        """Return a point with residuals at the present linearization and with gain patterns estimated again."""
        return self._iterate(point, {name: own.recompute_residuals(part) for name, own, part in self.parts(point)})

    def needs_new_corrections(self, here: Iterate) -> bool:
        """Return whether any recording needs new numerical corrections (Problem.needs_new_corrections)."""
        return any([own.needs_new_corrections(part) for _, own, part in self.parts(here.point)])  # a list: calls all

    def follow(self, here: Iterate) -> Iterate:
        """Return a point whose residuals are computed with rays traced there, if it was out of the linear range."""
        if not any([problem.follow(part) for _, problem, part in self.parts(here.point)]):  # a list: calls all
            return here
        return self._iterate(here.point, {name: own.residuals(part) for name, own, part in self.parts(here.point)})

    def solve_scale_and_offset(self, point: np.ndarray) -> Iterate:
        """Return a point with the best density scale and air offset of every recording."""
        found = {name: problem.solve_scale_and_offset(part) for name, problem, part in self.parts(point)}
        point = point.copy()
        for name, (part, _) in found.items():
            point[self.indices[name]] = part
        return self._iterate(point, {name: residuals for name, (_, residuals) in found.items()})

    def stepped(self, here: Iterate, step: np.ndarray) -> Iterate:
        """Return the point after a step within the bounds, with the best density scales and air offsets."""
        return self.solve_scale_and_offset(np.clip(here.point + step, self.low, self.high))

    def _iterate(self, point: np.ndarray, residuals: dict[str, list[np.ndarray]]) -> Iterate:
        total = sum(problem.chi_square(residuals[name], part) for name, problem, part in self.parts(point))
        return Iterate(point, residuals, total)

    def jacobians(self, here: Iterate) -> Jacobians:
        """Return the Jacobian of every recording, by finite differences."""
        return {name: problem.jacobian(part, here.residuals[name]) for name, problem, part in self.parts(here.point)}

    def inherited_jacobians(self, here: Iterate) -> Jacobians | None:
        """Return Jacobians with derivatives of the fits from which all recordings begin; None if one has none."""
        found = {name: own.inherited_jacobian(part, here.residuals[name]) for name, own, part in self.parts(here.point)}
        return None if None in found.values() else found

    def updated(self, jacobians: Jacobians, here: Iterate, there: Iterate) -> Jacobians:
        """Return Jacobians after Broyden's update for a step."""
        return {
            name: updated(
                jacobians[name], (after - before) / problem.steps, here.residuals[name], there.residuals[name]
            )
            for (name, problem, before), (_, _, after) in zip(
                self.parts(here.point), self.parts(there.point), strict=True
            )
        }

    def normal(self, jacobians: Jacobians, here: Iterate) -> tuple[np.ndarray, np.ndarray]:
        """Return the joint information matrix, and the gradient of minus half of chi-square."""
        size = len(self.low)
        information, gradient = np.zeros((size, size)), np.zeros(size)
        for name, problem, part in self.parts(here.point):
            own = self.indices[name]
            block, slope = problem.normal(jacobians[name], part, here.residuals[name])
            information[np.ix_(own, own)] += block
            gradient[own] += slope
        return information, gradient


def solve(problem: JointProblem, start: Iterate, compared: bool = False, needed: float = np.inf) -> Solution:
    """Minimize chi-square from a start.

    A Jacobian by finite differences costs one prediction per number. With Broyden's updates it stays in use as long as
    steps gain about as much as it predicts.

    Parameters
    ----------
    compared : bool, optional
        Whether the result is only compared with others, so that it may end earlier (COMPARED).
    needed : float, optional
        Chi-square above which the result does not matter (HOPE).
    """
    here, jacobians, damping, as_expected = start, problem.inherited_jacobians(start), 0.0, False
    small_steps, stalled = 0, False
    for iteration in range(ITERATIONS):
        fresh = jacobians is None
        if fresh:
            jacobians = problem.jacobians(here)
        information, gradient = problem.normal(jacobians, here)
        before, excess = here.chi_square, here.chi_square - problem.count
        if fresh and iteration >= HOPELESS_AFTER and before > needed and not problem.patterned:
            step = bounded_step(information, gradient, here.point, problem.low, problem.high)
            hopeless = before - HOPE * _decrease(information, gradient, step) > needed
            if hopeless and not problem.needs_new_corrections(here):
                return Solution(here.point, here.residuals, before, information, 0.0)
        enough = max(CONVERGED, CONVERGED_SHARE * excess, min(COMPARED_SHARE * excess, COMPARED if compared else 0.0))
        step = _step(problem, here, information, gradient, damping, enough, fresh)
        damping = step.damping
        if step.reached is not None:
            jacobians = problem.updated(jacobians, here, step.reached)
            here = problem.follow(step.reached)
        gained = before - here.chi_square
        converged = step.expected < enough and (fresh or as_expected)
        if not converged:
            as_expected = AS_EXPECTED[0] * step.expected < gained < AS_EXPECTED[1] * step.expected
            if problem.patterned:
                smooth, here = problem.smooth, problem.recompute(here.point)
                as_expected = as_expected and problem.smooth == smooth
            slow = damping >= HIGH_DAMPING or gained < AS_EXPECTED[0] * step.expected
            if gained >= SMALL_GAIN or (fresh and not slow):
                small_steps = 0
            elif fresh:
                small_steps += 1
            stalled = small_steps >= SMALL_STEPS
            converged = stalled or (gained < enough and fresh)
        # The shrinkage of a gain pattern is estimated in turn with the numbers: corrections do not wait for it.
        corrected = (converged or problem.patterned) and problem.needs_new_corrections(here)
        if converged and not corrected:
            break
        if corrected:
            here, small_steps, stalled = problem.recompute(here.point), 0, False
        if corrected or not as_expected:
            jacobians = None
    predicted_decrease = step.predicted_decrease if fresh and converged and (stalled or not gained) else 0.0
    return Solution(here.point, here.residuals, here.chi_square, information if fresh else None, predicted_decrease)


@dataclass(frozen=True)
class _Step:
    """A step: the point reached (None: no step lowers chi-square), predicted gains with and without damping."""

    reached: Iterate | None
    expected: float
    predicted_decrease: float
    damping: float


def _step(problem: JointProblem, here: Iterate, information, gradient, damping, enough, fresh) -> _Step:
    """Take a step within the bounds that lowers chi-square, with more damping while none does.

    A step that gains more than predicted is doubled while chi-square falls. Where residuals are large, the squared
    derivatives overestimate the curvature, and steps along a valley are too short.
    """
    predicted_decrease = 0.0
    while True:
        damped = information + damping * np.diag(np.diag(information))
        step = bounded_step(damped, gradient, here.point, problem.low, problem.high)
        expected = _decrease(information, gradient, step)
        predicted_decrease = predicted_decrease or expected
        if expected < enough:
            return _Step(None, expected, predicted_decrease, damping)
        reached = problem.stepped(here, step)
        if reached.chi_square <= here.chi_square:
            while here.chi_square - reached.chi_square > AS_EXPECTED[1] * expected:
                step = 2 * step
                farther = problem.stepped(here, step)
                if not farther.chi_square < reached.chi_square:  # also if it is not a number
                    break
                reached = farther
            return _Step(reached, expected, predicted_decrease, damping / DAMPING if damping > LEAST_DAMPING else 0.0)
        damping = max(LEAST_DAMPING, damping * DAMPING)
        if damping > MOST_DAMPING or not fresh:  # an updated Jacobian is computed again first
            return _Step(None, expected, predicted_decrease, damping)


def _decrease(information: np.ndarray, gradient: np.ndarray, step: np.ndarray) -> float:
    """Return the decrease of chi-square that derivatives predict for a step."""
    return float(2 * gradient @ step - step @ information @ step)


def joint_indices(problems: Mapping[str, Problem], protocols: Mapping[str, str]) -> dict[str, np.ndarray]:
    """Return the positions of each recording's numbers in a joint point, by recording."""
    numbered: dict[tuple[str, str, str], int] = {}
    return {
        name: np.array([numbered.setdefault(key, len(numbered)) for key in _keys(problem, name, protocols[name])])
        for name, problem in problems.items()
    }


def _keys(problem: Problem, name: str, protocol: str) -> Iterator[tuple[str, str, str]]:
    """Yield a key of each number: effect, parameter and owner. Numbers with the same key are shared."""
    for unknown in problem.unknowns:
        yield unknown.effect, unknown.name, unknown.owner(name, protocol)
    for nuisance in problem.nuisances:
        yield "alignment", nuisance.name, name
