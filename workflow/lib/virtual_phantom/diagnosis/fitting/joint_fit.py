"""Fits of several recordings of one scanner: its physics is shared, alignment is each recording's own.

Between them stand numbers that the recordings of one protocol share: a tube voltage, say. The normal equations have the
form of an arrow: a block of shared numbers, and one of the alignment for each recording that touches no other's.
"""

from __future__ import annotations

import copy
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ...base.errors import InputError
from ...physics.effect import OF_PROTOCOL, OF_SCANNER, load, of_one_scan
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
from .steps import Known, bounded_step, standard_errors, updated

NOT_OF_SCAN = (OF_SCANNER, OF_PROTOCOL)


@dataclass(frozen=True)
class JointFit:
    """What was fitted to all recordings together.

    Attributes
    ----------
    effects : tuple of str
        In the order in which they were given.
    physics, errors : dict of str to dict of str to float
        {effect: {parameter: value or standard error}}, shared by all recordings. In `physics`, parameters of one scan
        are neutral, those of one protocol of several are those of the first recording; in `errors` neither is.
    chi_square : float
        Of all data that were fitted, and of the Gaussian knowledge.
    free : int
        Number of effects' parameters, those of one scan counted in every recording, of one protocol in every protocol.
    fits : dict of str to Fit
        By recording, with its own alignment, and its own values of parameters of one scan or protocol.
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
    protocols : mapping of str to str, optional
        The protocol of each recording; those without one have one in common.

    Attributes
    ----------
    protocols : dict of str to str
        Of every recording.

    Raises
    ------
    InputError
        For fewer than one recording.
    """

    def __init__(self, fitters: Mapping[str, Fitter], protocols: Mapping[str, str] | None = None):
        if not fitters:
            raise InputError("a joint fit needs a recording; there is none")
        self.fitters = dict(fitters)
        self.protocols = {name: (protocols or {}).get(name, "") for name in self.fitters}

    def whole(self, effects: tuple[str, ...]) -> tuple[str, ...]:
        """What is declared of the scanner, and these effects."""
        return next(iter(self.fitters.values())).model.whole(effects)

    def without(self, names: Collection[str]) -> JointFitter:
        """The same without some recordings."""
        return JointFitter({name: one for name, one in self.fitters.items() if name not in names}, self.protocols)

    def fit(self, effects: tuple[str, ...], given: JointFit | None = None) -> JointFit:
        """Refit all parameters of these effects, and the alignment of every recording.

        With a new effect it begins where the first recording of each protocol alone ends, whose fit tries every start.

        Parameters
        ----------
        given : JointFit, optional
            Where to begin; it may hold further recordings.

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
            alone: dict[str, Fit] = {}
            for name, fit in begun.items():
                if (protocol := self._protocol(name, effects)) not in alone:
                    alone[protocol] = self.fitters[name].fit(effects, fit)
                begun[name] = replace(fit, effects=effects, physics=alone[protocol].physics)
        problems = {name: Problem(self.fitters[name], effects, fit) for name, fit in begun.items()}
        return JointProblem(problems, self.protocols).solved()

    def left_out(self, names: Collection[str], effects: tuple[str, ...], given: JointFit) -> dict[str, Fit]:
        """Recordings held against physics that was fitted to the others.

        Of each only its alignment is fitted, and parameters of one scan; those of its protocol too, where none of the
        others is of it. What is declared of the scanner is as the others have it, too.

        Parameters
        ----------
        names : collection of str
            Of the recordings.
        given : JointFit
            Where to begin.

        Returns
        -------
        dict of str to Fit
            By recording.
        """
        if not self.whole(effects):
            return {name: given.fits[name] if not given.effects else self.fitters[name].fit(()) for name in names}
        others = self.without(names).fit(effects, given)
        return self.held(others, {name: given.fits[name] for name in names})

    def held(self, others: JointFit, begun: Mapping[str, Fit]) -> dict[str, Fit]:
        """Recordings held against physics that was fitted to others, as `left_out`.

        Parameters
        ----------
        others : JointFit
            Of recordings of this fitter that are not among `begun`.
        begun : mapping of str to Fit
            By recording, where to begin.

        Returns
        -------
        dict of str to Fit
            By recording.
        """
        rest = self.without([name for name in self.fitters if name not in others.fits])
        return {name: self._held(name, one, rest, others) for name, one in begun.items()}

    def _held(self, name: str, begun: Fit, rest: JointFitter, others: JointFit) -> Fit:
        """One recording held against a fit of others."""
        fitter, effects = self.fitters[name], others.effects
        alike = [other for other in rest.fitters if rest.protocols[other] == self.protocols[name]]
        known = NOT_OF_SCAN if alike else (OF_SCANNER,)
        one = others.fits[(alike or list(rest.fitters))[0]]
        held = fitter.of(copy.copy(fitter.model))
        whole = self.whole(effects)
        held.model.fixed = {effect: those(known, effect, one.physics[effect]) for effect in whole}
        physics = {
            effect: others.physics[effect] | begun.physics.get(effect, {}) | held.model.fixed[effect]
            for effect in whole
        }
        fit = held.fit(effects, replace(begun, effects=effects, physics=physics))
        errors = {effect: fit.errors[effect] | those(known, effect, one.errors[effect]) for effect in whole}
        return replace(fit, errors=errors, directions=one.directions)

    def _protocol(self, name: str, effects: tuple[str, ...]) -> str:
        """Of a recording, where one of these effects has parameters of a protocol."""
        own = any(one.belongs_to == OF_PROTOCOL for effect in effects for one in load(effect).parameters)
        return self.protocols[name] if own else ""

    def _begun(self, name: str, effects: tuple[str, ...], given: JointFit | None) -> Fit:
        if given is not None and name in given.fits:
            return given.fits[name]
        return self.fitters[name].fit(())


class JointProblem:
    """One choice of effects for several recordings: Levenberg and Marquardt's method with Broyden's updates.

    As Fitter.fit has it for one recording; a point has the shared numbers and the alignments one after the other.

    Numbers of the effects are shared by all recordings, by those of a protocol, or by none, as their parameters are.

    Parameters
    ----------
    problems : mapping of str to Problem
        By recording, of the same effects. Their bounds and what they know of shared numbers are made common.
    protocols : mapping of str to str
        Of every recording.

    Attributes
    ----------
    places : dict of str to ndarray of int, shape (numbers,)
        Of every recording, where its numbers stand in a point; those of the first come first.
    several : bool
        Whether they are of more than one protocol.
    """

    def __init__(self, problems: Mapping[str, Problem], protocols: Mapping[str, str]):
        self.problems = dict(problems)
        self.places = places_of(problems, protocols)
        places = np.concatenate(list(self.places.values()))
        times = np.bincount(places)
        # What one scan could show limits nobody else's, and what is known of a number is known once.
        self.low, self.high = np.full(len(times), np.inf), np.full(len(times), -np.inf)
        np.minimum.at(self.low, places, np.concatenate([one.low for _, one in self._items()]))
        np.maximum.at(self.high, places, np.concatenate([one.high for _, one in self._items()]))
        for name, one in self._items():
            where = self.places[name]
            one.low, one.high = self.low[where], self.high[where]
            one.knowledge = one.knowledge / times[where]
        self.count = sum(one.count for one in self.problems.values())
        self.several = len({protocols[name] for name in self.problems}) > 1

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
            strayed = settled and any([one.needs_new_corrections(points[name]) for name, one in self._items()])
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
        return self._result(points, residuals, current, information)

    def _items(self):
        return self.problems.items()

    def _begin(self):
        for one in self.problems.values():
            one.follow(np.clip(one.start, one.low, one.high))
        start = {name: np.clip(one.start, one.low, one.high) for name, one in self._items()}
        return self._polished(self._whole(start))

    def _whole(self, points: Mapping[str, np.ndarray]) -> np.ndarray:
        whole = np.empty(len(self.low))
        for name in reversed(points):  # what is shared is as the first one has it
            whole[self.places[name]] = points[name]
        return whole

    def _polished(self, whole: np.ndarray) -> tuple[dict[str, np.ndarray], dict[str, list[np.ndarray]]]:
        made = {name: one.solve_scale_and_offset(whole[self.places[name]], None) for name, one in self._items()}
        return {name: point for name, (point, _) in made.items()}, {name: left for name, (_, left) in made.items()}

    def _residuals(self, points: Mapping[str, np.ndarray]) -> dict[str, list[np.ndarray]]:
        return {name: one.residuals(points[name], None) for name, one in self._items()}

    def _total(self, points: Mapping[str, np.ndarray], residuals: Mapping[str, list[np.ndarray]]) -> float:
        return sum(one.chi_square(residuals[name], points[name]) for name, one in self._items())

    def _normal(self, jacobians, points, residuals) -> tuple[np.ndarray, np.ndarray]:
        """The arrow's matrix, whole, and its gradient."""
        size = len(self.low)
        information, gradient = np.zeros((size, size)), np.zeros(size)
        for name, one in self._items():
            index = self.places[name]
            part, slope = one.normal(jacobians[name], points[name], residuals[name])
            information[np.ix_(index, index)] += part
            gradient[index] += slope
        return information, gradient

    def _result(self, points, residuals, total, information) -> JointFit:
        errors, root, fits = standard_errors(information), Known.of(information).root, {}
        for name, one in self._items():
            own_total = one.chi_square(residuals[name], points[name])
            fit = one.result(points[name], errors[self.places[name]], residuals[name], own_total, None)
            rows: dict[str, dict[str, list[float]]] = {}
            for unknown, place in zip(one.unknowns, self.places[name], strict=False):
                rows.setdefault(unknown.effect, {})[unknown.name] = root[place].tolist()
            fits[name] = replace(fit, directions=rows)
        first = next(iter(fits.values()))
        physics = {name: {**values, **of_one_scan(name)} for name, values in first.physics.items()}
        common = (OF_SCANNER,) if self.several else NOT_OF_SCAN
        known = {name: those(common, name, values) for name, values in first.errors.items()}
        free = len(self.low) - sum(len(one.aligned) for one in self.problems.values())
        return JointFit(first.effects, physics, known, total, free, fits)


