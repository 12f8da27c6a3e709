"""Warnings of a diagnosis: limits of the recording, parameters at their bounds, and declared physics that is wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import sqrt

import numpy as np
from scipy import stats

from ...base.names import enumerated
from ...physics.effect import Parameter, load
from ...statistics.multiplicity import bonferroni
from ..fitting.fit import Fit
from ..fitting.model import Model
from ..fitting.nuisance import PRIOR_BOUND_SD, Nuisance, display_name
from ..fitting.steps import interval
from ..fitting.unknown import Unknown
from ..residuals.dataset import Prepared
from ..residuals.residual_tests import ALPHA, EDGES, DomainTest
from ..selection.forward_selection import Choice

ALIKE = 0.9  # correlation of recording and simulation; less is another object, position or geometry
SIGNIFICANT = 5.0  # standard errors above which the variance of data exceeds noise
# A mismatch lies along edges if this share of chi-square beyond noise is in the steepest tenth of the data. The share
# was 0.32 to 1.1 for cylinders drawn in voxels of 0.25 to 2 mm with the physics fitted. It was 0.08 to 0.15 for larger
# differences by scatter and a spectrum that were not fitted.
ALONG_EDGES = 0.25
ABSENT = 10.0  # log score that an effect implied by the label must lose to be reported as absent
# A number is at its bound within this share of its range, or of a nuisance parameter's largest deviation.
AT_BOUND = 1e-6
# Least width of a range in standard errors for a warning about its ends; the 95 % interval covers a narrower range.
WELL_KNOWN = 4.0
# Chi-square per datum of the mean above which the model does not fit: a difference of half the noise's SD in all data.
MOST_CHI_SQUARE = 1.25
ADVISED = ("scale", "offset", "x_mm", "y_mm", "z_mm", "turn_deg", "size")  # keys of the configuration's alignment
# Lower limit of sqrt(prior variance - posterior variance) relative to the declared standard deviation.
LEAST_REDUCED = 0.1


def caveats(prepared: Prepared, choice: Choice, left: Sequence[DomainTest] = ()) -> list[str]:
    """Return sentences for the report on limits of the recording.

    Parameters
    ----------
    left : sequence of DomainTest, optional
        Locations of the remaining mismatch, the worst first.
    """
    found, tube_kvp = prepared.caveats(choice.chosen.fit), prepared.fitter.model.tube_kvp
    if prepared.time_remark:
        found.append(f"In recording.yaml {prepared.time_remark}.")
    alike = likeness(prepared, choice)
    if alike < ALIKE:
        found.append(
            f"Recording and simulation have a correlation of only {alike:.2f}: the object, its location or the "
            "geometry is wrong. Correct it first."
        )
    if tube_kvp is not None:
        found += [load(name).if_absent.format(tube_kvp=tube_kvp) for name in choice.alone if _is_absent(name, choice)]
    at_edges = prepared.voxels and EDGES in [place.domain for place in left]
    if at_edges and prepared.share_at_edges(choice.chosen.fit) >= ALONG_EDGES:
        found.append(
            f"The remaining mismatch lies along edges, {prepared.voxels} would show whether anything else remains "
            "(docs/how-to/objects.md)."
        )
    return found


def likeness(prepared: Prepared, choice: Choice) -> float:
    """Return the correlation of the recorded data, without their noise, with the selected model.

    Noise attenuates a correlation by the square root of the share of the variance that is not noise (C. Spearman,
    Am. J. Psychol. 15, 72, 1904). The result is 1 for data without significantly more variance than noise.
    """
    recorded, data = prepared.recorded(), prepared.data
    modeled = recorded - prepared.difference(choice.chosen.fit, held_out=False)
    noise = np.broadcast_to(prepared.variance, data.usable.shape)[data.usable].mean() / data.n
    reliability = 1 - noise / recorded.var()
    if reliability < SIGNIFICANT * sqrt(2 / recorded.size):
        return 1.0
    return min(float(np.corrcoef(recorded, modeled)[0, 1]) / sqrt(reliability), 1.0)


def _is_absent(name: str, choice: Choice) -> bool:
    """Return whether the data reject an effect that the label implies, also as an alternative explanation."""
    chosen = choice.chosen
    if not load(name).if_absent or name in chosen.fit.effects:
        return False
    loses = chosen.score - choice.baseline.score - choice.alone[name] > ABSENT
    return loses and not any(name in choice.ambiguous_with(effect) for effect in chosen.fit.effects)


def doubts(choice: Choice, model: Model, held_out: Mapping[str, Mapping[str, float]]) -> list[str]:
    """Return phrases for the verdict on parameters at their bounds and on a model that does not fit.

    Parameters
    ----------
    held_out : mapping
        Metrics before and after, from verdict.metrics_of.
    """
    fit = choice.chosen.fit
    found = [phrase for _, _, phrase in _at_bounds(fit, model)]
    if at_bounds := _nuisances_at_bounds(fit, model):
        moved = [
            f"{display_name(number.name)} is {fit.nuisance[number.name]:.3g} (prior {number.expected:.3g} ± "
            f"{number.sd:.3g})"
            for number in at_bounds
        ]
        found.append(f"{enumerated(moved)}, at the limit of the fit ({PRIOR_BOUND_SD:g} SD of the prior)")
    left = held_out.get("chi_square_mean", {}).get("after", 1.0)
    if left > MOST_CHI_SQUARE:
        found.append(f"chi-square per datum is {left:.2f} (1.00 for noise alone)")
    return found


def effects_at_bounds(fit: Fit, model: Model) -> list[str]:
    """Return the effects that do not explain a difference, as a parameter is at its bound.

    The width of a kernel may be there, because the shape of the kernel is an assumption.
    """
    return list(dict.fromkeys(name for name, parameter, _ in _at_bounds(fit, model) if not parameter.kernel))


def _at_bounds(fit: Fit, model: Model) -> list[tuple[str, Parameter, str]]:
    """Return effect, parameter and a phrase for each parameter that the data measure and that is at its bound."""
    found = []
    for unknown in model.unknowns(fit.effects):
        value, error = fit.physics[unknown.effect][unknown.name], fit.errors[unknown.effect].get(unknown.name, 0.0)
        low, high = unknown.value(unknown.low), unknown.value(unknown.high)
        parameter = unknown.parameter
        if parameter.fraction or WELL_KNOWN * error > high - low:  # the data do not measure it
            continue
        # A lower end of 0 is the absence of the effect.
        ends = {"upper": high} | ({"lower": low} if low not in (0, parameter.neutral) else {})
        for end, bound in ends.items():
            if abs(value - bound) <= AT_BOUND * (high - low):
                name, unit = parameter.display_name, "" if parameter.unit == "1" else f" {parameter.unit}"
                known = _stated(unknown, model) or "not stated"
                what = f"{name} of {load(unknown.effect).display_name}"
                phrase = f"{what} is at its {end} bound, {value:.3g}{unit} ({known})"
                found.append((unknown.effect, parameter, phrase))
    return found


def advice(fit: Fit, model: Model) -> list[str]:
    """Return sentences on what to state where nuisance parameters reached their bounds.

    Returns
    -------
    list of str
        One for each parameter that the configuration can state, so not for photons and numerical errors.
    """
    found = []
    for number in _nuisances_at_bounds(fit, model):
        if number.name not in ADVISED:
            continue
        why = "; the density of the object is often known to a few percent only" * (number.name == "scale")
        found.append(
            f"The {display_name(number.name)} has a prior SD of {number.sd:.3g}{why}. "
            f"If its error may be larger, set alignment: {{{number.name}: SD}} under diagnosis.recordings "
            "(docs/how-to/diagnosis.md)."
        )
    return found


def _nuisances_at_bounds(fit: Fit, model: Model) -> list[Nuisance]:
    """Return the nuisance parameters at their bounds."""
    most = PRIOR_BOUND_SD * (1 - AT_BOUND)
    return [number for number in model.nuisances_for(fit.effects) if abs(fit.pulls.get(number.name, 0.0)) > most]


def _stated(unknown: Unknown, model: Model) -> str:
    """Return a parameter's prior in words; empty if there is none."""
    declared = model.declared.get(unknown.effect, {}).get(unknown.name)
    if declared is not None:
        return f"stated: {declared.value:g} ± {declared.sd:g}"
    nominal = unknown.parameter.nominal
    return model.labels[nominal].words if nominal else ""


