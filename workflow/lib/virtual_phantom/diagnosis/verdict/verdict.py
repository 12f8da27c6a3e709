"""Verdict of a diagnosis: missing physics with its parameters, remaining mismatch, and the next measurement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...physics.effect import load
from ..fitting.fit import Fit
from ..fitting.model import Model
from ..fitting.steps import interval
from ..fitting.trial import Trial
from ..residuals import KINDS
from ..residuals.dataset import Change, Prepared
from ..residuals.residual_tests import EDGES, DomainTest, alignment_tests
from ..selection.forward_selection import AS_GOOD, LEAST_GAIN, Choice
from ..uncertainty.intervals import intervals
from ..uncertainty.model_error import Errors
from ..verdict_text import (
    UNEXPLAINED,
    VerdictLine,
    effect_name,
    recording_lines,
    shortened,
    verdict_of,
    with_verdict_text,
)
from .object_alternative import imitating_effects, object_alternatives
from .object_mismatch import content_of, excess
from .unmodeled import ChangesOfFits, better_changes, kinds_test
from .warnings import caveats, doubts, effects_at_bounds, statements

LEFT_SD = 3.0  # standard deviations above which a sum of products is significant: 1 in 740 by chance
OBJECT_TURNED = (
    "scan the object again, rotated by 90 degrees about z; a mismatch of the object rotates with it, a mismatch of the "
    "scanner does not"
)
OTHER_OBJECT = "to distinguish {} from an error of the object, scan another object, use another tube voltage"


@dataclass(frozen=True)
class Diagnosis:
    """Result of a diagnosis, with all that its report shows.

    Attributes
    ----------
    choice, halves : Choice or None
        Fits of all data, and of the fitted half with gains in the held-out half. None if nothing was fitted, because
        the set-up is wrong.
    before, after : list of DomainTest
        Locations of mismatch on held-out data, with alignment alone and with the chosen effects.
    content : dict
        Content of diagnosis.json.
    prepared : Prepared or None
        The recording with the noise by which it was judged.
    scanned : ScannedVolume or None
        The object as images show it (comparison.regions).
    setup : SetupResult, DataMaps or None
        The checks that ended the diagnosis.
    """

    choice: Choice | None
    halves: Choice | None
    before: list[DomainTest]
    after: list[DomainTest]
    content: dict
    prepared: Prepared | None = None
    scanned: Any = None
    setup: Any = None


def diagnose(
    recording: str,
    prepared: Prepared,
    choice: Choice,
    halves: Choice | None = None,
    corrected: Sequence[Change] = (),
    changes: ChangesOfFits | None = None,
    tried: Sequence[str] = (),
) -> Diagnosis:
    """Judge a choice of effects on held-out data.

    Parameters
    ----------
    choice : Choice
        Selection by fits of all data.
    halves : Choice, optional
        Its fits of the fitted half (Choice.on_halves); None: `choice` has these fits already.
    corrected : sequence of Change, optional
        Local object mismatches that were corrected before the fit.
    changes : ChangesOfFits, optional
        Cache that holds the changes computed in the selection.
    """
    fitter, changes = prepared.fitter, changes or ChangesOfFits()
    whole, halves = (fitter, choice) if halves is None else (prepared.whole, halves)

    def kinds(fit):
        return changes(prepared, fit, choice.numerical)

    def places(fit, least_gain):
        fitted, held = prepared.halves(fit)
        more = [*alignment_tests(fit, fitter.model.distortions), *kinds_test(kinds(fit), least_gain)]
        found = prepared.domains(held, fit, fitted, more)
        # Other domains come before kinds of change, which have no location.
        return sorted(found, key=lambda place: (not place.significant, place.domain == KINDS))

    inexact = max(LEAST_GAIN, halves.tolerance)
    before, after = places(halves.baseline.fit, LEAST_GAIN), places(halves.chosen.fit, inexact)
    effects, errors = choice.chosen.fit.effects, _errors(choice)
    left = [place for place in after if place.significant]
    removed = excess_removed(prepared, halves.baseline, halves.chosen, left) if effects else None
    metrics = {
        "fit": metrics_of(prepared, halves, held_out=False),
        "held_out": metrics_of(prepared, halves, held_out=True),
    }
    rms = metrics["held_out"][f"rms_{prepared.display.unit}"]
    doubted = doubts(choice, fitter.model, metrics["held_out"])
    known = statements(choice.chosen.fit, fitter.model, errors.physics)
    beside = {name: kinds(fit) for name, fit in halves.without.items()}
    outside = better_changes(halves, beside, max(AS_GOOD, halves.tolerance))
    off = any(parameter["off"] for parameters in known.values() for parameter in parameters.values())
    explained = bool(effects) or off
    verdict = verdict_of(explained, bool(left or (explained and (doubted or outside))))
    at_bounds = effects_at_bounds(choice.chosen.fit, fitter.model)
    if effects and set(effects) == set(at_bounds):
        verdict = UNEXPLAINED
    from_another = any(choice.p.get(name, 0.0) is None for name in effects)  # its physics is not free
    alternatives = {} if from_another else object_alternatives(fitter, halves)
    object_errors = {} if effects or left else imitating_effects(whole, choice.baseline, tried)
    like_object = [*alternatives, *object_errors.get("imitated_by", [])]
    ambiguous = {name: choice.ambiguous_with(name) for name in effects}
    content = {
        "recording": recording,
        "verdict": verdict,
        "locations": [_location(place) for place in before],
        "effects": [_effect(name, choice, halves.gains[name], fitter.model) for name in effects],
        "ambiguous_with": ambiguous,
        "outside": {
            name: {"what": change.words, "better_by": change.gain - halves.gains[name], "z": change.z}
            for name, change in outside.items()
        },
        "object_alternatives": alternatives,
        "object_errors": object_errors,
        "ruled_out": choice.ruled_out,
        "undecided": choice.undecided,
        "alignment": {
            name: {"value": value, "ci95": interval(value, errors.nuisance[name])}
            for name, value in choice.chosen.fit.nuisance.items()
        },
        **metrics,
        "excess_removed": removed,
        "excess_rms_removed": excess_rms_removed(**rms) if effects else None,
        "remainder_sd": remainder_sd(prepared, halves.chosen),
        "unexplained": [_location(place) for place in left],
        "doubts": doubted,
        "at_bounds": at_bounds,
        "declared": known,
        "next_measurement": next_measurements(choice, bool(left), prepared.display.ranked, like_object),
        "held_out_data": prepared.held_out_text,
        "noise_from_one_repeat": prepared.single,
        "caveats": caveats(prepared, choice, left),
    }
    if choice.mismatch is not None:
        content["object"] = content_of([choice.mismatch], excess(prepared, halves.baseline.fit))
    elif corrected:
        content["object"] = content_of(corrected)
    return Diagnosis(choice, halves, before, after, with_verdict_text(content, recording_lines(content)), prepared)


def unfitted_diagnosis(
    recording: str, verdict: str, lines: Sequence[VerdictLine | None], shown: Any, **content
) -> Diagnosis:
    """Return the diagnosis of a recording to which nothing was fitted.

    Parameters
    ----------
    shown : SetupResult or DataMaps
        Result of the checks, whose maps the report shows.
    **content
        Further content of diagnosis.json.
    """
    empty = {
        "recording": recording,
        "verdict": verdict,
        **{key: [] for key in ("locations", "effects", "unexplained", "next_measurement")},
        **{key: {} for key in ("ambiguous_with", "ruled_out", "fit", "held_out")},
        **dict.fromkeys(("excess_removed", "excess_rms_removed", "remainder_sd")),
        "held_out_data": "none",
    }
    return Diagnosis(None, None, [], [], with_verdict_text(empty | content, lines), setup=shown)


def excess_removed(prepared: Prepared, baseline: Trial, chosen: Trial, standing: list[DomainTest]) -> float | None:
    """Return the share of the held-out chi-square beyond noise that the effects remove; None if they remove nothing.

    The removed part is twice the gain in log score. The remaining part is the largest of several sums of products of
    fitted and held-out standardized residuals, whose noise is independent. One sum is over all rays, and one over the
    locations of each significant domain, because noise of all rays could hide a local difference. Sums up to LEFT_SD
    standard deviations are ignored. Numerical errors of the model are subtracted.

    Parameters
    ----------
    standing : list of DomainTest
        Significant locations of the chosen model.
    """
    gained = 2 * (chosen.score - baseline.score)
    if not gained > 0:
        return None
    fitted, held = prepared.halves(chosen.fit)
    sums = []
    if domains := {place.domain for place in standing} - {EDGES}:  # whose map has no sign
        maps = [
            {place.domain: place.map.ravel() for place in prepared.domains(half, chosen.fit)} for half in (fitted, held)
        ]
        sums += [(maps[0][domain] * maps[1][domain], 0.0) for domain in domains & maps[0].keys()]
    common = held.in_common(fitted)
    sums.append((common.products, sum(float(part.sum()) for part in common.numerical)))
    left = [
        float(products.sum()) - error
        for products, error in sums
        if products.sum() - error > LEFT_SD * np.sqrt((products**2).sum())
    ]
    return gained / (gained + max(left, default=0.0))


def remainder_sd(prepared: Prepared, chosen: Trial) -> float | None:
    """Return the mismatch common to fitted and held-out data over all rays or voxels, in SDs of noise alone.

    If the initial difference was large, the remainder can be large although its share (`excess_removed`) is small.
    Numerical errors of the model are subtracted. None if the halves share no ray.
    """
    fitted, held = prepared.halves(chosen.fit)
    common = held.in_common(fitted)
    return common.z() if common.there.any() else None


def excess_rms_removed(before: float, after: float, floor: float) -> float | None:
    """Return 1 - sqrt((after^2 - floor^2) / (before^2 - floor^2)), the removed share of the RMS beyond noise.

    The variance of noise is subtracted, so this is the share of the RMS of the noise-free difference. None if the RMS
    before does not exceed noise.

    Parameters
    ----------
    before, after, floor : float
        RMS of the difference, and of noise alone.
    """
    if before <= floor:
        return None
    return float(1 - np.sqrt(max(0.0, after**2 - floor**2) / (before**2 - floor**2)))


def rms_of(prepared: Prepared, fits: Mapping[str, Fit], held_out: bool) -> dict[str, float]:
    """Return the RMS difference of each fit, and the RMS of noise alone as "floor"."""
    data = prepared.held_out if held_out else prepared.data
    rms = {key: float(np.sqrt((prepared.difference(fit, held_out) ** 2).mean())) for key, fit in fits.items()}
    return rms | {"floor": float(np.sqrt((prepared.variance[data.usable] / data.n).mean()))}


def metrics_of(prepared: Prepared, choice: Choice, held_out: bool) -> dict:
    """Return the goodness of fit with alignment alone and with the chosen effects.

    Parameters
    ----------
    held_out : bool
        Whether to use held-out data; else fitted data.

    Returns
    -------
    dict of str to dict of str to float
        {metric: {"before", "after", "floor": value}}; the floor is the value for noise alone. Metrics: RMS in the unit
        of `display`, chi-square per datum by part, and for held-out data the log score, which has no floor.
    """
    fits = {"before": choice.baseline.fit, "after": choice.chosen.fit}
    halves = {key: prepared.half(fit, held_out) for key, fit in fits.items()}
    data, weights = halves["after"].data, halves["after"].weights
    found = {f"rms_{prepared.display.unit}": rms_of(prepared, fits, held_out)}
    for part, name in enumerate(data.parts):
        count = int((weights[part] > 0).sum())
        if not count:
            continue
        found[f"chi_square_{name.replace(' ', '_')}"] = {
            key: float((weights[part] * half.residuals[part] ** 2).sum()) / count for key, half in halves.items()
        } | {"floor": 1.0}
    found["log_score"] = {"before": choice.baseline.score, "after": choice.chosen.score} if held_out else {}
    return {key: value for key, value in found.items() if value}


def _effect(name: str, choice: Choice, held_out_gain: float, model: Model) -> dict:
    effect, fit, errors = load(name), choice.chosen.fit, _errors(choice).physics
    known = {parameter.name: parameter for parameter in (*effect.parameters, *model.parameters(name))}
    parameters = {}
    for key, value in fit.physics[name].items():
        if known[key].stated:  # not fitted
            continue
        noise, whole = fit.errors[name].get(key, 0.0), errors[name].get(key, 0.0)
        found = intervals(value, noise, whole, known[key].low, known[key].high)
        parameters[key] = {"value": value, **found, "unit": known[key].unit}
    return {
        "name": name,
        "physics": effect.physics,
        "parameters": parameters,
        "evidence": {"held_out_gain": held_out_gain, "p": choice.p[name]},
    }


def _errors(choice: Choice) -> Errors:
    """Return the standard errors of the chosen fit, with model errors if these are known."""
    fit = choice.chosen.fit
    return choice.errors or Errors(fit.errors, fit.nuisance_errors)


def _location(place: DomainTest) -> dict:
    return {"domain": place.domain, "where": place.where, "z": place.z, "p": place.p, "map": f"{place.domain}.npy"}


def next_measurements(choice: Choice, something_left: bool, ranked: bool, like_object: Sequence[str] = ()) -> list[str]:
    """Return the measurements that would settle the verdict, as instructions.

    Parameters
    ----------
    ranked : bool
        Whether further recordings of this kind can be ranked (`snakemake next_measurement`). If not, the tests of each
        ambiguous effect and of its alternatives are listed.
    like_object : sequence of str, optional
        Effects that errors of the object explain as well.
    """
    found = [OBJECT_TURNED] if choice.mismatch else []
    for name in choice.chosen.fit.effects:
        rivals = choice.ambiguous_with(name)
        if rivals and ranked:
            others = " or ".join(shortened(list(map(effect_name, rivals))))
            found.append(
                f"run snakemake next_measurement to rank recordings that distinguish {effect_name(name)} from {others}"
            )
        elif rivals:
            found += [
                f"to distinguish {effect_name(name)} from {effect_name(rival)}, {load(tested).settled_by}"
                for rival in rivals
                for tested in (name, rival)
            ]
    found += [f"{OTHER_OBJECT.format(effect_name(name))}, or {load(name).settled_by}" for name in like_object]
    if something_left and not found:
        found = ["repeat the scan after air and geometry calibration, to see whether the mismatch remains"]
    return list(dict.fromkeys(found))
