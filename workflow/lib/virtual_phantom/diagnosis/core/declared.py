"""Physics that is known of a scanner: in every model, fitted within what is stated, and never what was left out."""

from __future__ import annotations

from collections.abc import Mapping
from math import sqrt

from scipy import stats

from ...base.errors import InputError
from ...physics.effect import checked, load
from ...statistics.multiplicity import bonferroni
from .fit import Fit
from .locate import ALPHA
from .model import Model
from .statement import Statement
from .steps import NORMAL_95

BASELINE = "diagnosis.recordings: baseline"  # what messages begin with where no recording is named
# Share of a stated standard deviation: a fit that takes less off it has not measured the parameter.
LEAST_TOLD = 0.1


def declared(section: Mapping[str, Mapping[str, Mapping[str, float]]], where: str) -> dict[str, dict[str, Statement]]:
    """What a configuration declares.

    Parameters
    ----------
    section : mapping
        {effect: {parameter: {value, sd}}}.
    where : str
        What messages begin with.

    Returns
    -------
    dict of str to dict of str to Statement

    Raises
    ------
    InputError
        For an effect or a parameter that the library does not have, a value out of its range, a pattern of pixels,
        and parameters of which nothing is stated.
    """
    found = {}
    for name, parameters in section.items():
        effect = load(name, where)
        if effect.pattern:
            raise InputError(f"{where}: {name} has one unknown per detector pixel, which nobody can state; take it out")
        checked({name: {key: one["value"] for key, one in parameters.items()}}, where)
        missing = [one.name for one in effect.parameters if one.name not in parameters]
        if missing:
            raise InputError(f"{where}.{name}: nothing is stated of {', '.join(missing)}; give value and sd")
        found[name] = {key: Statement(one["value"], one["sd"]) for key, one in parameters.items()}
    return found


def statements(fit: Fit, model: Model) -> dict[str, dict[str, dict]]:
    """How what was declared fared in a fit.

    A parameter is pulled by the difference of the fitted from the stated value over the root of the difference of
    their variances, which is standard normal where the statement holds [1]_.

    Parameters
    ----------
    fit : Fit
    model : Model

    Returns
    -------
    dict
        {effect: {parameter: {"stated", "sd", "value", "ci95", "unit", "pull", "off"}}}; off: the pull is no chance,
        over all that was declared.

    References
    ----------
    .. [1] L. Demortier and L. Lyons, Everything you always wanted to know about pulls, CDF note 5776, 2002.
    """
    tests = sum(one.sd > 0 for parameters in model.declared.values() for one in parameters.values())
    found: dict[str, dict[str, dict]] = {}
    for name, parameters in model.declared.items():
        units = {one.name: one.unit for one in load(name).parameters}
        found[name] = {}
        for key, stated in parameters.items():
            value, error = fit.physics[name][key], fit.errors[name].get(key, 0.0)
            pull = 0.0
            if stated.sd > 0:
                # As much as the data told beyond the statement; hardly anything where they told nothing.
                told = max(stated.sd**2 - error**2, (stated.sd * LEAST_TOLD) ** 2)
                pull = (value - stated.value) / sqrt(told)
            p = float(bonferroni(2 * stats.norm.sf(abs(pull)), max(tests, 1)))
            found[name][key] = {
                "stated": stated.value,
                "sd": stated.sd,
                "value": value,
                "ci95": [value - NORMAL_95 * error, value + NORMAL_95 * error],
                "unit": units[key],
                "pull": pull,
                "off": p < ALPHA,
            }
    return found
