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
    """The fits that every diagnosis begins with.

    Attributes
    ----------
    baseline : Trial
        The alignment alone.
    singles : mapping of str to Trial
        Each candidate alone.
    """

    baseline: Trial
    singles: Mapping[str, Trial]

    @classmethod
    def of(cls, fitter: Fitter, effects: Sequence[str], processes: int = 1) -> Fitted:
        """Make them.

        Parameters
        ----------
        fitter : Fitter
        effects : sequence of str
            Candidates.
        processes : int, optional
            As core.attribute.trials takes them.

        Returns
        -------
        Fitted
        """
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

    Parameters
    ----------
    name : str
        Of the recording.
    prepared : Prepared
    effects : sequence of str
        Candidates.
    accuracy : mapping of str to float
        As choose takes it.
    processes : int, optional
        As choose takes them.
    fitted : Fitted, optional
        The first fits, where other jobs made them; None: they are made here.

    Returns
    -------
    prepared : Prepared
        With the noise by which the recording was judged.
    diagnosis : Diagnosis
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

    Parameters
    ----------
    name : str
        Of the recording.
    prepared : Prepared
    physics : Physics
    same_material : bool
        As verified takes it.
    fitted : Fitted, optional
        As explain takes it.

    Returns
    -------
    prepared : Prepared
    diagnosis : Diagnosis
        As explain returns them.
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
    """A choice; a second one where the first says how the noise is correlated and the recording does not.

    For that all models are fitted again by the new likelihood, so that they compare.

    Parameters
    ----------
    prepared : Prepared
    choice : callable
        (Prepared, Fitted or None) to Choice.
    fitted : Fitted or None

    Returns
    -------
    prepared : Prepared
    choice : Choice
    """
    chosen = choice(prepared, fitted)
    again = prepared.with_noise_of(chosen.chosen.fit)
    return (prepared, chosen) if again is prepared else (again, choice(again, None))
