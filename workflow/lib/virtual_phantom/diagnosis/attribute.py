"""Which effects explain the difference: chosen one at a time by data that were not fitted, with what could stand in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from scipy import stats

from .fit import Fit, Fitter
from .templates import screened

ALPHA = 0.001  # of an effect's likelihood ratio, over all candidates
LEAST_GAIN = 4.0  # log score on held-out data that an effect must add
AS_GOOD = 3.0  # log score by which an effect may be worse and still stand for another: a factor of 20 in odds
RULED_OUT = 10.0
MOST_EFFECTS = 4
SCREEN = 0.05  # of the matched filter, times the candidates: what does worse is not fitted beside the chosen ones


@dataclass(frozen=True)
class Trial:
    """A fit, its log score on held-out data, and the p-value of its last effect against the fit without it."""

    fit: Fit
    score: float
    p: float


@dataclass(frozen=True)
class Choice:
    """What `choose` found.

    baseline    alignment alone
    singles     every candidate alone
    chosen      the fit that is taken; no effects if none is needed
    gains       {effect: held-out log score lost without it, the others refitted}
    stand_ins   {effect: {other: log score lost if it stands in}}, for all others
    p           {effect: chance of such a likelihood ratio without it, times the candidates}
    """

    baseline: Trial
    singles: dict[str, Trial]
    chosen: Trial
    gains: dict[str, float]
    stand_ins: dict[str, dict[str, float]]
    p: dict[str, float]

    def ambiguous_with(self, effect: str) -> list[str]:
        """Effects that explain the data as well in its place."""
        return [name for name, lost in self.stand_ins.get(effect, {}).items() if lost < AS_GOOD]

    @property
    def ruled_out(self) -> dict[str, float]:
        """Effects that the data speak against as an explanation, with what the best place of each would lose."""
        least: dict[str, float] = {}
        for others in self.stand_ins.values():
            for name, lost in others.items():
                least[name] = min(lost, least.get(name, float("inf")))
        return {name: lost for name, lost in least.items() if lost >= RULED_OUT}


def trial(fitter: Fitter, effects: tuple[str, ...], given: Trial | None = None, against: Trial | None = None) -> Trial:
    """Fit effects and score them.

    given     where to begin
    against   the fit without the last effect, for its p-value
    """
    fit = fitter.fit(effects, None if given is None else given.fit)
    p = 1.0
    if against is not None:
        p = float(stats.chi2.sf(max(0.0, against.fit.chi_square - fit.chi_square), max(1, fit.free - against.fit.free)))
    return Trial(fit, fitter.score(fit), p)


def choose(fitter: Fitter, baseline: Trial, singles: Mapping[str, Trial]) -> Choice:
    """Add effects while held-out data gain by them; drop those that are no longer needed; find stand-ins.

    baseline, singles   from `trial`: alignment alone, and every candidate alone
    """
    current, trials = baseline, dict(singles)
    for _ in range(MOST_EFFECTS):
        best_name = max(trials, key=lambda name: trials[name].score)
        best = trials[best_name]
        if best.score - current.score < LEAST_GAIN or best.p * len(singles) > ALPHA:
            break
        current = best
        current = _without_idle(fitter, current, baseline, singles)
        left = [name for name in singles if name not in current.fit.effects]
        hopeful = [name for name, p in screened(fitter, current.fit, left).items() if p * len(left) < SCREEN]
        if not hopeful:
            break
        trials = {name: trial(fitter, (*current.fit.effects, name), current, current) for name in hopeful}
    gains, stand_ins, p = {}, {}, {}
    for effect in current.fit.effects:
        rest = tuple(name for name in current.fit.effects if name != effect)
        without = _known(fitter, rest, current, baseline, singles)
        gains[effect] = current.score - without.score
        lost = max(0.0, without.fit.chi_square - current.fit.chi_square)
        free = max(1, current.fit.free - without.fit.free)
        p[effect] = min(1.0, float(stats.chi2.sf(lost, free)) * len(singles))
        others = [name for name in singles if name not in current.fit.effects]
        stand_ins[effect] = {
            name: current.score - _known(fitter, (*rest, name), without, baseline, singles).score for name in others
        }
    return Choice(baseline, dict(singles), current, gains, stand_ins, p)


def _known(fitter, effects, given, baseline, singles) -> Trial:
    """A fit that was made already, or a new one."""
    if not effects:
        return baseline
    if len(effects) == 1:
        return singles[effects[0]]
    return trial(fitter, effects, given)


def _without_idle(fitter, current: Trial, baseline: Trial, singles) -> Trial:
    """Drop effects that later ones have made needless."""
    for effect in current.fit.effects[:-1]:
        rest = tuple(name for name in current.fit.effects if name != effect)
        without = _known(fitter, rest, current, baseline, singles)
        if current.score - without.score < LEAST_GAIN:
            current = without
    return current
