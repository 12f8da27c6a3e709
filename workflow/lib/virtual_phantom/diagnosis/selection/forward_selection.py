"""Which effects explain the difference: chosen one at a time by data that were not fitted, with what could stand in."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import partial

from ...io.schema import defaults_of
from ...physics.effect import load, offered
from ..fitting.fit import Fit, Fitter
from ..fitting.trial import Trial, chance
from ..residuals.change import Change
from ..uncertainty.model_error import Errors
from .exchange import exchanged
from .fit_cache import FitCache
from .progress import DiagnosisProgress
from .screening import Screened, screened
from .trials import trials

# Of an effect's likelihood ratio, over all candidates; a choice. Of 32 scans of the proof with nothing left out, an
# effect was named in 1.
ALPHA = 0.001
LEAST_GAIN = 4.0  # log score on held-out data that an effect must add: odds of 55 to 1; a choice
AS_GOOD = 3.0  # log score by which an effect may be worse and still stand for another: a factor of 20 in odds
# Log score that an effect must lose in the best place: odds of 22,000 to 1. Of 1735 effects that were ruled out in the
# proof's seeds 13 and 15 none was there.
RULED_OUT = 10.0
# Share of an effect's change that another one must make too, to first order, to be fitted again from the settings that
# equal the effect's; what is less alike loses a fifth of a gain. A choice. Detector offset and center of rotation share
# over 0.99 in parallel and fan beams (tests/diagnosis/test_exchanged.py).
LIKE = 0.8
MOST_EFFECTS = 4  # named at once; a choice that bounds the time
MOST_SWAPS = 2  # of a chosen effect for a better one that only pays beside the others
SCREEN = 0.01  # of the matched filter, times the candidates: what does worse is not fitted beside the chosen ones
# Of those that the matched filter leaves: fitted are the first few by its gain, if it is this share of the best or, in
# the place of an effect, of what that one gains; and all with that larger share of the best.
FEW, LEAST_SHARE, NEAR_BEST = 6, 0.1, 0.5
# Share of its gain that something which moves rays must keep beside all that inexact models may make up, for its gain
# to be its own. In two scans of the proof's seed 16 row offsets kept 0.99 and 1.02, a drift that was not there 0.24.
APART = 0.5
MOST_DATA = 2_000_000  # in which this is asked: what models may make up takes some 400 bytes of each, several times


@dataclass(frozen=True)
class Choice:
    """What `choose` found.

    Attributes
    ----------
    baseline : Trial
        Alignment alone.
    alone : dict of str to float
        {candidate: held-out log score that it alone gains}, to first order for those not among `singles`.
    singles : dict of str to Trial
        Candidates that were fitted alone.
    chosen : Trial
        The fit that is taken; no effects if none is needed.
    gains : dict of str to float
        {effect: held-out log score lost without it, the others refitted}.
    stand_ins : dict of str to dict of str to float
        {effect: {other: log score lost if it stands in}}, for all others; to first order for those that the matched
        filter puts far behind, and beside errors of models in the place of one whose gain these cannot make up.
    p : dict of str to float or None
        {effect: chance of such a likelihood ratio without it, times the candidates}; None: not fitted here.
    blur : float
        Log score by which the models' own inexactness may set fits apart.
    apart : frozenset of str
        Effects whose gain inexact models cannot make up, however little it is beside that of the others.
    undecided : dict of str to float
        {other: log score that it promises to gain beside the chosen ones, to first order}, of those that stand out of
        the noise: not named, since inexact models of the chosen ones may leave as much.
    without : dict of str to Fit
        {effect: the fit without it, the others and the alignment refitted}.
    numerical : float
        Share by which the corrections for finite steps may be off.
    piece : Change or None
        The piece of the object that explains more than any effect, if there is one: then no effect is chosen.
    errors : Errors or None
        Of the numbers of the chosen fit; None: of noise alone, as the fit has them.
    """

    baseline: Trial
    alone: dict[str, float]
    singles: dict[str, Trial]
    chosen: Trial
    gains: dict[str, float]
    stand_ins: dict[str, dict[str, float]]
    p: dict[str, float | None]
    blur: float = 0.0
    apart: frozenset[str] = frozenset()
    undecided: dict[str, float] = field(default_factory=dict)
    without: dict[str, Fit] = field(default_factory=dict)
    numerical: float = 0.0
    piece: Change | None = None
    errors: Errors | None = None

    def ambiguous_with(self, effect: str) -> list[str]:
        """Effects that explain the data as well in its place."""
        enough = AS_GOOD if effect in self.apart else max(AS_GOOD, self.blur)
        return [name for name, lost in self.stand_ins.get(effect, {}).items() if lost < enough]

    @property
    def ruled_out(self) -> dict[str, float]:
        """Effects that the data speak against as an explanation, with what the best place of each would lose.

        One that may be there beside the chosen ones is not among them.
        """
        least: dict[str, float] = {}
        for effect, others in self.stand_ins.items():
            if effect in self.apart and len(self.stand_ins) > 1:  # which loses little, whatever stands in for it
                continue
            for name, lost in others.items():
                least[name] = min(lost, least.get(name, float("inf")))
        enough = max(RULED_OUT, self.blur)
        return {name: lost for name, lost in least.items() if lost >= enough and name not in self.undecided}


def choose(
    fitter: Fitter,
    baseline: Trial,
    candidates: Sequence[str],
    processes: int = 1,
    accuracy: Mapping[str, float] | None = None,
    kept: FitCache | None = None,
    how_far: DiagnosisProgress | None = None,
    alone: Mapping[str, Screened] | None = None,
) -> Choice:
    """Choose the effects that explain the data held out.

    Effects are added while held-out data gain by them, dropped when they are no longer needed, and swapped when they
    are worse, beside the others, than what could stand in. Matched filters rank the candidates: those are fitted that
    could be the best, or stand in for it.

    Parameters
    ----------
    baseline : Trial
        Alignment alone.
    candidates : sequence of str
        Effects.
    processes : int, optional
        As for `trials`.
    accuracy : mapping of str to float, optional
        {effect: share of its own change of the data by which its model may be wrong}, `default` that of the others,
        `numerical` that of the corrections for finite steps: what that leaves over is no evidence for another effect,
        and none against one that could stand in. So with declared effects: what errors of their models may make up is
        no evidence. None: what the configuration has by default.
    kept : FitCache, optional
        As for `trials`.
    how_far : DiagnosisProgress, optional
        What is told of rankings and fits.
    alone : mapping of str to Screened, optional
        Matched filters of the candidates beside the alignment, where they were made before.
    """
    if accuracy is None:
        accuracy = defaults_of("diagnosis", "model_accuracy")
    fits = _Fits(fitter, baseline, candidates, processes, kept, how_far, alone, accuracy)
    current, found, tried = baseline, {}, fits.single(could_win(fits.alone, sure=True))
    screened_beside: tuple[str, ...] = ()  # the effects of the fit that `found` is of
    worth: dict[str, float] = {}  # log score that each effect gained when it was taken
    apart: set[str] = set()  # effects whose gain inexact models of what was taken before them cannot make up
    numerical = accuracy.get("numerical", 0.0)
    steps = numerical**2 * baseline.fit.corrected / 2

    def blur(beside: Trial) -> float:
        # What an effect gained may be less than it explains, once another that came before has gone.
        names, total = beside.fit.effects, max(0.0, beside.score - baseline.score)
        shared = sum(accuracy.get(name, accuracy["default"]) ** 2 * worth[name] for name in names)
        known = sum(worth[name] for name in names)
        return steps + (total * shared / known if known else 0.0)

    def least(beside: Trial, effect: str | None = None) -> float:
        return LEAST_GAIN if effect in apart else max(LEAST_GAIN, blur(beside))

    def take(best: Trial) -> Trial:
        """The effect that is new, and what it replaces."""
        new, gone = (set(one.fit.effects) - set(other.fit.effects) for one, other in ((best, current), (current, best)))
        gained = best.score - current.score + sum(worth[name] for name in gone)
        worth.update(dict.fromkeys(new, max(0.0, gained)))
        return _without_idle(fits, best, least)

    def standing_out(least_gain: float, sure: bool = False) -> dict[str, Screened]:
        return {name: one for name, one in found.items() if stands_out(one.sure if sure else one, found, least_gain)}

    for more in reversed(range(MOST_EFFECTS if tried else 0)):
        gains = {name: one.score - current.score for name, one in tried.items()}
        enough = [name for name, gain in gains.items() if gain >= least(current, name)]
        best = tried[max(enough, key=lambda name: gains[name])] if enough else current
        if not enough or best.p * len(candidates) > ALPHA:
            break
        apart = {name for name in apart if name in best.fit.effects and gains.get(name, 0.0) < least(current)}
        current = take(best)
        screened_beside = current.fit.effects
        found = fits.screened(current.fit, fits.others(screened_beside))
        if blur(current) > LEAST_GAIN:
            apart |= fits.apart(current.fit, found)
        # Chi-square is twice the score, and a filter, of first order, may fall short of it by a factor of two.
        hopeful = best_few(standing_out(least(current), sure=True))
        hopeful += [name for name in apart if name in found]
        hopeful += [name for name, one in found.items() if one.blind]
        if not hopeful or not more:
            break
        tried = fits.beside(current, list(dict.fromkeys(hopeful)))
    apart.intersection_update(current.fit.effects)
    for _ in range(MOST_SWAPS + 1):
        choice, best = _with_stand_ins(fits, current, apart, max(RULED_OUT, blur(current)))
        idle = [name for name in apart - choice.apart if choice.gains[name] < blur(current)]
        if idle:
            (best,) = fits.of([_less(current.fit.effects, idle[0])], current)
        elif best is None or best.score - current.score < LEAST_GAIN:
            break
        current, apart = take(best), set(choice.apart)
    if screened_beside != choice.chosen.fit.effects:  # swapped since
        found = fits.screened(choice.chosen.fit, fits.others(choice.chosen.fit.effects))
    undecided = {name: one.gain / 2 for name, one in standing_out(2 * LEAST_GAIN).items()}
    return replace(choice, blur=blur(choice.chosen), undecided=undecided, numerical=numerical)


class _Fits:
    """Fits of candidates alone and together; each alone is made once, if it is asked for.

    Parameters
    ----------
    fitter, baseline, candidates, processes, kept, how_far, alone, accuracy
        As `choose` takes them.

    Attributes
    ----------
    alone : dict of str to Screened
        Matched filters of the candidates that can do something alone, beside the alignment.
    singles : dict of str to Trial
        Fits of candidates alone that were made.
    """

    def __init__(
        self,
        fitter: Fitter,
        baseline: Trial,
        candidates: Sequence[str],
        processes: int,
        kept,
        how_far,
        alone,
        accuracy: Mapping[str, float],
    ):
        self.baseline, self.candidates = baseline, tuple(candidates)
        self._make = partial(trials, fitter, processes=processes, kept=kept, how_far=how_far)
        # Not kept: those of the same effects that were begun elsewhere are.
        self._refit = partial(trials, fitter, processes=processes, how_far=how_far)
        self._fitter = fitter
        self._screen = partial(screened, fitter, processes=processes, how_far=how_far)
        self._accuracy = accuracy
        self._whole = fitter.model.whole
        self._data = sum(weight.size for weight in fitter.weights)
        self.alone = self.screened(baseline.fit, self.others(())) if alone is None else alone
        self.singles: dict[str, Trial] = {}

    def others(self, effects: tuple[str, ...], but: str | None = None) -> list[str]:
        """Candidates that are none of these effects, nor another one, and can do something beside these."""
        return [name for name in offered(self.candidates, self._whole(effects)) if name not in (*effects, but)]

    def screened(self, fit: Fit, names: Sequence[str], in_place: bool = False) -> dict[str, Screened]:
        """As `screening.screened`; in the place of a chosen effect, errors of declared physics are not asked about."""
        return self._screen(fit, names, accuracy=None if in_place else self._accuracy) if names else {}

    def apart(self, fit: Fit, found: Mapping[str, Screened]) -> set[str]:
        """What moves rays or the object, and whose gain neither inexact models of the fit's effects nor others make up.

        No wrong model of a signal moves rays. Others are not asked about: models may be wrong in ways that are not
        counted. What these leave looks like several effects at once.

        Parameters
        ----------
        found : mapping of str to Screened
            Matched filters beside it.

        Returns
        -------
        set of str
            The effect, if there is one.
        """
        if self._data > MOST_DATA or not any(
            load(name).kinematic and stands_out(one.sure, found, 2 * LEAST_GAIN) for name, one in found.items()
        ):
            return set()
        beside = self.beside_models(fit, list(found))
        best = max(beside, key=lambda name: beside[name].sure.gain)
        return {best} if is_apart(best, beside) else set()

    def beside_models(self, fit: Fit, names: Sequence[str]) -> dict[str, Screened]:
        """Matched filters beside errors of models of declared physics and of the fit's effects."""
        return self._screen(fit, names, accuracy=self._accuracy, fitted_too=True) if names else {}

    def single(self, names: Sequence[str]) -> dict[str, Trial]:
        """Candidates alone."""
        new = [name for name in names if name not in self.singles]
        made = self._make([((name,), self.baseline, self.baseline) for name in new])
        self.singles |= zip(new, made, strict=True)
        return {name: self.singles[name] for name in names}

    def beside(self, current: Trial, names: Sequence[str]) -> dict[str, Trial]:
        """Candidates beside those of a fit."""
        tasks = [((*current.fit.effects, name), current, current) for name in names]
        return dict(zip(names, self._make(tasks), strict=True))

    def of(self, sets: Sequence[tuple[str, ...]], given: Trial) -> list[Trial]:
        """Fits of sets of candidates, those of several begun from another fit."""
        several = [effects for effects in sets if len(effects) > 1]
        made = dict(zip(several, self._make([(effects, given) for effects in several]), strict=True))
        made |= {(name,): one for name, one in self.single([one[0] for one in sets if len(one) == 1]).items()}
        return [made[effects] if effects else self.baseline for effects in sets]

    def in_place(self, current: Trial, effect: str, others: Sequence[str]) -> dict[str, Trial]:
        """Fits with another effect in the place of one, begun where they are equal to first order.

        Only those that share LIKE of its change.
        """
        if not others:
            return {}
        found = exchanged(self._fitter, current.fit, effect, others, LIKE)
        tasks = [(one.start.effects, replace(current, fit=one.start)) for one in found.values()]
        return dict(zip(found, self._refit(tasks), strict=True))

    def gain_alone(self) -> dict[str, float]:
        """Held-out log score that every candidate alone gains; to first order where it was not fitted."""
        return {
            name: self.singles[name].score - self.baseline.score if name in self.singles else one.gain / 2
            for name, one in self.alone.items()
        }


