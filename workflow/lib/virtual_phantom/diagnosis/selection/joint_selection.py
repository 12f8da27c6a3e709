"""Which effects explain several recordings of one scanner: chosen by recordings that were not fitted."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from scipy import stats

from ...base.errors import InputError
from ...io.schema import defaults_of
from ...physics.effect import offered
from ...statistics.multiplicity import bonferroni
from ..fitting.fit import Fit
from ..fitting.joint_fit import JointFit, JointFitter
from .forward_selection import ALPHA, LEAST_GAIN, SCREEN
from .screening import screened

TRIED = 3  # best effects of the fitted data that are held against recordings left out; a choice that bounds the time
MOST_FOLDS = 12  # times that recordings are left out; a choice that bounds the time
MOST_MISSED = 0.5  # share of the recordings that an effect may make worse: what one scan has alone is not the scanner's


@dataclass(frozen=True)
class JointChoice:
    """What was chosen.

    Attributes
    ----------
    baseline, chosen : JointFit
        The alignments alone, and with the effects; fitted to all recordings.
    before, left_out : dict of str to Fit
        By recording, its own alignment with what those that were not left out with it say is declared, and with all of
        their physics.
    scores : dict of str to dict of str to float
        By recording, log score on its data held out: "before", and "after" with the physics of the others.
    gains : dict of str to float
        {effect: log score, over all recordings left out, that is lost without it}.
    p : dict of str to float
        {effect: chance of such a likelihood ratio when it was taken, times the candidates}.
    without : dict of str to JointFit
        {effect: the fit without it, all else refitted}.
    """

    baseline: JointFit
    chosen: JointFit
    before: dict[str, Fit]
    left_out: dict[str, Fit]
    scores: dict[str, dict[str, float]]
    gains: dict[str, float]
    p: dict[str, float]
    without: dict[str, JointFit]


class _Judge:
    """Scores of sets of effects on recordings left out, each made once."""

    def __init__(self, together: JointFitter, baseline: JointFit, left_together: Sequence[Collection[str]]):
        self.together, self.left_together = together, left_together
        self._fits: dict[tuple[str, ...], dict[str, Fit]] = {}
        self.before = self.fits((), baseline)
        self.none = {name: one.score(self.before[name]) for name, one in together.fitters.items()}

    def fits(self, effects: tuple[str, ...], given: JointFit) -> dict[str, Fit]:
        key = tuple(sorted(effects))
        if key not in self._fits:
            found: dict[str, Fit] = {}
            for names in self.left_together:
                found |= self.together.left_out(names, effects, given)
            self._fits[key] = {name: found[name] for name in self.together.fitters}
        return self._fits[key]

    def scores(self, effects: tuple[str, ...], given: JointFit) -> dict[str, float]:
        if not effects:
            return self.none
        found = self.fits(effects, given)
        return {name: one.score(found[name]) for name, one in self.together.fitters.items()}


def left_together(names: Sequence[str], objects: Mapping[str, str] | None = None) -> list[list[str]]:
    """Which recordings are left out at a time: those of one object, where there are several; one otherwise.

    Parameters
    ----------
    names : sequence of str
        Of the recordings.
    objects : mapping of str to str, optional
        {recording: what was scanned}; None: each is of an object of its own.

    Returns
    -------
    list of list of str
        MOST_FOLDS at most: of more objects some are left out together.
    """
    found: dict[str, list[str]] = {}
    several = objects is not None and len(set(objects.values())) > 1
    for name in names:
        found.setdefault(objects[name] if several else name, []).append(name)
    groups = list(found.values())
    return [
        [name for group in groups[first::MOST_FOLDS] for name in group] for first in range(min(MOST_FOLDS, len(groups)))
    ]


def choose_jointly(
    together: JointFitter,
    candidates: Sequence[str],
    accuracy: Mapping[str, float] | None = None,
    objects: Mapping[str, str] | None = None,
) -> JointChoice:
    """Choose effects one at a time while recordings that were not fitted gain by them.

    As many as the data carry. An effect must gain more over all recordings left out than the models' own inexactness
    may set apart, make no more than half of them worse, and be no chance on the data fitted; those that later ones made
    needless are dropped. What errors of declared physics may make up is no evidence.

    Parameters
    ----------
    together : JointFitter
        Of two recordings or more.
    accuracy : mapping of str to float, optional
        As core.attribute.choose takes it.
    objects : mapping of str to str, optional
        As left_together takes them.

    Raises
    ------
    InputError
        For a single recording.
    """
    if len(together.fitters) < 2:
        raise InputError("a joint diagnosis needs two recordings: each is judged by the physics of the others")
    accuracy = defaults_of("diagnosis", "model_accuracy") if accuracy is None else accuracy
    baseline = together.fit(())
    judge, current = _Judge(together, baseline, left_together(list(together.fitters), objects)), baseline
    gains: dict[str, float] = {}
    p: dict[str, float] = {}

    def least(names: Sequence[str]) -> float:
        return max(LEAST_GAIN, sum(accuracy.get(name, accuracy["default"]) ** 2 * gains[name] for name in names))

    left = list(candidates)
    while now := offered(left, together.whole(current.effects)):
        tried = [together.fit((*current.effects, name), current) for name in _sure(together, current, now, accuracy)]
        if not tried:
            break
        tried.sort(key=lambda one: one.chi_square)
        here = judge.scores(current.effects, current)
        best = max(tried[:TRIED], key=lambda one: _gain(judge.scores(one.effects, one), here))
        there, new = judge.scores(best.effects, best), best.effects[-1]
        chance = _chance(best, current, len(candidates))
        worse = sum(there[name] < here[name] for name in there)
        if (gain := _gain(there, here)) < least(current.effects) or chance > ALPHA or worse > MOST_MISSED * len(there):
            break
        current, gains[new], p[new] = best, gain, chance
        left.remove(new)
        for name in current.effects[:-1]:  # what the new one has made needless
            rest = together.fit(tuple(other for other in current.effects if other != name), current)
            if _gain(judge.scores(current.effects, current), judge.scores(rest.effects, rest)) < LEAST_GAIN:
                current = rest
    after = judge.scores(current.effects, current)
    without = {
        name: together.fit(tuple(other for other in current.effects if other != name), current)
        for name in current.effects
    }
    lost = {name: _gain(after, judge.scores(rest.effects, rest)) for name, rest in without.items()}
    fits = judge.fits(current.effects, current)
    scores = {name: {"before": judge.none[name], "after": after[name]} for name in after}
    chances = {name: p[name] for name in current.effects}
    return JointChoice(baseline, current, judge.before, fits, scores, lost, chances, without)


def _gain(there: Mapping[str, float], here: Mapping[str, float]) -> float:
    return sum(there[name] - here[name] for name in there)


def _sure(together: JointFitter, current: JointFit, names: Sequence[str], accuracy: Mapping[str, float]) -> list[str]:
    """Effects whose matched filters show more than errors of declared physics may make up; all where none is declared.

    Each recording has errors of its own here, which allows them more than one model does.

    Parameters
    ----------
    names : sequence of str
        Of effects.
    accuracy : mapping of str to float
        As core.attribute.choose takes it.
    """
    if not any(one.model.declared for one in together.fitters.values()):
        return list(names)
    scans = [(one, screened(one, current.fits[key], names, accuracy=accuracy)) for key, one in together.fitters.items()]

    def sure(name: str) -> bool:
        found = [filters[name] for _, filters in scans]
        gain = sum(one.sure.gain for one in found)
        numbers = sum(max(1, len(one.model.unknowns((name,)))) for one, _ in scans)
        chance = float(bonferroni(stats.chi2.sf(gain, numbers), len(names)))
        return any(one.blind for one in found) or (gain > LEAST_GAIN and chance < SCREEN)

    return [name for name in names if sure(name)]


def _chance(best: JointFit, current: JointFit, candidates: int) -> float:
    lost = max(0.0, current.chi_square - best.chi_square)
    return float(bonferroni(stats.chi2.sf(lost, max(1, best.free - current.free)), candidates))
