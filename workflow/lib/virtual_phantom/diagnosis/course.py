"""The course of a diagnosis, from a recording made ready to its verdict: of a user's recordings and in the proof."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from .core.attribute import Choice, Trial, choose, trial, trials
from .core.fit import Fitter
from .core.prepared import Prepared
from .core.verdict import Diagnosis, diagnose
from .core.verified import Physics, stated, verified


@dataclass(frozen=True)
class Fitted:
    """The fits that every diagnosis begins with: the alignment alone, and each candidate alone."""

    baseline: Trial
    singles: Mapping[str, Trial]

    @classmethod
    def of(cls, fitter: Fitter, effects: Sequence[str], processes: int = 1) -> Fitted:
        """Make them."""
        baseline = trial(fitter, ())
        tasks = [((name,), baseline, baseline) for name in effects]
        return cls(baseline, dict(zip(effects, trials(fitter, tasks, processes), strict=True)))


def explain(
    name: str,
    prepared: Prepared,
    effects: Sequence[str],
    accuracy: Mapping[str, float],
    processes: int = 1,
    fitted: Fitted | None = None,
) -> tuple[Prepared, Diagnosis]:
    """Choose the effects that explain a recording, and judge them.

    name       of the recording
    effects    candidates
    accuracy   as choose takes it
    fitted     the first fits, where other jobs made them; None: they are made here
    The recording comes back with the noise by which it was judged.
    """

    def choice(one: Prepared, first: Fitted | None) -> Choice:
        first = first or Fitted.of(one.fitter, effects, processes)
        return choose(one.fitter, first.baseline, first.singles, processes, accuracy)

    prepared, chosen = _settled(prepared, choice, fitted)
    return prepared, diagnose(name, prepared, chosen)


def hold_against(
    name: str, prepared: Prepared, physics: Physics, same_material: bool, fitted: Fitted | None = None
) -> tuple[Prepared, Diagnosis]:
    """Judge a recording by physics that was found on another: only the alignment is fitted.

    same_material   as verified takes it
    The other arguments and what comes back are those of explain.
    """

    def choice(one: Prepared, first: Fitted | None) -> Choice:
        first = first or Fitted.of(one.fitter, ())
        return verified(one.fitter, first.baseline, physics, same_material)

    prepared, chosen = _settled(prepared, choice, fitted)
    found = diagnose(name, prepared, chosen)
    return prepared, replace(found, content=stated(found.content, physics))


def _settled(
    prepared: Prepared, choice: Callable[[Prepared, Fitted | None], Choice], fitted: Fitted | None
) -> tuple[Prepared, Choice]:
    """A choice; a second one where the first says how the noise is correlated and the recording does not: with all
    models fitted again by the new likelihood, so that they compare."""
    chosen = choice(prepared, fitted)
    again = prepared.with_noise_of(chosen.chosen.fit)
    return (prepared, chosen) if again is prepared else (again, choice(again, None))
