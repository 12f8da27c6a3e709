"""Fits of several recordings of one scanner: its physics is shared, alignment is each recording's own.

The normal equations have the form of an arrow: a block of shared numbers, and one of the alignment for each recording
that touches no other's.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ...base.errors import InputError
from ...physics.effect import load, of_one_scan
from .fit import (
    AS_EXPECTED,
    CONVERGED,
    CONVERGED_SHARE,
    DAMPING,
    ITERATIONS,
    LEAST_DAMPING,
    MOST_DAMPING,
    Fit,
    Fitter,
    Problem,
)
from .steps import bounded_step, standard_errors, updated


@dataclass(frozen=True)
class JointFit:
    """What was fitted to all recordings together.

    Attributes
    ----------
    effects : tuple of str
        In the order in which they were given.
    physics, errors : dict of str to dict of str to float
        {effect: {parameter: value or standard error}}, shared by all recordings. Parameters of one scan are neutral in
        `physics` and not in `errors`.
    chi_square : float
        Of all data that were fitted, and of the Gaussian knowledge.
    free : int
        Number of effects' parameters, those of one scan counted in every recording.
    fits : dict of str to Fit
        By recording, with its own alignment, and its own values of parameters of one scan.
    """

    effects: tuple[str, ...]
    physics: dict[str, dict[str, float]]
    errors: dict[str, dict[str, float]]
    chi_square: float
    free: int
    fits: dict[str, Fit]


class JointFitter:
    """Fits and scores of models of several recordings.

    Parameters
    ----------
    fitters : mapping of str to Fitter
        By recording.

    Raises
    ------
    InputError
        For fewer than one recording.
    """

    def __init__(self, fitters: Mapping[str, Fitter]):
        if not fitters:
            raise InputError("a joint fit needs a recording; there is none")
        self.fitters = dict(fitters)

    def whole(self, effects: tuple[str, ...]) -> tuple[str, ...]:
        """What is declared of the scanner, and these effects."""
        return next(iter(self.fitters.values())).model.whole(effects)

    def without(self, name: str) -> JointFitter:
        """The same without one recording."""
        return JointFitter({other: one for other, one in self.fitters.items() if other != name})

    def fit(self, effects: tuple[str, ...], given: JointFit | None = None) -> JointFit:
        """Refit all parameters of these effects, and the alignment of every recording.

        With a new effect it begins where the first recording alone ends, whose fit tries every start.

        Parameters
        ----------
        effects : tuple of str
        given : JointFit, optional
            Where to begin; it may hold further recordings.

        Returns
        -------
        JointFit

        Raises
        ------
        InputError
            For a gain pattern, which belongs to one scan.
        """
        for name in effects:
            if load(name).pattern:
                raise InputError(f"{name} has one unknown per detector pixel of one scan; recordings cannot share it")
        begun = {name: self._begun(name, effects, given) for name in self.fitters}
        if given is None or set(effects) - set(given.effects):
            first = next(iter(self.fitters))
            alone = self.fitters[first].fit(effects, begun[first])
            begun = {name: replace(fit, effects=effects, physics=alone.physics) for name, fit in begun.items()}
        return JointProblem({name: Problem(self.fitters[name], effects, fit) for name, fit in begun.items()}).solved()

    def left_out(self, name: str, effects: tuple[str, ...], given: JointFit) -> Fit:
        """A recording held against physics that was fitted to the others.

        Only its alignment is fitted, and parameters of one scan.

        Parameters
        ----------
        name : str
            Of the recording.
        effects : tuple of str
        given : JointFit
            Where to begin.

        Returns
        -------
        Fit
        """
        fitter = self.fitters[name]
        if not effects:
            return given.fits[name] if not given.effects else fitter.fit(())
        others = self.without(name).fit(effects, given)
        held = fitter.of(copy.copy(fitter.model))
        held.model.fixed = {effect: shared(effect, others.physics[effect]) for effect in effects}
        begun = {effect: given.fits[name].physics[effect] | held.model.fixed[effect] for effect in effects}
        fit = held.fit(effects, replace(given.fits[name], effects=effects, physics=others.physics | begun))
        return replace(fit, errors=fit.errors | {name: fit.errors[name] | others.errors[name] for name in effects})

    def _begun(self, name: str, effects: tuple[str, ...], given: JointFit | None) -> Fit:
        if given is not None and name in given.fits:
            return given.fits[name]
        return self.fitters[name].fit(())


class JointProblem:
    """One choice of effects for several recordings: Levenberg and Marquardt's method with Broyden's updates.

    As Fitter.fit has it for one recording; a point has the shared numbers and the alignments one after the other.

    The shared ones are those of the effects, but for parameters of one scan.

    Parameters
    ----------
    problems : mapping of str to Problem
        By recording, of the same effects. Their bounds and what they know of shared numbers are made common.

    Attributes
    ----------
    problems : dict of str to Problem
    """

    def __init__(self, problems: Mapping[str, Problem]):
        self.problems = dict(problems)
        every = list(self.problems.values())
        own = np.array([one.name in of_one_scan(one.effect) for one in every[0].unknowns], bool)
        # Where numbers stand in the points of the recordings: the shared ones are alike, and there may be fewer others.
        self._shared = np.flatnonzero(~own)
        self._own = {
            name: np.concatenate([np.flatnonzero(own), np.arange(len(own), len(one.start))])
            for name, one in self.problems.items()
        }
        # What one scan could show limits nobody else's, and what is known of a number is known once.
        low = np.min([one.low[self._shared] for one in every], axis=0)
        high = np.max([one.high[self._shared] for one in every], axis=0)
        for one in every:
            one.low[self._shared], one.high[self._shared] = low, high
            one.knowledge[self._shared] /= len(every)
        self.low = self._whole({name: one.low for name, one in self._items()})
        self.high = self._whole({name: one.high for name, one in self._items()})
        self.count = sum(one.count for one in every)

    def solved(self) -> JointFit:
        """The fit."""
        points, residuals = self._begin()
        jacobians: dict[str, list[np.ndarray]] | None = None
        current, damping, as_expected = self._total(points, residuals), 0.0, False
        for _ in range(ITERATIONS):
            fresh = jacobians is None
            if fresh:
                jacobians = {name: one.jacobian(points[name], residuals[name], None) for name, one in self._items()}
            information, gradient = self._normal(jacobians, points, residuals)
            before, enough = current, max(CONVERGED, CONVERGED_SHARE * (current - self.count))
            whole = self._whole(points)
            while True:
                damped = information + damping * np.diag(np.diag(information))
                step = bounded_step(damped, gradient, whole, self.low, self.high)
                expected = float(2 * gradient @ step - step @ information @ step)
                if expected < enough:
                    break
                trial, tried = self._polished(np.clip(whole + step, self.low, self.high))
                reached = self._total(trial, tried)
                if reached <= current:
                    jacobians = {
                        name: updated(
                            jacobians[name], (trial[name] - points[name]) / one.steps, residuals[name], tried[name]
                        )
                        for name, one in self._items()
                    }
                    points, residuals, current = trial, tried, reached
                    moved = [one.follow(points[name]) for name, one in self._items()]
                    if any(moved):
                        residuals = self._residuals(points)
                        current = self._total(points, residuals)
                    damping = damping / DAMPING if damping > LEAST_DAMPING else 0.0
                    break
                damping = max(LEAST_DAMPING, damping * DAMPING)
                if damping > MOST_DAMPING or not fresh:
                    break
            gained = before - current
            settled = expected < enough and (fresh or as_expected)
            if not settled:
                as_expected = AS_EXPECTED[0] * expected < gained < AS_EXPECTED[1] * expected
                settled = gained < enough and fresh
            strayed = settled and any([one.strays(points[name]) for name, one in self._items()])
            if settled and not strayed:
                break
            if strayed:
                residuals = self._residuals(points)
                current = self._total(points, residuals)
            if strayed or not as_expected:
                jacobians = None
        if not fresh:  # updates serve the next step: of numbers that moved far, slopes may be off by far
            jacobians = {name: one.jacobian(points[name], residuals[name], None) for name, one in self._items()}
            information, _ = self._normal(jacobians, points, residuals)
        return self._result(points, residuals, current, standard_errors(information))

    def places(self) -> list[np.ndarray]:
        """Of every recording, where its numbers stand in a point."""
        found, first = [], len(self._shared)
        for own in self._own.values():
            places = np.empty(len(self._shared) + len(own), int)
            places[self._shared], places[own] = np.arange(len(self._shared)), first + np.arange(len(own))
            found.append(places)
            first += len(own)
        return found

    def _items(self):
        return self.problems.items()

    def _begin(self):
        for one in self.problems.values():
            one.follow(np.clip(one.start, one.low, one.high))
        start = {name: np.clip(one.start, one.low, one.high) for name, one in self._items()}
        return self._polished(self._whole(start))

    def _whole(self, points: Mapping[str, np.ndarray]) -> np.ndarray:
        first = next(iter(points.values()))[self._shared]
        return np.concatenate([first, *(point[self._own[name]] for name, point in points.items())])

    def _polished(self, whole: np.ndarray) -> tuple[dict[str, np.ndarray], dict[str, list[np.ndarray]]]:
        made = {
            name: one.polished(whole[places], None)
            for (name, one), places in zip(self._items(), self.places(), strict=True)
        }
        return {name: point for name, (point, _) in made.items()}, {name: left for name, (_, left) in made.items()}

    def _residuals(self, points: Mapping[str, np.ndarray]) -> dict[str, list[np.ndarray]]:
        return {name: one.residuals(points[name], None) for name, one in self._items()}

    def _total(self, points: Mapping[str, np.ndarray], residuals: Mapping[str, list[np.ndarray]]) -> float:
        return sum(one.chi_square(residuals[name], points[name]) for name, one in self._items())

    def _normal(self, jacobians, points, residuals) -> tuple[np.ndarray, np.ndarray]:
        """The arrow's matrix, whole, and its gradient."""
        size = len(self.low)
        information, gradient = np.zeros((size, size)), np.zeros(size)
        for (name, one), index in zip(self._items(), self.places(), strict=True):
            part, slope = one.normal(jacobians[name], points[name], residuals[name])
            information[np.ix_(index, index)] += part
            gradient[index] += slope
        return information, gradient

    def _result(self, points, residuals, total, errors) -> JointFit:
        fits = {}
        for (name, one), places in zip(self._items(), self.places(), strict=True):
            own_total = one.chi_square(residuals[name], points[name])
            fits[name] = one.result(points[name], errors[places], residuals[name], own_total, None)
        first = next(iter(fits.values()))
        physics = {name: {**values, **of_one_scan(name)} for name, values in first.physics.items()}
        known = {name: shared(name, values) for name, values in first.errors.items()}
        free = len(self.low) - sum(len(one.aligned) for one in self.problems.values())
        return JointFit(first.effects, physics, known, total, free, fits)


def shared(name: str, values: Mapping[str, float]) -> dict[str, float]:
    """What recordings share of an effect's parameters, or of their errors."""
    own = of_one_scan(name)
    return {key: value for key, value in values.items() if key not in own}
