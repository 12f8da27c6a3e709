"""Starts of fits in which another effect takes the place of one that was fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from ...physics.effect import load
from ..fitting.fit import Fit, Fitter, Problem
from ..fitting.templates import SMALL, data_changes, strength, templates, varied, with_knowledge

# Logarithm of a strength over that of first order, and the search for it. At the edges of a disc, slopes to either side
# differ, by which strengths were off by 0.1 to 25 %.
NEAR_FIRST_ORDER, SEARCH = (-np.log(4.0), np.log(4.0)), {"xatol": 1e-5, "maxiter": 30}


@dataclass(frozen=True)
class Exchange:
    """An effect of a fit, exchanged for another one to first order.

    Attributes
    ----------
    start : Fit
        Where a fit with the other effect begins.
    share : float
        Of the squared change of the data that the effect makes beside all other numbers of the fit, what the other
        effect makes too: the square of their partial correlation. 1: to first order they are the same. Of two that move
        rays or the object, if that is larger, of the chi-square that taking the effect out costs, what the other effect
        restores where it begins: slopes to either side of a sharp edge differ, and two that are the same shared 0.6.
    """

    start: Fit
    share: float


def exchanged(fitter: Fitter, fit: Fit, effect: str, others: Sequence[str], least: float = 0.0) -> dict[str, Exchange]:
    """Exchange an effect of a fit for others.

    About the fit, the data change by J_e a if the effect is taken out, where a is its strength and J_e its slopes. The
    other effect's strength b and the changes d of the remaining numbers solve J_o b + J_r d = J_e a by least squares,
    beside what is known of those numbers; a second start has d = 0. The one with the lesser chi-square is taken: of
    effects that are the same the second is exact. Its strength is searched along a line, as slopes at sharp edges are
    off by several percent. Slopes are taken where the effect is fitted: filters about a model without it lose an effect
    that moves edges by more than their width.

    Parameters
    ----------
    effect : str
        One of the fit's.
    others : sequence of str
        Effects that are not the fit's.
    least : float, optional
        Share from which on an exchange is returned.

    Returns
    -------
    dict of str to Exchange
        Empty where the effect has no strength that could be taken out; without those that have none themselves.
    """
    problem = Problem(fitter, fit.effects, fit)
    count = len(problem.unknowns)
    own = {index: one.neutral for index, one in enumerate(problem.unknowns) if one.effect == effect}
    amounts = {index: problem.start[index] - none for index, none in own.items() if none is not None}
    others = [name for name in others if not load(name).pattern and varied(fitter.model.parameters(name))]
    if load(effect).pattern or not any(amounts.values()) or not others:
        return {}
    columns = data_changes(problem, fit.pattern)
    change = sum(columns[:, index] * amount for index, amount in amounts.items())
    rest = [index for index in range(columns.shape[1]) if index not in own]
    beside = with_knowledge(columns, problem)[:, rest]
    padding = np.zeros(len(beside) - len(change))
    wanted = np.concatenate([change, padding])
    alone = wanted - beside @ np.linalg.lstsq(beside, wanted, rcond=None)[0]
    if not alone @ alone > SMALL * (wanted @ wanted):
        return {}
    none = {one.name: one.value(one.neutral) for one in (problem.unknowns[index] for index in amounts)}
    taken_out = replace(fit, physics=fit.physics | {effect: fit.physics[effect] | none})
    here, without = (_chi_square(fitter, one) for one in (fit, taken_out))
    found = {}
    for name in others:
        rows = templates(fitter, fit, name)
        design = np.hstack([np.vstack([rows.T, np.zeros((len(padding), len(rows)))]), beside])
        scale = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
        solved = np.linalg.lstsq(design / scale, wanted, rcond=None)[0] / scale
        left = wanted - design @ solved
        share = max(0.0, 1 - float(left @ left) / float(alone @ alone))
        plain = np.linalg.lstsq(rows.T / scale[: len(rows)], change, rcond=None)[0] / scale[: len(rows)]
        moving = load(effect).kinematic and load(name).kinematic
        if share < least and not moving:
            continue
        effects = (*(key for key in fit.effects if key != effect), name)

        def begun(amount: np.ndarray, moved: np.ndarray | float = 0.0, effects=effects, name=name) -> Fit:
            point = problem.start.copy()
            point[rest] += moved
            point = np.clip(point, problem.low, problem.high)
            physics = {key: dict(values) for key, values in fit.physics.items() if key != effect}
            for index, one in enumerate(problem.unknowns):
                if one.effect != effect:
                    physics[one.effect][one.name] = float(one.value(point[index]))
            physics[name] = _values(fitter, name, amount)
            nuisance = {one.name: float(value) for one, value in zip(problem.aligned, point[count:], strict=True)}
            return replace(fit, effects=effects, physics=physics, nuisance=fit.nuisance | nuisance)

        def off(log_times: float, begun=begun, plain=plain) -> float:
            return _chi_square(fitter, begun(np.exp(log_times) * plain))

        times = np.exp(minimize_scalar(off, bounds=NEAR_FIRST_ORDER, method="bounded", options=SEARCH).x)
        starts = [begun(times * plain), begun(solved[: len(rows)], solved[len(rows) :])]
        reached = [_chi_square(fitter, start) for start in starts]
        if moving:
            share = max(share, 1 - (min(reached) - here) / max(without - here, SMALL))
        if share >= least:
            found[name] = Exchange(starts[int(np.argmin(reached))], share)
    return found


def _chi_square(fitter: Fitter, start: Fit) -> float:
    problem = Problem(fitter, start.effects, start)
    point, residuals = problem.solve_scale_and_offset(problem.start, start.pattern)
    return problem.chi_square(residuals, point)


def _values(fitter: Fitter, name: str, amounts: np.ndarray) -> dict[str, float]:
    """Values of an effect's parameters at multiples of their templates, and typical values of the other parameters."""
    unknowns = {one.name: one for one in fitter.model.unknowns((name,))}
    times = dict(zip([one.name for one in varied(fitter.model.parameters(name))], amounts, strict=True))
    values = {}
    for parameter in fitter.model.parameters(name):
        number = parameter.number(parameter.typical)
        if parameter.name in times:
            none = parameter.number(parameter.neutral)
            number = none + times[parameter.name] * (parameter.number(strength(parameter)) - none)
        one = unknowns.get(parameter.name)
        if one is not None:
            values[parameter.name] = float(one.value(min(max(number, one.low), one.high)))
    return values | fitter.model.known(name)
