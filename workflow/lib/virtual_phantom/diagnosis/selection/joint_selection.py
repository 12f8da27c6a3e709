"""Forward selection of the effects that several recordings of one scanner share, judged by held-out recordings."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from scipy import stats

from ...base.errors import InputError
from ...io.schema import defaults_of
from ...physics.effect import applicable_effects
from ...statistics.multiplicity import bonferroni
from ..fitting.fit import Fit
from ..fitting.joint_fit import JointFit, JointFitter
from ..fitting.trial import effect_p_value
from .forward_selection import ALPHA, LEAST_GAIN, without_effect
from .screening import SCREEN, screened

TRIED = 3  # best effects of the fitted data that are judged by held-out recordings; a choice that bounds the time
MOST_FOLDS = 12  # folds of held-out recordings; a choice that bounds the time
MOST_WORSE = 0.5  # largest share of recordings with a worse fit; a higher share indicates an effect of a single scan


@dataclass(frozen=True)
class JointChoice:
    """Effects selected for several recordings.

    Attributes
    ----------
    baseline, chosen : JointFit
        Nuisance parameters alone, and with the effects; fitted to all recordings.
    before, left_out : dict of str to Fit
        By recording, a fit of the nuisance parameters of this recording. Declared physics (`before`) or all physics
        (`left_out`) is fixed at the values fitted to the recordings outside of its fold.
    scores : dict of str to dict of str to float
        By recording, log score on its held-out data: "before", and "after" with the physics of the others.
    gains : dict of str to float
        {effect: log score lost without it, over all held-out recordings}.
    p : dict of str to float
        {effect: p-value of its likelihood ratio when it was accepted, times the number of candidates}.
    without : dict of str to JointFit
        {effect: fit without it, all else refitted}.
    """

    baseline: JointFit
    chosen: JointFit
    before: dict[str, Fit]
    left_out: dict[str, Fit]
    scores: dict[str, dict[str, float]]
    gains: dict[str, float]
    p: dict[str, float]
    without: dict[str, JointFit]


def choose_jointly(
    together: JointFitter,
    candidates: Sequence[str],
    accuracy: Mapping[str, float] | None = None,
    objects: Mapping[str, str] | None = None,
) -> JointChoice:
    """Select the effects that recordings share.

    Parameters
    ----------
    accuracy : mapping of str to float, optional
        As `forward_selection.choose` takes it.
    objects : mapping of str to str, optional
        As `recording_folds` takes them.

    Raises
    ------
    InputError
        For a single recording.
    """
    if len(together.fitters) < 2:
        raise InputError("needs two recordings, because each is tested with the physics of the others")
    accuracy = defaults_of("diagnosis", "model_accuracy") if accuracy is None else accuracy
    return JointSelection(together, candidates, accuracy, recording_folds(list(together.fitters), objects)).run()


class JointSelection:
    """Forward selection by the log score of held-out recordings (`folds`).

    An effect is accepted under three conditions. Over all held-out recordings, it gains more log score than model
    errors of earlier effects may cause. It makes at most half of the recordings worse. It is significant on the fitted
    data. Effects that later effects made unnecessary are dropped. The number of effects is not limited.
    """

    def __init__(
        self,
        together: JointFitter,
        candidates: Sequence[str],
        accuracy: Mapping[str, float],
        folds: Sequence[Collection[str]],
    ):
        self.together, self.candidates, self.accuracy, self.folds = together, list(candidates), accuracy, folds
        self.baseline = self.current = together.fit(())
        self.gains: dict[str, float] = {}  # log score gained by each effect when it was accepted
        self.p: dict[str, float] = {}
        self._left_out: dict[tuple[str, ...], dict[str, Fit]] = {}

    def run(self) -> JointChoice:
        """Select effects."""
        before = self.left_out(self.baseline)
        left = list(self.candidates)
        while left and self.add_effect(left):
            left = [name for name in left if name != self.current.effects[-1]]
            self.prune()
        after, chosen = self.scores(self.current), self.current
        without = {name: self.together.fit(without_effect(chosen.effects, name), chosen) for name in chosen.effects}
        none = self.scores(self.baseline)
        return JointChoice(
            baseline=self.baseline,
            chosen=chosen,
            before=before,
            left_out=self.left_out(chosen),
            scores={name: {"before": none[name], "after": after[name]} for name in after},
            gains={name: _gain(after, self.scores(rest)) for name, rest in without.items()},
            p={name: self.p[name] for name in chosen.effects},
            without=without,
        )

    def add_effect(self, candidates: Sequence[str]) -> bool:
        """Accept the best further effect; return whether there is one."""
        names = self.screen(applicable_effects(candidates, self.together.with_declared_effects(self.current.effects)))
        tried = [self.together.fit((*self.current.effects, name), self.current) for name in names]
        if not tried:
            return False
        here = self.scores(self.current)
        tried.sort(key=lambda fit: fit.chi_square)
        best = max(tried[:TRIED], key=lambda fit: _gain(self.scores(fit), here))
        new, there = best.effects[-1], self.scores(best)
        p = float(bonferroni(effect_p_value(best, self.current, new), len(self.candidates)))
        gain, worse = _gain(there, here), sum(there[name] < here[name] for name in there)
        if gain < self.required_gain() or p > ALPHA or worse > MOST_WORSE * len(there):
            return False
        self.current, self.gains[new], self.p[new] = best, gain, p
        return True

    def required_gain(self) -> float:
        """Return the log score that an effect must gain: more than model errors of the selected effects may cause."""
        share = {name: self.accuracy.get(name, self.accuracy["default"]) for name in self.current.effects}
        return max(LEAST_GAIN, sum(share[name] ** 2 * self.gains[name] for name in share))

    def prune(self) -> None:
        """Drop effects that the latest effect made unnecessary."""
        for name in self.current.effects[:-1]:
            rest = self.together.fit(without_effect(self.current.effects, name), self.current)
            if _gain(self.scores(self.current), self.scores(rest)) < LEAST_GAIN:
                self.current = rest

    def screen(self, names: Sequence[str]) -> list[str]:
        """Return the effects whose matched filters show more than errors of declared physics may cause."""
        # Each recording has its own model errors here, which allows larger errors than one common model.
        fitters = self.together.fitters
        if not names or not any(fitter.model.declared for fitter in fitters.values()):
            return list(names)
        filters = [
            screened(fitter, self.current.fits[recording], names, accuracy=self.accuracy)
            for recording, fitter in fitters.items()
        ]

        def shows(name: str) -> bool:
            found = [fits[name] for fits in filters]
            gain = sum(filtered.beside_model_error.gain for filtered in found)
            numbers = sum(max(1, len(fitter.model.unknowns((name,)))) for fitter in fitters.values())
            p = float(bonferroni(stats.chi2.sf(gain, numbers), len(names)))
            return any(filtered.blind for filtered in found) or (gain > LEAST_GAIN and p < SCREEN)

        return [name for name in names if shows(name)]

    def left_out(self, fit: JointFit) -> dict[str, Fit]:
        """Return fits of the held-out recordings with a fit's effects, made once for each set of effects."""
        key = tuple(sorted(fit.effects))
        if key not in self._left_out:
            found: dict[str, Fit] = {}
            for names in self.folds:
                found |= self.together.left_out(names, fit)
            self._left_out[key] = {name: found[name] for name in self.together.fitters}
        return self._left_out[key]

    def scores(self, fit: JointFit) -> dict[str, float]:
        """Return each recording's log score on its held-out data with physics of the others."""
        found = self.left_out(fit)
        return {name: fitter.score(found[name]) for name, fitter in self.together.fitters.items()}


def recording_folds(names: Sequence[str], objects: Mapping[str, str] | None = None) -> list[list[str]]:
    """Return the folds of held-out recordings: one per scanned object, or one per recording if all have one object.

    `objects` is {recording: object}; None: each recording has its own object. Folds are merged if there are more than
    MOST_FOLDS.
    """
    found: dict[str, list[str]] = {}
    several = objects is not None and len(set(objects.values())) > 1
    for name in names:
        found.setdefault(objects[name] if several else name, []).append(name)
    groups = list(found.values())
    return [
        [name for group in groups[first::MOST_FOLDS] for name in group] for first in range(min(MOST_FOLDS, len(groups)))
    ]


def _gain(there: Mapping[str, float], here: Mapping[str, float]) -> float:
    return sum(there[name] - here[name] for name in there)