def statements(
    fit: Fit, model: Model, errors: Mapping[str, Mapping[str, float]] | None = None
) -> dict[str, dict[str, dict]]:
    """Compare declared physics with a fit.

    The pull of a parameter is the difference of fitted and declared value over the root of the difference of their
    variances. It is standard normal if the declaration is right [1]_. Values and variances are of the fit variable
    (Parameter.to_variable). Model errors add to the variance.

    Parameters
    ----------
    errors : mapping of str to mapping of str to float, optional
        Standard errors with model errors, as `model_error.Errors` has them; None: errors of the fit.

    Returns
    -------
    dict
        {effect: {parameter: {"stated", "sd", "value", "ci95", "unit", "pull", "off"}}}; off: the pull is significant
        over all declared parameters.

    References
    ----------
    .. [1] L. Demortier and L. Lyons, Everything you always wanted to know about pulls, CDF note 5776, 2002.
    """
    numbers = {(unknown.effect, unknown.name): unknown for unknown in model.unknowns(tuple(model.declared))}
    found: dict[str, dict[str, dict]] = {}
    for name, parameters in model.declared.items():
        units = {parameter.name: parameter.unit for parameter in load(name).parameters}
        found[name] = {}
        for key, stated in parameters.items():
            value, error = fit.physics[name][key], fit.errors[name].get(key, 0.0)
            whole = error if errors is None else max(error, errors[name].get(key, error))
            pull = 0.0
            if (number := numbers.get((name, key))) is not None:
                of_noise, of_all = (number.number_error(value, sd) for sd in (error, whole))
                # Reduction of the variance of the declaration by the data, with a lower limit.
                reduced = max(number.sd**2 - of_noise**2, (number.sd * LEAST_REDUCED) ** 2)
                pull = (number.of(value) - number.expected) / sqrt(reduced + of_all**2 - of_noise**2)
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