def _with_stand_ins(fits: _Fits, current: Trial, apart: Set[str], ruled_out: float) -> tuple[Choice, Trial | None]:
    """These effects, each with its gain and its alternative explanations, and the best fit with an alternative.

    A fit may end in a local optimum, and filters are inexact for effects that move rays. Before an alternative is ruled
    out that changes the data as the effect does, it is fitted again from the settings that equal the effect's.

    Parameters
    ----------
    ruled_out : float
        Log score that an alternative must lose to be ruled out.
    """
    rests = {effect: _less(current.fit.effects, effect) for effect in current.fit.effects}
    without = dict(zip(rests, fits.of(list(rests.values()), current), strict=True))
    gains, stand_ins, p, swapped = {}, {}, {}, []
    for effect, rest in rests.items():
        gains[effect] = current.score - without[effect].score
        p[effect] = min(1.0, chance(current.fit, without[effect].fit, effect) * len(fits.candidates))
        others = fits.others(rest, but=effect)
        if effect in apart:  # beside others than when it was taken, maybe
            beside = fits.beside_models(without[effect].fit, [effect, *others]) if rest else {}
            if beside and is_apart(effect, beside):
                best_gain = beside[effect].sure.gain
                stand_ins[effect] = {
                    name: max(0.0, best_gain - beside[name].sure.gain) / 2 for name in others if not beside[name].blind
                }
                continue
            apart = apart - {effect}
        found = fits.screened(without[effect].fit, others, in_place=True) if rest else fits.alone
        found = {name: found[name] for name in others}
        first_order = {name: gains[effect] - found[name].gain / 2 for name in others}
        close = [name for name in others if first_order[name] < RULED_OUT]
        likely = list(dict.fromkeys([*could_win(found, 2 * gains[effect]), *close]))
        fitted = fits.of([(*rest, name) for name in likely], without[effect])
        stand_ins[effect] = {name: max(lost, 0.0) for name, lost in first_order.items()}
        fitted = dict(zip(likely, fitted, strict=True))
        stand_ins[effect] |= {name: current.score - one.score for name, one in fitted.items()}
        moving = load(effect).kinematic
        doubtful = [
            name
            for name, lost in stand_ins[effect].items()
            if lost >= ruled_out and (name in fitted or (moving and load(name).kinematic))
        ]
        for name, one in fits.in_place(current, effect, doubtful).items():
            if name not in fitted or one.fit.chi_square < fitted[name].fit.chi_square:
                fitted[name] = one
                stand_ins[effect][name] = current.score - one.score
        swapped += fitted.values()
    # Without one of them it may be better, too: not every fit ends at its best.
    best = max([*swapped, *without.values()], key=lambda one: one.score, default=None)
    known = {effect: one.fit for effect, one in without.items()}
    choice = Choice(
        fits.baseline,
        fits.gain_alone(),
        dict(fits.singles),
        current,
        gains,
        stand_ins,
        p,
        apart=frozenset(apart),
        without=known,
    )
    return choice, best


