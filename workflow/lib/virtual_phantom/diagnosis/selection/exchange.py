"""Exchange of a fitted effect for another one, which starts where it changes the data equally to first order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from ...physics.effect import load
from ..fitting.fit import Fit, Fitter
from ..fitting.problem import Problem
from ..fitting.templates import SMALL, data_changes, strength, templates, varied, whitened, with_priors

# Search range of a strength relative to its first-order value, and options of the search. First-order strengths were
# wrong by 0.1 to 25 %, because one-sided derivatives differ at the edges of a disc.
NEAR_FIRST_ORDER, SEARCH = (0.25, 4.0), {"diff_step": 2e-3, "ftol": 1e-5, "xtol": 1e-5, "max_nfev": 8}
# First-order share below which two effects that move rays or the object are different. It was 0.6 for equal effects.
LEAST_MOVING = 0.3


@dataclass(frozen=True)
class Exchange:
    """Exchange of a fit's effect for another one.

    Attributes
    ----------
    start : Fit
        Start of a fit with the other effect.
    share : float
        Squared partial correlation of the changes of the data by the two effects, given all other parameters of the
        fit; 1: equal to first order. If both effects move rays or the object, it can be too small, because one-sided
        derivatives differ at sharp edges (0.6 for two equal effects). It is then at least the share of the lost
        chi-square that the other effect restores at its start.
    """

    start: Fit
    share: float


def exchanged(fitter: Fitter, fit: Fit, effect: str, others: Sequence[str], least: float = 0.0) -> dict[str, Exchange]:
    """Exchange an effect of a fit for each of the others that shares at least `least` of its change of the data.

    If the effect is removed, the data change by J_e a to first order, where a is its strength and J_e its derivatives.
    The strength b of the other effect and the changes d of the remaining parameters solve J_o b + J_r d = J_e a by
    least squares with priors. A second start has d = 0, and its strength is optimized by a line search. The start with
    the lower chi-square is returned; for equal effects, the second is exact. Derivatives are taken at the fit with the
    effect, because matched filters without it miss an effect that moves edges by more than their width. Effects without
    a strength have no exchange.
    """
    others = [name for name in others if not load(name).pattern and varied(fitter.model.parameters(name))]
    if load(effect).pattern or not others:
        return {}
    removal = _Removal(fitter, fit, effect)
    found = {name: removal.replaced_by(name, least) for name in others} if removal.changes_data else {}
    return {name: exchange for name, exchange in found.items() if exchange is not None and exchange.share >= least}


class _Removal:
    """First-order changes of the data by removing an effect from a fit."""

    def __init__(self, fitter: Fitter, fit: Fit, effect: str):
        self.fitter, self.fit, self.effect = fitter, fit, effect
        self.problem = problem = Problem.at(fitter, fit)
        own = {index: unknown.neutral for index, unknown in enumerate(problem.unknowns) if unknown.effect == effect}
        amounts = {index: problem.start[index] - none for index, none in own.items() if none is not None}
        self.changes_data = any(amounts.values())
        if not self.changes_data:
            return
        columns = data_changes(problem)
        self.change = sum(columns[:, index] * amount for index, amount in amounts.items())
        self.rest = [index for index in range(columns.shape[1]) if index not in own]
        self.beside = with_priors(columns, problem)[:, self.rest]
        self.padding = np.zeros(len(self.beside) - len(self.change))
        self.wanted = np.concatenate([self.change, self.padding])
        alone = self.wanted - self.beside @ np.linalg.lstsq(self.beside, self.wanted, rcond=None)[0]
        self.square = float(alone @ alone)  # of the change that the other numbers cannot absorb
        self.changes_data = self.square > SMALL * (self.wanted @ self.wanted)
        strengths = [problem.unknowns[index] for index in amounts]
        none = {unknown.name: unknown.value(unknown.neutral) for unknown in strengths}
        removed = replace(fit, physics=fit.physics | {effect: fit.physics[effect] | none})
        self.here, self.without = (_chi_square(fitter, start) for start in (fit, removed))

    def replaced_by(self, name: str, least: float) -> Exchange | None:
        """Return the exchange for another effect; None if it shares less than `least` to first order."""
        rows = templates(self.fitter, self.fit, name)
        design = np.hstack([np.vstack([rows.T, np.zeros((len(self.padding), len(rows)))]), self.beside])
        scale = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
        solved = np.linalg.lstsq(design / scale, self.wanted, rcond=None)[0] / scale
        left = self.wanted - design @ solved
        share = max(0.0, 1 - float(left @ left) / self.square)
        plain = np.linalg.lstsq(rows.T / scale[: len(rows)], self.change, rcond=None)[0] / scale[: len(rows)]
        moving = load(self.effect).kinematic and load(name).kinematic
        if share < (min(least, LEAST_MOVING) if moving else least):
            return None

        def off(times: np.ndarray) -> np.ndarray:
            return _residuals(self.fitter, self._start(name, times * plain))

        times = least_squares(off, 1.0, bounds=NEAR_FIRST_ORDER, **SEARCH).x
        starts = [self._start(name, times * plain), self._start(name, solved[: len(rows)], solved[len(rows) :])]
        reached = [_chi_square(self.fitter, start) for start in starts]
        if moving:
            share = max(share, 1 - (min(reached) - self.here) / max(self.without - self.here, SMALL))
        return Exchange(starts[int(np.argmin(reached))], share)

    def _start(self, name: str, amount: np.ndarray, moved: np.ndarray | float = 0.0) -> Fit:
        """Return a start with another effect at multiples of its templates, and other parameters changed by `moved`."""
        problem, fit = self.problem, self.fit
        point = problem.start.copy()
        point[self.rest] += moved
        named, nuisance = problem.named(np.clip(point, problem.low, problem.high))
        physics = {key: values | named[key] for key, values in fit.physics.items() if key != self.effect}
        physics[name] = _values(self.fitter, name, amount)
        effects = (*(key for key in fit.effects if key != self.effect), name)
        return replace(fit, effects=effects, physics=physics, nuisance=fit.nuisance | nuisance)


def _chi_square(fitter: Fitter, start: Fit) -> float:
    left = _residuals(fitter, start)
    return float(left @ left)


def _residuals(fitter: Fitter, start: Fit) -> np.ndarray:
    """Return the whitened residuals at a start with the best scale and offset, and residuals of the priors."""
    problem = Problem.at(fitter, start)
    point, residuals = problem.solve_scale_and_offset(problem.start)
    priors = np.sqrt(problem.prior_precision) * (point - problem.center)
    return np.concatenate([whitened(residuals, problem.weights), priors])


def _values(fitter: Fitter, name: str, amounts: np.ndarray) -> dict[str, float]:
    """Return an effect's parameters at multiples of their templates, the others typical."""
    unknowns = {unknown.name: unknown for unknown in fitter.model.unknowns((name,))}
    times = dict(zip([parameter.name for parameter in varied(fitter.model.parameters(name))], amounts, strict=True))
    values = {}
    for parameter in fitter.model.parameters(name):
        number = parameter.to_variable(parameter.typical)
        if parameter.name in times:
            none = parameter.to_variable(parameter.neutral)
            number = none + times[parameter.name] * (parameter.to_variable(strength(parameter)) - none)
        unknown = unknowns.get(parameter.name)
        if unknown is not None:
            values[parameter.name] = float(unknown.value(min(max(number, unknown.low), unknown.high)))
    return values | fitter.model.known(name)
