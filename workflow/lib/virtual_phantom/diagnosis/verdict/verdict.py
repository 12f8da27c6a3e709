"""What a diagnosis says: the verdict, the physics with its parameters, what is left, and what to measure next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...base.words import label
from ...physics.effect import load
from ..fitting.model import Model
from ..fitting.steps import interval
from ..fitting.trial import Trial
from ..residuals.change import Change
from ..residuals.dataset import Prepared
from ..residuals.residual_tests import EDGES, KINDS, Location, aligned
from ..selection.forward_selection import AS_GOOD, LEAST_GAIN, Choice
from ..uncertainty.intervals import intervals
from ..uncertainty.model_error import Errors
from ..wording import MATCH, UNEXPLAINED, sentence
from .caveats import caveats
from .doubts import doubts
from .object_mismatch import content_of, excess
from .pulls import statements
from .unmodelled import ChangesOfFits, better, standing_out

LEFT_SD = 3.0  # by which a sum of products must stand above 0 to count as left: 1 in 740 by chance
NO_SIGNED_MAP = (EDGES, "both halves", KINDS)  # sums of squares and products
OBJECT_TURNED = (
    "the same scan of the object turned by 90 degrees about z: what belongs to the object turns with it, what belongs "
    "to the scanner stays"
)
VERDICTS = (MATCH, "mismatch explained", "mismatch partly explained", UNEXPLAINED)


@dataclass(frozen=True)
class Diagnosis:
    """Everything that is reported.

    Attributes
    ----------
    choice : Choice or None
        None where nothing was fitted, as the scan is described wrong.
    before, after : list of Location
        Places of difference on held-out data, with alignment alone and with the effects chosen.
    content : dict
        What diagnosis.json holds.
    """

    choice: Choice | None
    before: list[Location]
    after: list[Location]
    content: dict


def diagnose(
    recording: str,
    prepared: Prepared,
    choice: Choice,
    pieces: Sequence[Change] = (),
    changes: ChangesOfFits | None = None,
) -> Diagnosis:
    """Judge a choice of effects on the data held out.

    Parameters
    ----------
    recording : str
        Its name.
    pieces : sequence of Change, optional
        Of the object, which were mended before.
    changes : ChangesOfFits, optional
        With those that the choice has asked for.
    """
    fitter, changes = prepared.fitter, changes or ChangesOfFits()

    def kinds(fit):
        return changes(prepared, fit, choice.numerical)

    def places(fit, least_gain):
        fitted, held = prepared.halves(fit)
        more = [*aligned(fit, fitter.model.distortions), *standing_out(kinds(fit), least_gain)]
        found = prepared.domains(held, fit, fitted, more)
        # A place comes before a kind of change, which lies nowhere.
        return sorted(found, key=lambda one: (not one.significant, one.domain == KINDS))

    inexact = max(LEAST_GAIN, choice.blur)
    before, after = places(choice.baseline.fit, LEAST_GAIN), places(choice.chosen.fit, inexact)
    effects, errors = choice.chosen.fit.effects, _errors(choice)
    left = [place for place in after if place.significant]
    removed = excess_removed(prepared, choice.baseline, choice.chosen, left) if effects else None
    metrics = {
        "fit": metrics_of(prepared, choice, held_out=False),
        "held_out": metrics_of(prepared, choice, held_out=True),
    }
    doubted = doubts(choice, fitter.model, metrics["held_out"])
    known = statements(choice.chosen.fit, fitter.model, errors.physics)
    beside = {name: kinds(fit) for name, fit in choice.without.items()}
    outside = better(choice, beside, max(AS_GOOD, choice.blur))
    off = any(one["off"] for parameters in known.values() for one in parameters.values())
    verdict = VERDICTS[(2 if left or doubted or outside else 1) if effects or off else (0 if not left else 3)]
    ambiguous = {name: choice.ambiguous_with(name) for name in effects}
    content = {
        "recording": recording,
        "verdict": verdict,
        "locations": [_location(place) for place in before],
        "effects": [_effect(name, choice, fitter.model) for name in effects],
        "ambiguous_with": ambiguous,
        "outside": {
            name: {"what": one.words, "better_by": one.gain - choice.gains[name], "z": one.z}
            for name, one in outside.items()
        },
        "ruled_out": choice.ruled_out,
        "undecided": choice.undecided,
        "alignment": {
            name: {"value": value, "ci95": interval(value, errors.nuisance[name])}
            for name, value in choice.chosen.fit.nuisance.items()
        },
        **metrics,
        "excess_removed": removed,
        "excess_rms_removed": excess_rms_removed(**metrics["held_out"][f"rms_{prepared.look.unit}"])
        if effects
        else None,
        "remainder_sd": remainder_sd(prepared, choice.chosen),
        "unexplained": [_location(place) for place in left],
        "doubts": doubted,
        "declared": known,
        "next_measurement": next_measurements(choice, bool(left), prepared.look.ranked),
        "held_out_data": prepared.held,
        "noise_from_one_repeat": prepared.single,
        "caveats": caveats(prepared, choice, fitter.model.tube_kvp, left),
    }
    if choice.piece is not None:
        content["object"] = content_of([choice.piece], False, excess(prepared, choice.baseline.fit))
    elif pieces:
        content["object"] = content_of(pieces, True)
    return Diagnosis(choice, before, after, content | {"sentence": sentence(content)})


def excess_removed(prepared: Prepared, baseline: Trial, chosen: Trial, standing: list[Location]) -> float | None:
    """Share of the difference beyond noise, on held-out data, that the effects remove.

    Removed is what the log score gains, twice (chi-square). Left is the largest sum of products of fitted and held-out
    standardised residuals, whose noises are independent, where it stands LEFT_SD standard deviations above 0: over the
    places of any domain that still stands out, since a sum over all rays alone would drown a difference of a few places
    in their noise; and over all rays, less what the model's own numerical errors put into both.

    Parameters
    ----------
    standing : list of Location
        Places that are significant after.

    Returns
    -------
    float or None
        None if there is no difference.
    """
    gained = 2 * (chosen.score - baseline.score)
    if not gained > 0:
        return None
    fitted, held = prepared.halves(chosen.fit)
    sums = []
    if domains := {place.domain for place in standing} - set(NO_SIGNED_MAP):
        maps = [
            {place.domain: place.map.ravel() for place in prepared.domains(half, chosen.fit)} for half in (fitted, held)
        ]
        sums += [(maps[0][domain] * maps[1][domain], 0.0) for domain in domains & maps[0].keys()]
    common = held.in_common(fitted)
    sums.append((common.products, sum(float(one.sum()) for one in common.numerical)))
    left = [float(one.sum()) - error for one, error in sums if one.sum() - error > LEFT_SD * np.sqrt((one**2).sum())]
    return gained / (gained + max(left, default=0.0))


def remainder_sd(prepared: Prepared, chosen: Trial) -> float | None:
    """What a fit leaves in common on fitted and held-out data, over all rays or voxels.

    `excess_removed` is a share of what was there: beside a large difference it hides a remainder that this shows.

    Returns
    -------
    float or None
        In standard deviations of what noise alone gives, at least 0; beyond what the model's own numerical errors put
        into both. None where the halves share no ray.
    """
    fitted, held = prepared.halves(chosen.fit)
    common = held.in_common(fitted)
    return common.z() if common.there.any() else None


def excess_rms_removed(before: float, after: float, floor: float) -> float | None:
    """Share of the root mean square beyond noise that is removed.

    1 - sqrt((after^2 - floor^2) / (before^2 - floor^2)): noise adds in squares, so that what is left after the root is
    that of the mean difference alone.

    Parameters
    ----------
    before, after, floor : float
        Root mean squares of the difference, and of noise alone.

    Returns
    -------
    float or None
        None if there is no excess before.
    """
    if before <= floor:
        return None
    return float(1 - np.sqrt(max(0.0, after**2 - floor**2) / (before**2 - floor**2)))


def metrics_of(prepared: Prepared, choice: Choice, held_out: bool) -> dict:
    """Numbers before, after, and what noise alone would give.

    Parameters
    ----------
    held_out : bool
        Of the data held out; False: of those fitted.

    Returns
    -------
    dict of str to dict of str to float
        {metric: {"before", "after", "floor": value}}: the RMS in the unit of `look`, chi-square per datum by part, and,
        of the data held out, the log score, which has no floor.
    """
    fits = {"before": choice.baseline.fit, "after": choice.chosen.fit}
    halves = {key: prepared.half(fit, held_out) for key, fit in fits.items()}
    data, weights = halves["after"].data, halves["after"].weights
    rms = {key: float(np.sqrt((prepared.difference(fit, held_out) ** 2).mean())) for key, fit in fits.items()}
    floor = float(np.sqrt((prepared.variance[data.usable] / data.n).mean()))
    found = {f"rms_{prepared.look.unit}": {**rms, "floor": floor}}
    for place, name in enumerate(data.parts):
        count = int((weights[place] > 0).sum())
        if not count:
            continue
        found[f"chi_square_{name.replace(' ', '_')}"] = {
            key: float((weights[place] * half.residuals[place] ** 2).sum()) / count for key, half in halves.items()
        } | {"floor": 1.0}
    found["log_score"] = {"before": choice.baseline.score, "after": choice.chosen.score} if held_out else {}
    return {key: value for key, value in found.items() if value}


def _effect(name: str, choice: Choice, model: Model) -> dict:
    effect, fit, errors = load(name), choice.chosen.fit, _errors(choice).physics
    parameters = {one.name: one for one in (*effect.parameters, *model.parameters(name))}
    units = {key: one.unit for key, one in parameters.items()}
    ranges = {key: (one.low, one.high) for key, one in parameters.items()}
    return {
        "name": name,
        "physics": effect.physics,
        "parameters": {
            key: {
                "value": value,
                **intervals(value, fit.errors[name].get(key, 0.0), errors[name].get(key, 0.0), *ranges[key]),
                "unit": units[key],
            }
            for key, value in fit.physics[name].items()
            if not parameters[key].stated  # which no fit has found
        },
        "evidence": {"held_out_gain": choice.gains[name], "p": choice.p[name]},
    }


def _errors(choice: Choice) -> Errors:
    """Of the numbers of the chosen fit."""
    fit = choice.chosen.fit
    return choice.errors or Errors(fit.errors, fit.nuisance_errors)


def _location(place: Location) -> dict:
    return {"domain": place.domain, "where": place.where, "z": place.z, "p": place.p, "map": f"{place.domain}.npy"}


def next_measurements(choice: Choice, something_left: bool, ranked: bool) -> list[str]:
    """What would settle the verdict.

    Parameters
    ----------
    ranked : bool
        Whether further recordings of this kind can be ranked (`snakemake next_measurement`); if not, every ambiguous
        effect has its own and its rivals' tests.
    """
    found = [OBJECT_TURNED] if choice.piece else []
    for name in choice.chosen.fit.effects:
        rivals = choice.ambiguous_with(name)
        if rivals and ranked:
            either = " or ".join(label(one) for one in (name, *rivals))
            found.append(f"{either}: snakemake next_measurement ranks the recordings that would tell them apart")
        elif rivals:
            found += [
                f"{label(name)} or {label(rival)}: {load(one).settled_by}" for rival in rivals for one in (name, rival)
            ]
    if something_left and not found:
        found = ["the same scan again after the air and geometry calibrations, to see whether what is left stays"]
    return list(dict.fromkeys(found))
