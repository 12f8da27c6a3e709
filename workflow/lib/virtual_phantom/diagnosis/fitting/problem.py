"""Least-squares problem of one recording: unknowns, prior knowledge, residuals and derivatives."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from types import MappingProxyType

import numpy as np

from ...physics.effect import FOCAL_SPOT, GEOMETRY, MOTION, load
from ..noise.gain_pattern import Pattern
from .linearization import LinearizationPoint
from .nuisance import POSES, Nuisance
from .steps import bounded_step

MOST_CORRECTIONS = 3  # maximum of recomputations of numerical errors in a fit, each after convergence
# Further starts after a fit has stalled: distances from its end, as shares of the range.
FARTHER = (-0.5, -0.1, 0.1, 0.5)
# Finite differences: shares of the plausible range and of a nuisance parameter's standard deviation. Path lengths are
# in single precision, so that smaller steps would measure rounding.
STEP, ALIGNMENT_STEP = 2e-3, 4e-3
# The same by stage, for parameters that displace rays or the object. Size, scale and position compensate for nine
# tenths of their effect. With steps eight times as large, derivatives had errors of 3 to 5 %, and fits of source
# distances ended 3 to 24 above the minimum of chi-square.
MOVING_STEPS = {GEOMETRY: 2.5e-4, MOTION: 2.5e-4, FOCAL_SPOT: 2e-3}
# Factor of the linear range for derivatives by these and by the pose, so that all use the same traced rays. A blur
# has no derivative of first order, so the range of its rays is not extended.
SLOPE_REACH = 2.0
UNKNOWN_STEP = 1e-3  # of a nuisance parameter without prior knowledge
SIZE_STEP = 4e-5  # 4 um at 100 mm, as for positions
MOST_CACHED_BYTES = 1e8  # larger Jacobians are not cached


class Problem:
    """Unknowns of one set of effects for one recording, their priors, and their residuals.

    A point is a vector of the effects' variables (`unknowns`) followed by the nuisance parameters (`nuisances`); both
    are called numbers below.

    Parameters
    ----------
    fitter : Fitter
        Model, data and weights.
    given : Fit or None
        Fit whose parameters are the starting point.
    beside : str, optional
        A further effect that is not fitted but changes the priors of the nuisance parameters.

    Attributes
    ----------
    start, low, high : ndarray, shape (numbers,)
        Starting point and bounds.
    center, prior_precision : ndarray, shape (numbers,)
        Means of the Gaussian priors, and their inverse variances (0: no prior).
    steps : ndarray, shape (numbers,)
        Steps of finite differences.
    pattern : Pattern or None
        Pattern of pixels that the fitted data may contain. Residuals and derivatives lose what it absorbs.
    """

    def __init__(self, fitter, effects: tuple[str, ...], given=None, beside: str | None = None):
        self.fitter, self.effects = fitter, tuple(effects)
        self.model, self.data, self.weights = fitter.model, fitter.data, fitter.weights
        self._given, given = given, given or self.model.first
        gains = any(load(name).pattern for name in effects)
        # A pixel has one constant: a gain, or else the deviation of its dark signal.
        self.uneven = self.data.of_pixels and not gains and any(load(name).uneven for name in effects)
        self.patterned = gains or self.uneven
        self.pattern: Pattern | None = given.pattern if given is not None and given.effects == self.effects else None
        self.linearization, self.linearized = self.model.nominal if given is None else given.linearization, 0
        self.all_effects = self.model.with_declared_effects(self.effects)
        self.unknowns = self.model.unknowns(self.all_effects)
        self.nuisances = self.model.nuisances_for(self.effects if beside is None else (*self.effects, beside))
        self.fresh = [given is None or unknown.effect not in given.physics for unknown in self.unknowns]
        values = [
            unknown.start if fresh else unknown.of(given.physics[unknown.effect][unknown.name])
            for unknown, fresh in zip(self.unknowns, self.fresh, strict=True)
        ]
        aligned = self.nuisances
        nuisance = {number.name: number.expected for number in aligned} | ({} if given is None else given.nuisance)
        start = np.array([*values, *(nuisance[number.name] for number in aligned)], float)
        ends = [*((unknown.low, unknown.high) for unknown in self.unknowns), *(number.bounds for number in aligned)]
        self.low, self.high = np.array(ends).T.copy()
        self.start = np.clip(start, self.low, self.high)
        self.count = sum(int((weight > 0).sum()) for weight in self.weights)
        self.center = np.array([number.expected for number in (*self.unknowns, *aligned)])
        width = np.array([number.sd for number in (*self.unknowns, *aligned)])
        self.prior_precision = np.where(np.isfinite(width), 1 / width**2, 0)
        spans = [
            (MOVING_STEPS[load(unknown.effect).stage] if unknown.moves else STEP) * (unknown.high - unknown.low)
            for unknown in self.unknowns
        ]
        self.steps = np.array(spans + [nuisance_step(number) for number in aligned])
        self.moving = [unknown.moves for unknown in self.unknowns] + [number.name in POSES for number in aligned]

    @classmethod
    def at(cls, fitter, fit, beside: str | None = None) -> Problem:
        """Return the problem that a fit has solved, beginning where the fit ended."""
        return cls(fitter, fit.effects, fit, beside)

    def of_held_out(self) -> Problem:
        """Return the same problem on the held-out data, which do not change the gain pattern."""
        found = copy.copy(self)
        found.data, found.weights, found.pattern = self.fitter.held_out, self.fitter.held_weights, None
        return found

    def best_start(self) -> np.ndarray:
        """Return the best starting point, shape (numbers,).

        All starts of new effects are tried, with the given and with the expected nuisance parameters, because a fit
        from a single start may end in a local minimum.
        """
        count = len(self.unknowns)
        choices = [
            unknown.starts if fresh else (value,)
            for unknown, fresh, value in zip(self.unknowns, self.fresh, self.start, strict=False)
        ]
        if all(len(choice) == 1 for choice in choices):
            return self.start
        faint = any(self._new_strengths())
        tried = []
        expected = tuple(number.expected for number in self.nuisances)
        for nuisance in dict.fromkeys((tuple(self.start[count:]), expected)):
            full = [self.solve_scale_and_offset(np.array([*values, *nuisance])) for values in product(*choices)]
            tried += full
            if faint:
                off = self.solve_scale_and_offset(self._switched_off(np.array([*self.start[:count], *nuisance])))
                tried += [self._between(off, on) for on in full]
        return min(tried, key=lambda solved: self.chi_square(solved[1], solved[0]))[0]

    def _new_strengths(self) -> list[bool]:
        """Return for each unknown whether its effect is new and changes the data steadily from its neutral value."""
        return [
            fresh and unknown.neutral is not None and not unknown.parameter.periodic
            for unknown, fresh in zip(self.unknowns, self.fresh, strict=True)
        ]

    def _switched_off(self, point: np.ndarray) -> np.ndarray:
        """Return a point with new effects at their neutral values, where they have any."""
        point = point.copy()
        for index, new in enumerate(self._new_strengths()):
            if new:
                point[index] = self.unknowns[index].neutral
        return point

    def _between(
        self, off: tuple[np.ndarray, list[np.ndarray]], full: tuple[np.ndarray, list[np.ndarray]]
    ) -> tuple[np.ndarray, list[np.ndarray]]:
        """Return the best point between two, and its residuals, assuming that residuals change linearly.

        `off` and `full` have new effects off or at full strength. Without this interpolation, starts with far too high
        a strength would be ranked by how little they worsen the fit.
        """
        change = [here - there for here, there in zip(off[1], full[1], strict=True)]
        square = chi_square(self.weights, change)
        if not square:
            return full
        along = sum(float((w * r * c).sum()) for w, r, c in zip(self.weights, off[1], change, strict=True))
        point = full[0].copy()
        for index, new in enumerate(self._new_strengths()):
            if new:
                point[index] = off[0][index] + along / square * (full[0][index] - off[0][index])
        return self.solve_scale_and_offset(np.clip(point, self.low, self.high))

    def farther(self, fit) -> list:
        """Return starts for a fit that has stalled: new geometry parameters are displaced, the others stay as fitted.

        Chi-square has narrow valleys along which geometry and pose compensate each other. Discretization errors make
        these valleys rough.
        """
        found = []
        for index, new in enumerate(self._new_strengths()):
            unknown = self.unknowns[index]
            if not new or load(unknown.effect).stage != GEOMETRY:
                continue
            here = unknown.of(fit.physics[unknown.effect][unknown.name])
            numbers = [here + share * (self.high[index] - self.low[index]) for share in FARTHER]
            for number in dict.fromkeys(np.clip(numbers, self.low[index], self.high[index])):
                moved = fit.physics[unknown.effect] | {unknown.name: float(unknown.value(number))}
                found.append(replace(fit, physics=fit.physics | {unknown.effect: moved}))
        return found

    def needs_new_corrections(self, point: np.ndarray) -> bool:
        """Recompute numerical errors if a point is too far from where they were computed; return True if so."""
        if self.linearized == MOST_CORRECTIONS:
            return False
        physics, nuisance = self.named(point)
        prediction = self.model.predict(physics, nuisance, self.data, self.linearization)
        if not self.model.needs_relinearization(self.linearization.errors, nuisance, prediction, self.weights[0]):
            return False
        self.linearization = replace(self.linearization, errors=LinearizationPoint.of(physics, nuisance))
        self.linearized += 1
        return True

    def follow(self, point: np.ndarray) -> bool:
        """Trace the rays of a point if they are out of the linear range; return True if so."""
        physics, nuisance = self.named(point)
        if self.model.in_linear_range(physics, nuisance, self.linearization.rays):
            return False
        self.linearization = replace(self.linearization, rays=LinearizationPoint.of(physics, nuisance))
        return True

    def residuals(self, point: np.ndarray, reach: float = 1.0) -> list[np.ndarray]:
        """Return observed minus predicted data, by part, shape (data,), with whitened noise, beside a gain pattern."""
        prediction = self.model.predict(*self.named(point), self.data, replace(self.linearization, reach=reach))
        return self.beside_pattern(self.data.residuals(prediction))

    def beside_pattern(self, parts: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Return residuals or changes of the data, by part, less what a gain pattern absorbs (Pattern.absorbed)."""
        if self.pattern is None:
            return list(parts)
        return [self._less(self.pattern.absorbed, parts[0], parts[0]), *parts[1:]]

    def _less(self, constants: Callable, residual: np.ndarray, of: np.ndarray) -> np.ndarray:
        """Return a residual of the mean less constants of a gain pattern, a function of another residual."""
        fitted, shape = self.fitter.data, self.fitter.data.mean.shape
        found = constants(of.reshape(shape), self.fitter.weights[0].reshape(shape), fitted.pattern_sums)
        field = np.broadcast_to(self.pattern.over_data(fitted.pattern_field(found)), self.data.mean.shape)
        return residual - np.where(self.weights[0] > 0, field.ravel(), 0)

    def whitened(self, parts: Sequence[np.ndarray]) -> np.ndarray:
        """Return residuals or changes of the data, by part, in standard deviations, beside a gain pattern."""
        return whitened(self.beside_pattern(parts), self.weights)

    def named(self, point: np.ndarray) -> tuple[dict[str, dict[str, float]], dict[str, float]]:
        """Return a point as parameters by effect, and nuisance parameters by name."""
        physics = {name: self.model.known(name) for name in self.all_effects}
        for unknown, number in zip(self.unknowns, point, strict=False):
            physics[unknown.effect][unknown.name] = float(unknown.value(number))
        aligned = zip(self.nuisances, point[len(self.unknowns) :], strict=True)
        return physics, {number.name: float(value) for number, value in aligned}

    def solve_scale_and_offset(self, point: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        """Return a point with the best density scale, air offset and errors of the object, and its residuals by part.

        Predictions are linear in these, and they compensate for part of most effects. Without this step, fits converge
        slowly along narrow, curved valleys.
        """
        physics, nuisance = self.named(point)
        prediction = self.model.predict(physics, nuisance, self.data, self.linearization)
        residuals = self.beside_pattern(self.data.residuals(prediction))
        index = self.positions(("scale", "offset", *self.model.object_errors.names))
        changes = (self.data.whitened(column).ravel() for column in prediction.design)
        changes = (*changes, *self.model.object_errors.whitened(self.data))
        design, weight = np.stack([self.beside_pattern([change])[0] for change in changes]), self.weights[0]
        weighted = design * weight
        information = weighted @ design.T + np.diag(self.prior_precision[index])
        gradient = weighted @ residuals[0] + self.prior_precision[index] * (self.center[index] - point[index])
        step = bounded_step(information, gradient, point[index], self.low[index], self.high[index])
        point = point.copy()
        point[index] = np.clip(point[index] + step, self.low[index], self.high[index])
        return point, [np.where(weight > 0, residuals[0] - step @ design, 0), *residuals[1:]]

    def recompute_residuals(self, point: np.ndarray) -> list[np.ndarray]:
        """Estimate the gain pattern at a point if one is fitted, and return the residuals.

        A smooth part that once belonged to the pattern stays, as a search would not end if it came and went.
        """
        smooth, self.pattern = self.pattern is not None and self.pattern.smooth, None
        if not self.patterned:
            return self.residuals(point)
        prediction = self.model.predict(*self.named(point), self.data, self.linearization)
        residuals, shape = self.data.residuals(prediction), self.data.mean.shape
        per_constant = prediction.state.change_by_dark_signal() if self.uneven else None
        mean, weight = residuals[0].reshape(shape), self.weights[0].reshape(shape)
        self.pattern = self.data.pattern(mean, weight, smooth, per_constant)
        return self.beside_pattern(residuals)

    def chi_square(self, residuals: list[np.ndarray], point: np.ndarray) -> float:
        """Return chi-square of the residuals plus chi-square of the deviation of a point from the priors."""
        return chi_square(self.weights, residuals) + float((self.prior_precision * (point - self.center) ** 2).sum())

    def jacobian(
        self,
        point: np.ndarray,
        residuals: list[np.ndarray],
        known: Mapping[tuple[str, str], list[np.ndarray]] = MappingProxyType({}),
    ) -> list[np.ndarray]:
        """Return the change of predictions per step (`steps`) of every number, by part, shape (numbers, data).

        Columns that are `known`, by one of `keys`, are not computed.
        """
        columns = [
            known[key] if key in known else [step * part for part in self.derivative(index, point, residuals)]
            for index, (key, step) in enumerate(zip(self.keys, self.steps, strict=True))
        ]
        return [np.stack(parts) for parts in zip(*columns, strict=True)]

    def inherited_jacobian(self, point: np.ndarray, residuals: list[np.ndarray]) -> list[np.ndarray] | None:
        """Return `jacobian` with the columns of the given fit, if it has other effects and its Jacobian is cached.

        Only the columns of new effects are computed. Others change little; a search computes them again if steps gain
        less than they predict.
        """
        if self._given is None or self._given.effects == self.effects:
            return None
        before = Problem.at(self.fitter, self._given)
        if not before.is_cached:
            return None
        steps, parts, known = dict(zip(self.keys, self.steps, strict=True)), before.changes_at_start(), {}
        for index, key in enumerate(before.keys):
            if key in steps:
                share = steps[key] / before.steps[index]
                known[key] = self.beside_pattern([share * part[index] for part in parts])
        return self.jacobian(point, residuals, known)

    @property
    def keys(self) -> list[tuple[str, str]]:
        """Effect (empty for nuisance parameters) and name of every number."""
        unknowns = [(unknown.effect, unknown.name) for unknown in self.unknowns]
        return [*unknowns, *(("", number.name) for number in self.nuisances)]

    @property
    def is_cached(self) -> bool:
        """Whether `changes_at_start` is cached."""
        return 8 * len(self.start) * self.data.mean.size <= MOST_CACHED_BYTES

    def jacobian_at_start(self) -> list[np.ndarray]:
        """Return the Jacobian at the starting point."""
        return self._rows_beside_pattern(self.changes_at_start())

    def _rows_beside_pattern(self, rows: list[np.ndarray]) -> list[np.ndarray]:
        if self.pattern is None:
            return rows
        return [np.stack(parts) for parts in zip(*map(self.beside_pattern, zip(*rows, strict=True)), strict=True)]

    def changes_at_start(self) -> list[np.ndarray]:
        """Return the Jacobian at the starting point for a known gain pattern, from the cache unless it is large."""
        alone = copy.copy(self)
        alone.pattern = None

        def compute() -> list[np.ndarray]:
            return alone.jacobian(self.start, alone.residuals(self.start))

        if not self.is_cached:
            return compute()
        linearized = self.linearization.errors.key, self.linearization.rays.key
        held = self.data is self.fitter.held_out
        key = self.effects, held, linearized, tuple(array.tobytes() for array in (self.start, self.steps, self.high))
        return self.fitter.jacobians.get(key, compute)

    def changes_of_halves(self) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Return `changes_at_start` of the fitted and of the held-out data."""
        fitted = self.changes_at_start()
        if self.fitter.held_out.usable is self.data.usable:
            return fitted, fitted
        return fitted, self.of_held_out().changes_at_start()

    def jacobians_of_halves(self) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Return the Jacobians of the fitted and of the held-out data at the starting point.

        In held-out data, a gain pattern responds to the parameters, as it is estimated from the fitted data.
        """
        fitted, held = self.changes_of_halves()
        if self.pattern is None:
            return fitted, held
        there = self.of_held_out()
        there.pattern = self.pattern
        responding = [there._less(self.pattern.constants, *rows) for rows in zip(held[0], fitted[0], strict=True)]
        return self._rows_beside_pattern(fitted), [np.stack(responding), *held[1:]]

    def normal(self, jacobian, point: np.ndarray, residuals: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Return the information matrix, and the gradient of minus half of chi-square."""
        information, gradient = np.diag(self.prior_precision), self.prior_precision * (self.center - point)
        for rows, weight, residual in zip(jacobian, self.weights, residuals, strict=True):
            weighted = rows * weight
            information = information + (weighted @ rows.T) / np.outer(self.steps, self.steps)
            gradient = gradient + (weighted @ residual) / self.steps
        return information, gradient

    def derivative(self, index: int, point: np.ndarray, residuals: list[np.ndarray]) -> list[np.ndarray]:
        """Return the change of predictions per unit of one number, by part, as a one-sided difference."""
        (effect, name), of_object = self.keys[index], self.model.object_errors
        if not effect and name in of_object.names:
            change = of_object.whitened(self.data)[of_object.names.index(name)]
            return self.beside_pattern([change, *(np.zeros_like(part) for part in residuals[1:])])
        step = self.steps[index] if point[index] + self.steps[index] <= self.high[index] else -self.steps[index]
        moved = point.copy()
        moved[index] += step
        there = self.residuals(moved, SLOPE_REACH if self.moving[index] else 1.0)
        return [(before - after) / step for before, after in zip(residuals, there, strict=True)]

    def positions(self, names: Sequence[str]) -> list[int]:
        """Return the indices of nuisance parameters in a point."""
        known = [number.name for number in self.nuisances]
        return [len(self.unknowns) + known.index(name) for name in names]


def nuisance_step(number: Nuisance) -> float:
    """Return the finite-difference step of a nuisance parameter."""
    if number.name == "size":
        return SIZE_STEP
    return ALIGNMENT_STEP * number.sd if np.isfinite(number.sd) else UNKNOWN_STEP


def chi_square(weights: list[np.ndarray], residuals: list[np.ndarray]) -> float:
    """Return the weighted sum of squared residuals over all parts."""
    return sum(float((weight * residual**2).sum()) for weight, residual in zip(weights, residuals, strict=True))


def whitened(parts: Sequence[np.ndarray], weights: Sequence[np.ndarray]) -> np.ndarray:
    """Return parts of the data in standard deviations, concatenated, shape (data,)."""
    return np.concatenate([part * np.sqrt(weight) for part, weight in zip(parts, weights, strict=True)])
