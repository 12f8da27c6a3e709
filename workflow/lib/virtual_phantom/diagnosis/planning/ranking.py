"""Ranking of candidate measurements by how well they are expected to resolve the ambiguities of a diagnosis."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations

import numpy as np

from ...physics.effect import load, scan_effects
from ..fitting.fit import Fit
from ..fitting.joint_fit import JointFitter
from ..fitting.model import Model
from ..fitting.templates import SMALL, neutral_values, templates, varied
from ..projections.prepared import BY_VIEW, PreparedScans
from ..selection.forward_selection import AS_GOOD, without_effect
from .candidates import candidate_measurements
from .information import (
    Key,
    MeasurementInformation,
    correlation,
    cosines,
    expected,
    information_gain,
    normal_equations,
    profiled_information,
)
from .measurement import Conditions, DarkFrames, FurtherScan

ALIKE = 0.9  # |correlation| from which an effect is tried as an alternative for a scanner; a choice
# Least change of the data over the range of a parameter that they determine, in standard deviations; a choice.
LEAST_CHANGE_SD = 10.0
Fits = Mapping[str, Fit]  # by recording
Pair = tuple[str, str]


@dataclass(frozen=True)
class Ambiguity:
    """Effects that explain the recordings equally well.

    Attributes
    ----------
    fits : dict of str to dict of str to Fit
        {effect: {recording: fit with this effect}}, the chosen effect first.
    """

    fits: dict[str, Fits]

    @property
    def pairs(self) -> list[Pair]:
        """All pairs of the effects."""
        return list(combinations(self.fits, 2))


@dataclass(frozen=True)
class RankedMeasurement:
    """A measurement with its expected information.

    Attributes
    ----------
    gain : float
        Expected gain of information about the ambiguous effects, nats (information.information_gain).
    scores : dict of tuple of str to float
        {pair of effects: expected difference in held-out log score of all recordings together}. It is the smaller of
        the two values with either effect as the true one.
    alike : dict of tuple of str to float
        {pair of effects: |correlation|} for all recordings together.
    """

    measurement: FurtherScan | DarkFrames
    gain: float
    scores: dict[Pair, float]
    alike: dict[Pair, float]

    @property
    def least(self) -> float | None:
        """Smallest score; None without pairs."""
        return min(self.scores.values(), default=None)


@dataclass(frozen=True)
class MeasurementRanking:
    """Ambiguities of a diagnosis, and measurements that resolve them.

    Attributes
    ----------
    now : RankedMeasurement
        Values of the existing recordings, with a gain of 0.
    ranked : list of RankedMeasurement
        The best first.
    """

    ambiguities: list[Ambiguity]
    now: RankedMeasurement
    ranked: list[RankedMeasurement]


def rank(
    prepared: Mapping[str, PreparedScans],
    chosen: Fits,
    ambiguities: Sequence[Ambiguity],
    measurements: Sequence[FurtherScan | DarkFrames],
    protocols: Mapping[str, str] | None = None,
) -> MeasurementRanking:
    """Rank measurements by their expected information about ambiguous effects.

    Measurements that are expected to leave a pair of effects indistinguishable (AS_GOOD) come last. Without an
    ambiguity, measurements are ranked by the information about the chosen effects.

    Parameters
    ----------
    prepared : mapping of str to PreparedScans
        By recording. Measurements are modeled like the first.
    chosen : mapping of str to Fit
        By recording.
    protocols : mapping of str to str, optional
        By recording. Measurements have the protocol of the first. None: a single protocol.
    """
    protocols = dict.fromkeys(prepared, "") if protocols is None or len(set(protocols.values())) < 2 else protocols
    names = dict.fromkeys(name for ambiguity in ambiguities for name in ambiguity.fits)
    group = tuple(names) or next(iter(chosen.values())).effects
    explanations: dict[str, Fits] = {"": _all_at_once(prepared, chosen, ambiguities)}
    for number, ambiguity in enumerate(ambiguities):
        explanations |= {f"{number} {name}": fits for name, fits in ambiguity.fits.items()}
    there = _information_of_recordings(prepared, explanations, chosen, protocols)
    undetermined = {label: _undetermined(parts) for label, parts in there.items()}
    if any(undetermined.values()):
        for label, fits in explanations.items():
            explanations[label] = {
                name: _without(prepared[name], fit, undetermined[label]) for name, fit in fits.items()
            }
        there = _information_of_recordings(prepared, explanations, chosen, protocols)
    keys = [key for key in _keys(there[""], group) if key[-2:] not in undetermined[""]]
    first = next(iter(prepared))
    model, conditions = prepared[first].fitter.model, conditions_of(prepared[first])

    def made(measurement, parts: Mapping[str, list[MeasurementInformation]]) -> RankedMeasurement:
        before, after = normal_equations(there[""]), normal_equations(parts[""])
        scores, alike = {}, {}
        for number, ambiguity in enumerate(ambiguities):
            for pair in ambiguity.pairs:
                ways = permutations(f"{number} {name}" for name in pair)
                score = min(expected(parts, *way) for way in ways)
                scores[pair] = min(score, scores.get(pair, math.inf))  # two ambiguities may have the same pair
                alike[pair] = correlation(after, *([key for key in keys if name in key] for name in pair))
        return RankedMeasurement(measurement, information_gain(before, after, keys) if keys else 0.0, scores, alike)

    ranked = []
    for measurement in measurements:
        parts, beside = {}, None
        for label, fits in explanations.items():
            fit = fits[first]
            more = {"beside": beside, "noise_fit": chosen[first], "protocol": protocols[first]}
            made_of = measurement.information(model, fit, conditions, scan_effects(), **more)
            beside = beside or made_of
            parts[label] = [*there[label], made_of]
        ranked.append(made(measurement, parts))
    ranked.sort(key=order)
    return MeasurementRanking(list(ambiguities), made(None, there), ranked)


def _information_of_recordings(
    prepared, explanations: Mapping[str, Fits], chosen: Fits, protocols: Mapping[str, str]
) -> dict[str, list[MeasurementInformation]]:
    """Return the information of the existing recordings, by explanation."""
    there: dict[str, list[MeasurementInformation]] = {}
    for label, fits in explanations.items():
        first, there[label] = there.get("", [None] * len(fits)), []
        for (name, fit), beside in zip(fits.items(), first, strict=True):
            model, conditions = prepared[name].fitter.model, conditions_of(prepared[name])
            more = {"existing": True, "beside": beside, "noise_fit": chosen[name], "protocol": protocols[name]}
            there[label].append(existing_scan(name, model).information(model, fit, conditions, scan_effects(), **more))
    return there


def existing_scan(name: str, model: Model) -> FurtherScan:
    """Return an existing recording as a measurement."""
    return FurtherScan(name, "", model.chain.scene, model.chain.geometry)


def _undetermined(parts: Sequence[MeasurementInformation]) -> set[Pair]:
    """Return the (effect, parameter) pairs that no recording determines over their range.

    The explanations have random values of these parameters, and measuring them does not resolve an ambiguity.
    """
    found: dict[Pair, bool] = {}
    for part in parts:
        for key, change, margins in zip(part.keys, part.changes.T, part.margins, strict=True):
            if "alignment" not in key:
                nothing = np.linalg.norm(change) * (margins[1] - margins[0]) < LEAST_CHANGE_SD
                found[key[-2:]] = found.get(key[-2:], True) and bool(nothing)
    return {key for key, nothing in found.items() if nothing}


def _without(prepared: PreparedScans, fit: Fit, undetermined: Collection[Pair]) -> Fit:
    """Return a fit with undetermined parameters at their neutral value, if they have one."""
    physics = {name: dict(values) for name, values in fit.physics.items()}
    for effect, parameter in undetermined:
        for number in varied(prepared.fitter.model.parameters(effect)):
            if number.name == parameter:
                physics[effect][parameter] = number.neutral
    return replace(fit, physics=physics)


def conditions_of(prepared: PreparedScans) -> Conditions:
    """Return the conditions of a recording, which are assumed for further measurements too."""
    share = 0.5 if prepared.held_out_text == BY_VIEW else 1.0
    return Conditions(prepared.data.n, share, prepared.data.white is not None)


def _all_at_once(prepared, chosen: Fits, ambiguities: Sequence[Ambiguity]) -> Fits:
    """Return the chosen fits with the ambiguous effects added at their neutral values, if they have any."""
    found = {}
    for name, fit in chosen.items():
        physics, model = dict(fit.physics), prepared[name].fitter.model
        for ambiguity in ambiguities:
            for effect, fits in ambiguity.fits.items():
                if effect not in physics:
                    physics[effect] = fits[name].physics[effect] | neutral_values(model.parameters(effect))
        added = set(physics) - set(fit.effects) - set(fit.physics)
        found[name] = replace(fit, effects=(*fit.effects, *sorted(added)), physics=physics)
    return found


def _keys(parts: Sequence[MeasurementInformation], group: Sequence[str]) -> list[Key]:
    """Return the keys of the parameters of effects, shared or specific to an existing recording."""
    keys = dict.fromkeys(key for part in parts for key in part.keys)
    return [key for key in keys if "alignment" not in key and set(group) & set(key[-2:-1])]


def effect_similarity(
    prepared: Mapping[str, PreparedScans], baseline: Fits, names: Sequence[str]
) -> dict[Pair, dict[str, float]]:
    """Return the similarity of every two effects, in each recording and in all of them together.

    Parameters
    ----------
    baseline : mapping of str to Fit
        By recording: fit of the alignment alone, which is projected out.
    names : sequence of str
        Effects. Patterns of pixels have no parameters and are omitted.

    Returns
    -------
    dict of tuple of str to dict of str to float
        {pair of effects: {recording, or "" for all: largest |cosine| between their parameters}}; NaN if one has no
        influence.
    """
    names = [name for name in names if not load(name).pattern]
    parts = {
        recording: _with_templates(prepared[recording], fit, recording, names) for recording, fit in baseline.items()
    }
    found: dict[Pair, dict[str, float]] = {pair: {} for pair in combinations(names, 2)}
    for recording in [*parts, ""]:
        every = list(parts.values()) if not recording else [parts[recording]]
        keys = [key for key in dict.fromkeys(key for part in every for key in part.keys) if key[0] == "template"]
        sums = normal_equations(every)
        matrix = profiled_information(sums, keys)
        whole = np.array([sums.information[(place := sums.keys.index(key)), place] for key in keys])
        small = np.diag(matrix) <= SMALL * whole  # described by other parameters
        matrix[small], matrix[:, small] = np.nan, np.nan
        alike = cosines(matrix)
        for pair in found:
            rows, columns = ([i for i, key in enumerate(keys) if key[1] == name] for name in pair)
            values = alike[np.ix_(rows, columns)]
            found[pair][recording] = float(np.nanmax(values)) if np.isfinite(values).any() else float("nan")
    return found


def _with_templates(prepared: PreparedScans, fit: Fit, recording: str, names: Sequence[str]) -> MeasurementInformation:
    """Return the information about nuisance parameters and effects.

    Parameters of effects have their neutral value, or a typical value if there is none.
    """
    model, conditions = prepared.fitter.model, conditions_of(prepared)
    scan = existing_scan(recording, model)
    weak = [name for name in names if varied(model.parameters(name)) and name not in fit.physics]
    physics = dict(fit.physics)
    for name in weak:
        typical = {parameter.name: parameter.typical for parameter in model.parameters(name)}
        physics[name] = typical | model.known(name) | neutral_values(model.parameters(name))
    with_weak = replace(fit, effects=tuple(weak), physics=physics)
    beside = scan.information(model, with_weak, conditions, existing=True)
    keys = [("template", *key) if key[0] in weak else key for key in beside.keys]
    problem, rows = scan.problem(model, replace(fit, effects=()), conditions, existing=True), []
    point = replace(fit, nuisance=problem.named(problem.start)[1], linearization=problem.linearization)
    for name in (name for name in names if name not in weak and name not in fit.physics):
        made = templates(problem.fitter, point, name)
        rows.append(made)
        keys += [("template", name, str(place)) for place in range(len(made))]
    more = len(keys) - len(beside.keys)
    none, fixed = np.zeros(more), [key[0] == "template" for key in keys[: len(beside.keys)]]
    known = np.where(fixed, 0.0, beside.prior_precision)
    return MeasurementInformation(
        tuple(keys),
        np.hstack([beside.changes, *(row.T for row in rows)]),
        beside.predicted,
        np.concatenate([known, none]),
        np.vstack([beside.margins, np.tile([-np.inf, np.inf], (more, 1))]),
        np.concatenate([beside.steps, none]),
    )


def settles(ranked: RankedMeasurement) -> bool:
    """Return whether a measurement is expected to resolve all ambiguities."""
    return ranked.least is not None and ranked.least >= AS_GOOD


def order(ranked: RankedMeasurement) -> tuple[bool, float]:
    """Return the sort key: measurements that resolve all ambiguities first, then by gain.

    For a group of three effects, a measurement with a large gain may leave two of them indistinguishable.
    """
    return ranked.least is not None and not settles(ranked), -ranked.gain


def possible(prepared: Mapping[str, PreparedScans]) -> list[FurtherScan | DarkFrames]:
    """Return the candidate measurements for the first recording."""
    chain = next(iter(prepared.values())).fitter.model.chain
    return candidate_measurements(chain.geometry, chain.scene)


def found_in(diagnosis: Mapping) -> dict[str, list[str]]:
    """Return {missing effect: its indistinguishable alternatives} from diagnosis.json, without patterns."""
    rivals = diagnosis["ambiguous_with"]
    named = [effect["name"] for effect in diagnosis["effects"] if not load(effect["name"]).pattern]
    return {name: [other for other in rivals.get(name, []) if not load(other).pattern] for name in named}


def refit(prepared: PreparedScans, name: str, found: Mapping[str, Sequence[str]]) -> tuple[Fits, list[Ambiguity]]:
    """Refit a recording with its missing effects, and with each alternative; `found` is the result of `found_in`."""
    fitter = prepared.fitter
    chosen = fitter.fit(tuple(found), fitter.fit(()))
    ambiguities = []
    for effect, rivals in found.items():
        rest = without_effect(tuple(found), effect)
        without = fitter.fit(rest, chosen) if rivals else None
        fits = {effect: {name: chosen}} | {rival: {name: fitter.fit((*rest, rival), without)} for rival in rivals}
        if rivals:
            ambiguities.append(Ambiguity(fits))
    return {name: chosen}, ambiguities


def refit_jointly(
    prepared: Mapping[str, PreparedScans],
    effects: Sequence[str],
    others: Sequence[str],
    alike: Mapping[Pair, Mapping],
    protocols: Mapping[str, str] | None = None,
) -> tuple[Fits, list[Ambiguity]]:
    """Refit the recordings of a scanner with its missing effects, and with similar effects that explain as much.

    Parameters
    ----------
    alike : mapping
        Result of `effect_similarity`. Alternatives with a similarity below ALIKE are not tried.
    """
    together = JointFitter({name: recording.fitter for name, recording in prepared.items()}, protocols)
    chosen, ambiguities = together.fit(tuple(effects)), []

    def score(fits: Fits) -> float:
        return sum(fitter.score(fits[name]) for name, fitter in together.fitters.items())

    for effect in effects:
        rest = without_effect(tuple(effects), effect)
        fits = {effect: chosen.fits}
        for other in others:
            pair = (effect, other) if (effect, other) in alike else (other, effect)
            if other in effects or not alike[pair][""] >= ALIKE:
                continue
            tried = together.fit((*rest, other), chosen).fits
            if score(chosen.fits) - score(tried) < AS_GOOD:
                fits[other] = tried
        if len(fits) > 1:
            ambiguities.append(Ambiguity(fits))
    return chosen.fits, ambiguities
