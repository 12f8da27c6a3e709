"""Which recording to make next: what is still ambiguous, and how well each further one is expected to settle it."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations
from types import MappingProxyType

import numpy as np

from ...physics.effect import load
from ..candidate_effects import OF_ONE_SCAN
from ..fitting.fit import Fit, Problem
from ..fitting.joint_fit import JointFitter
from ..fitting.model import Model
from ..fitting.templates import SMALL, templates, varied
from ..projections.prepared import BY_VIEW, PreparedScans
from ..selection.forward_selection import AS_GOOD
from .candidates import further
from .information import Key, MeasurementInformation, correlation, cosines, expected, information_gain, profiled, summed
from .measurement import Conditions, DarkFrames, Scan

ALIKE = 0.9  # |correlation| from which an effect is tried in the place of another of a scanner; a choice
# Standard deviations that a number changes the data by over its range, if they tell anything of it; a choice.
UNTOLD_SD = 10.0
Fits = Mapping[str, Fit]  # by recording
Pair = tuple[str, str]


@dataclass(frozen=True)
class Ambiguity:
    """Effects of which each explains the recordings as well in the place of the others.

    Attributes
    ----------
    fits : dict of str to dict of str to Fit
        {effect: {recording: the fit with it}}; the first is the one that was chosen.
    """

    fits: dict[str, Fits]

    @property
    def pairs(self) -> list[Pair]:
        """Every two of its effects."""
        return list(combinations(self.fits, 2))


@dataclass(frozen=True)
class Ranked:
    """A further recording, and what it is expected to tell.

    Attributes
    ----------
    gain : float
        Expected gain of information about the ambiguous effects, nats: half of the logarithm of the determinant of
        their Fisher information, with all else profiled out, after less before.
    scores : dict of tuple of str to float
        {two effects: log score on data held out by which the wrong one is expected to fall behind the right one, of
        the two ways round the lesser}, of all recordings together.
    alike : dict of tuple of str to float
        {two effects: |correlation|} of all recordings together.
    """

    measurement: Scan | DarkFrames
    gain: float
    scores: dict[Pair, float]
    alike: dict[Pair, float]

    @property
    def least(self) -> float | None:
        """The least of the scores; None without pairs."""
        return min(self.scores.values(), default=None)


@dataclass(frozen=True)
class Next:
    """What is ambiguous, and what would settle it.

    Attributes
    ----------
    now : Ranked
        As the recordings have it that there are; its gain is 0.
    ranked : list of Ranked
        The best first.
    """

    ambiguities: list[Ambiguity]
    now: Ranked
    ranked: list[Ranked]


def rank(
    prepared: Mapping[str, PreparedScans],
    chosen: Fits,
    ambiguities: Sequence[Ambiguity],
    measurements: Sequence[Scan | DarkFrames],
    protocols: Mapping[str, str] | None = None,
) -> Next:
    """Rank further recordings by the information that they are expected to give of ambiguous effects.

    Those that are expected to leave two of the effects as good as each other (AS_GOOD) come last.
    Without an ambiguity it is that of the effects that were chosen.

    Parameters
    ----------
    prepared : mapping of str to PreparedScans
        By recording; further ones are like the first.
    chosen : mapping of str to Fit
        By recording.
    protocols : mapping of str to str, optional
        Of every recording; further ones are of the first one's. None: there is one alone.
    """
    protocols = dict.fromkeys(prepared, "") if protocols is None or len(set(protocols.values())) < 2 else protocols
    names = dict.fromkeys(name for one in ambiguities for name in one.fits)
    group = tuple(names) or next(iter(chosen.values())).effects
    explanations: dict[str, Fits] = {"": _all_at_once(prepared, chosen, ambiguities)}
    for number, one in enumerate(ambiguities):
        explanations |= {f"{number} {name}": fits for name, fits in one.fits.items()}
    there = _told_of(prepared, explanations, chosen, protocols)
    untold = {label: _untold(parts) for label, parts in there.items()}
    if any(untold.values()):
        explanations = {
            label: {name: _without(prepared[name], fit, untold[label]) for name, fit in fits.items()}
            for label, fits in explanations.items()
        }
        there = _told_of(prepared, explanations, chosen, protocols)
    keys = [key for key in _keys(there[""], group) if key[-2:] not in untold[""]]
    first = next(iter(prepared))
    model, conditions = prepared[first].fitter.model, conditions_of(prepared[first])

    def made(measurement, parts: Mapping[str, list[MeasurementInformation]]) -> Ranked:
        before, after = summed(there[""]), summed(parts[""])
        scores, alike = {}, {}
        for number, one in enumerate(ambiguities):
            for pair in one.pairs:
                ways = permutations(f"{number} {name}" for name in pair)
                scores[pair] = min(expected(parts, *way) for way in ways)
                alike[pair] = correlation(after, *([key for key in keys if name in key] for name in pair))
        return Ranked(measurement, information_gain(before, after, keys) if keys else 0.0, scores, alike)

    ranked = []
    for measurement in measurements:
        parts, beside = {}, None
        for label, fits in explanations.items():
            fit = fits[first]
            made_of = measurement.tells(
                model,
                fit.effects,
                fit,
                conditions,
                OF_ONE_SCAN,
                beside=beside,
                weighed=chosen[first],
                protocol=protocols[first],
            )
            beside = beside or made_of
            parts[label] = [*there[label], made_of]
        ranked.append(made(measurement, parts))
    ranked.sort(key=order)
    return Next(list(ambiguities), made(None, there), ranked)


def _told_of(
    prepared, explanations: Mapping[str, Fits], chosen: Fits, protocols: Mapping[str, str]
) -> dict[str, list[MeasurementInformation]]:
    """What the recordings that there are tell, by explanation."""
    there: dict[str, list[MeasurementInformation]] = {}
    for label, fits in explanations.items():
        beside = there.get("", [None] * len(fits))
        parts = zip(fits.items(), beside, strict=True)
        there[label] = [
            _as_it_is(prepared[name], name, fit, told_of, chosen[name], protocols[name])
            for (name, fit), told_of in parts
        ]
    return there


def _untold(parts: Sequence[MeasurementInformation]) -> set[Pair]:
    """Numbers of effects that no recording tells anything of, over the whole of their range.

    Explanations differ by them as chance had it, and another recording that tells them settles nothing.

    Parameters
    ----------
    parts : sequence of MeasurementInformation
        Of all recordings.

    Returns
    -------
    set of tuple of str
        (effect, parameter).
    """
    found: dict[Pair, bool] = {}
    for part in parts:
        for key, change, room in zip(part.keys, part.changes.T, part.room, strict=True):
            if "alignment" not in key:
                nothing = np.linalg.norm(change) * (room[1] - room[0]) < UNTOLD_SD
                found[key[-2:]] = found.get(key[-2:], True) and bool(nothing)
    return {key for key, nothing in found.items() if nothing}


def _without(prepared: PreparedScans, fit: Fit, untold: Collection[Pair]) -> Fit:
    """A fit with such numbers at nothing, where they have such a value."""
    physics = {name: dict(values) for name, values in fit.physics.items()}
    for effect, parameter in untold:
        for one in varied(prepared.fitter.model.parameters(effect)):
            if one.name == parameter:
                physics[effect][parameter] = one.neutral
    return replace(fit, physics=physics)


def _as_it_is(
    prepared: PreparedScans, name: str, fit: Fit, beside: MeasurementInformation | None, weighed: Fit, protocol: str
) -> MeasurementInformation:
    """What a recording tells that there is, reckoned as that of a further one is."""
    model = prepared.fitter.model
    scan = Scan(name, "", model.chain.scene, model.chain.geometry)
    conditions = conditions_of(prepared)
    return scan.tells(model, fit.effects, fit, conditions, OF_ONE_SCAN, True, beside, weighed, protocol)


def conditions_of(prepared: PreparedScans) -> Conditions:
    """How a recording was repeated: a further one is expected to be repeated as often."""
    share = 0.5 if prepared.held == BY_VIEW else 1.0
    return Conditions(prepared.data.n, share, prepared.data.white is not None)


def _all_at_once(prepared, chosen: Fits, ambiguities: Sequence[Ambiguity]) -> Fits:
    """The chosen fit, and beside it the other effects, switched off as far as they can be."""
    found = {}
    for name, fit in chosen.items():
        physics, model = dict(fit.physics), prepared[name].fitter.model
        for one in ambiguities:
            for effect, fits in one.fits.items():
                if effect not in physics:
                    physics[effect] = _switched_off(model, effect, fits[name].physics[effect])
        declared = set(physics) - set(fit.effects) - set(fit.physics)
        found[name] = replace(fit, effects=(*fit.effects, *sorted(declared)), physics=physics)
    return found


def _switched_off(model: Model, effect: str, values: Mapping[str, float]) -> dict[str, float]:
    off = {one.name: one.neutral for one in varied(model.parameters(effect))}
    return {**values, **off}


def _keys(parts: Sequence[MeasurementInformation], group: Sequence[str]) -> list[Key]:
    """The numbers of effects: shared ones, and those of every recording that there is."""
    keys = dict.fromkeys(key for part in parts for key in part.keys)
    return [key for key in keys if "alignment" not in key and set(group) & set(key[-2:-1])]


def alikeness(
    prepared: Mapping[str, PreparedScans], baseline: Fits, names: Sequence[str]
) -> dict[Pair, dict[str, float]]:
    """How alike every two effects are, in each recording and in all of them together.

    Parameters
    ----------
    baseline : mapping of str to Fit
        By recording, of the alignment alone, which is projected out.
    names : sequence of str
        Effects; patterns of pixels, which have no numbers, are left out.

    Returns
    -------
    dict of tuple of str to dict of str to float
        {two effects: {recording, or "" for all together: the largest |cosine| of a number of the one and a number of
        the other}}; NaN where one shows nothing.
    """
    names = [name for name in names if not load(name).pattern]
    parts = {
        recording: _with_templates(prepared[recording], fit, recording, names) for recording, fit in baseline.items()
    }
    found: dict[Pair, dict[str, float]] = {pair: {} for pair in combinations(names, 2)}
    for recording in [*parts, ""]:
        every = list(parts.values()) if not recording else [parts[recording]]
        keys = [key for key in dict.fromkeys(key for one in every for key in one.keys) if key[0] == "template"]
        sums = summed(every)
        matrix = profiled(sums, keys)
        whole = np.array([sums.information[(place := sums.keys.index(key)), place] for key in keys])
        small = np.diag(matrix) <= SMALL * whole  # all of it is taken up
        matrix[small], matrix[:, small] = np.nan, np.nan
        alike = cosines(matrix)
        for pair in found:
            rows, columns = ([i for i, key in enumerate(keys) if key[1] == name] for name in pair)
            values = alike[np.ix_(rows, columns)]
            found[pair][recording] = float(np.nanmax(values)) if np.isfinite(values).any() else float("nan")
    return found


def _with_templates(prepared: PreparedScans, fit: Fit, recording: str, names: Sequence[str]) -> MeasurementInformation:
    """What a recording tells of the alignment and of all effects at nothing; of those never at nothing, as typical."""
    model, conditions = prepared.fitter.model, conditions_of(prepared)
    scan = Scan(recording, "", model.chain.scene, model.chain.geometry)
    weak = [name for name in names if varied(model.parameters(name)) and name not in fit.physics]
    off = {
        name: _switched_off(model, name, {one.name: one.typical for one in model.parameters(name)} | model.known(name))
        for name in weak
    }
    beside = scan.tells(
        model, tuple(weak), replace(fit, effects=tuple(weak), physics=fit.physics | off), conditions, (), again=True
    )
    keys = [("template", *key) if key[0] in weak else key for key in beside.keys]
    rows = []
    problem = scan.problem(model, (), fit, conditions, again=True)
    point = replace(fit, nuisance=_named(problem), linearisation=problem.linearisation)
    for name in names:
        if name in weak or name in fit.physics:
            continue
        made = templates(problem.fitter, point, name)
        rows.append(made)
        keys += [("template", name, str(place)) for place in range(len(made))]
    more = len(keys) - len(beside.keys)
    none = np.zeros(more)
    known = np.array(
        [0.0 if key[0] == "template" else value for key, value in zip(keys, beside.knowledge, strict=False)]
    )
    return MeasurementInformation(
        tuple(keys),
        np.hstack([beside.changes, *(one.T for one in rows)]),
        beside.predicted,
        np.concatenate([known, none]),
        np.vstack([beside.room, np.tile([-np.inf, np.inf], (more, 1))]),
        np.concatenate([beside.steps, none]),
    )


def _named(problem: Problem) -> dict[str, float]:
    """The alignment where a problem begins, by name."""
    values = problem.start[len(problem.unknowns) :]
    return {one.name: float(value) for one, value in zip(problem.aligned, values, strict=True)}


def settles(one: Ranked) -> bool:
    """Whether a further recording is expected to leave no ambiguity."""
    return one.least is not None and one.least >= AS_GOOD


def order(one: Ranked) -> tuple[bool, float]:
    """By what the best come first: those that leave no pair alike, and among them by gain.

    Of a group of three much may be learnt by what still leaves two of them alike.

    Returns
    -------
    tuple of bool and float
        To be sorted by.
    """
    return one.least is not None and not settles(one), -one.gain


def possible(prepared: Mapping[str, PreparedScans], section: Mapping = MappingProxyType({})) -> list[Scan | DarkFrames]:
    """The further recordings of `further`, like the first recording that there is.

    Parameters
    ----------
    section : mapping
        diagnosis.recordings.<name> of that recording.
    """
    chain = next(iter(prepared.values())).fitter.model.chain
    return further(chain.geometry, chain.scene, section)


def found_in(diagnosis: Mapping) -> dict[str, list[str]]:
    """{effect that a diagnosis names: effects that explain the recording as well in its place}, without patterns.

    Parameters
    ----------
    diagnosis : mapping
        What diagnosis.json holds.
    """
    rivals = diagnosis["ambiguous_with"]
    named = [one["name"] for one in diagnosis["effects"] if not load(one["name"]).pattern]
    return {name: [other for other in rivals.get(name, []) if not load(other).pattern] for name in named}


def refitted(prepared: PreparedScans, name: str, found: Mapping[str, Sequence[str]]) -> tuple[Fits, list[Ambiguity]]:
    """The fits of one recording that its diagnosis speaks of.

    Parameters
    ----------
    name : str
        Of the recording.
    found : mapping of str to sequence of str
        As `found_in` gives it.
    """
    fitter = prepared.fitter
    chosen = fitter.fit(tuple(found), fitter.fit(()))
    ambiguities = []
    for effect, rivals in found.items():
        rest = tuple(other for other in found if other != effect)
        without = fitter.fit(rest, chosen) if rivals else None
        fits = {effect: {name: chosen}} | {one: {name: fitter.fit((*rest, one), without)} for one in rivals}
        if rivals:
            ambiguities.append(Ambiguity(fits))
    return {name: chosen}, ambiguities


def refitted_jointly(
    prepared: Mapping[str, PreparedScans],
    effects: Sequence[str],
    others: Sequence[str],
    alike: Mapping[Pair, Mapping],
    protocols: Mapping[str, str] | None = None,
) -> tuple[Fits, list[Ambiguity]]:
    """The fits of a scanner's recordings: its effects, and those alike that explain the recordings as well.

    Parameters
    ----------
    effects : sequence of str
        That the scanner's diagnosis names.
    others : sequence of str
        That may be tried in their place.
    alike : mapping
        As `alikeness` gives it: what is less alike than ALIKE of all recordings together is not tried.
    protocols : mapping of str to str, optional
        Of each recording, as JointFitter takes them.
    """
    together = JointFitter({name: one.fitter for name, one in prepared.items()}, protocols)
    chosen, ambiguities = together.fit(tuple(effects)), []

    def score(fits: Fits) -> float:
        return sum(one.score(fits[name]) for name, one in together.fitters.items())

    for effect in effects:
        rest = tuple(other for other in effects if other != effect)
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