def those(owners: Collection[str], name: str, values: Mapping[str, float]) -> dict[str, float]:
    """Of an effect's parameters, or of their errors, those that belong to one of these.

    Parameters
    ----------
    owners : collection of {"scanner", "protocol", "scan"}
    name : str
        Of the effect.
    values : mapping of str to float
        By parameter.
    """
    own = {one.name for one in load(name).parameters if one.belongs_to in owners}
    return {key: value for key, value in values.items() if key in own}


def places_of(problems: Mapping[str, Problem], protocols: Mapping[str, str]) -> dict[str, np.ndarray]:
    """Where the numbers of recordings stand among those of all; those of the first come first.

    Parameters
    ----------
    problems : mapping of str to Problem
        By recording, of the same effects.
    protocols : mapping of str to str
        Of every recording.

    Returns
    -------
    dict of str to ndarray of int, shape (numbers,)
    """
    numbered: dict[tuple[str, str, str], int] = {}
    return {
        name: np.array([numbered.setdefault(key, len(numbered)) for key in _owned(one, name, protocols[name])])
        for name, one in problems.items()
    }


def _owned(problem: Problem, name: str, protocol: str) -> Iterator[tuple[str, str, str]]:
    """Of every number of a recording, what it is and whose: two that are alike in that are one."""
    for one in problem.unknowns:
        yield one.effect, one.name, one.owner(name, protocol)
    for nuisance in problem.aligned:
        yield "alignment", nuisance.name, name
