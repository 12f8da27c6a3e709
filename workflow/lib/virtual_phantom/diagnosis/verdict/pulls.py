"""How physics that is known of a scanner fared: it is fitted within what is stated, and never left out."""

from __future__ import annotations

from collections.abc import Mapping
from math import sqrt

from scipy import stats

from ...physics.effect import load
from ...statistics.multiplicity import bonferroni
from ..fitting.fit import Fit
from ..fitting.model import Model
from ..fitting.steps import interval
from ..residuals.residual_tests import ALPHA

# Share of a stated standard deviation: a fit that takes less off it has not measured the parameter.
LEAST_TOLD = 0.1


def statements(
    fit: Fit, model: Model, errors: Mapping[str, Mapping[str, float]] | None = None
) -> dict[str, dict[str, dict]]:
    """How what was declared fared in a fit.

    A parameter is pulled by the difference of the fitted from the stated value over the root of the difference of
    their variances, which is standard normal where the statement holds [1]_: of the number that fits vary. What inexact
    models may shift it by adds to that.

    Parameters
    ----------
    errors : mapping of str to mapping of str to float, optional
        Standard errors with inexact models counted, as `inexact.Errors` has them; None: those of the fit.

    Returns
    -------
    dict
        {effect: {parameter: {"stated", "sd", "value", "ci95", "unit", "pull", "off"}}}; off: the pull is no chance,
        over all that was declared.

    References
    ----------
    .. [1] L. Demortier and L. Lyons, Everything you always wanted to know about pulls, CDF note 5776, 2002.
    """
    numbers = {(one.effect, one.name): one for one in model.unknowns(tuple(model.declared))}
    found: dict[str, dict[str, dict]] = {}
    for name, parameters in model.declared.items():
        units = {one.name: one.unit for one in load(name).parameters}
        found[name] = {}
        for key, stated in parameters.items():
            value, error = fit.physics[name][key], fit.errors[name].get(key, 0.0)
            whole = error if errors is None else max(error, errors[name].get(key, error))
            pull = 0.0
            if (number := numbers.get((name, key))) is not None:
                of_noise, of_all = (number.number_error(value, one) for one in (error, whole))
                # As much as the data told beyond the statement; hardly anything where they told nothing.
                told = max(number.sd**2 - of_noise**2, (number.sd * LEAST_TOLD) ** 2)
                pull = (number.of(value) - number.expected) / sqrt(told + of_all**2 - of_noise**2)
            p = float(bonferroni(2 * stats.norm.sf(abs(pull)), max(len(numbers), 1)))
            found[name][key] = {
                "stated": stated.value,
                "sd": stated.sd,
                "value": value,
                "ci95": interval(value, whole),
                "unit": units[key],
                "pull": pull,
                "off": p < ALPHA,
            }
    return found