def is_apart(effect: str, beside: Mapping[str, Screened]) -> bool:
    """Whether an effect moves rays or the object, and neither inexact models nor other effects make up its gain.

    Parameters
    ----------
    beside : mapping of str to Screened
        Matched filters of it and of all others, also beside errors of models.
    """
    own = beside[effect].sure
    lead = own.gain - max((one.sure.gain for name, one in beside.items() if name != effect), default=0.0)
    kept = stands_out(own, beside, 2 * LEAST_GAIN) and own.gain >= APART * beside[effect].gain
    return load(effect).kinematic and kept and lead >= 2 * RULED_OUT


def stands_out(one: Screened, among: Mapping[str, Screened], least_gain: float) -> bool:
    """Whether a filter shows more than chance, and more than a gain of chi-square."""
    return one.p * len(among) < SCREEN and one.gain > least_gain


def could_win(found: Mapping[str, Screened], needed: float = 0.0, sure: bool = False) -> list[str]:
    """Those to be fitted: the best few, and those of which a filter knows nothing.

    Parameters
    ----------
    needed : float, optional
        As `best_few`.
    sure : bool, optional
        Leave out what errors of declared physics may make up.
    """
    hopeful = {
        name: one
        for name, one in found.items()
        if not sure or one.beside_errors is None or stands_out(one.beside_errors, found, LEAST_GAIN)
    }
    return list(dict.fromkeys([*best_few(hopeful, needed), *(name for name, one in found.items() if one.blind)]))


def best_few(found: Mapping[str, Screened], needed: float = 0.0) -> list[str]:
    """Those with the largest first-order gains.

    Parameters
    ----------
    needed : float, optional
        Gain in chi-square of what they would stand in for.

    Returns
    -------
    list of str
        The best first.
    """
    ranked = sorted(found, key=lambda name: -found[name].gain)
    best = found[ranked[0]].gain if ranked else 0.0
    least = LEAST_SHARE * max(best, needed)
    return [
        name
        for rank, name in enumerate(ranked)
        if found[name].gain >= least and (rank < FEW or found[name].gain >= NEAR_BEST * best)
    ]


def _less(effects: tuple[str, ...], effect: str) -> tuple[str, ...]:
    return tuple(name for name in effects if name != effect)


def _without_idle(fits: _Fits, current: Trial, least: Callable[[Trial, str], float]) -> Trial:
    """Drop effects that later ones have made needless."""
    for effect in current.fit.effects[:-1]:
        (without,) = fits.of([_less(current.fit.effects, effect)], current)
        if current.score - without.score < least(without, effect):
            current = without
    return current
