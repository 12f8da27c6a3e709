"""Trials of several models in parallel."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from ..fitting.fit import Fitter
from ..fitting.trial import Trial, trial
from .fit_cache import FitCache
from .processes import run_parallel
from .progress import FITTED, DiagnosisProgress

LOGGER = logging.getLogger("virtual_phantom")


def trials(
    fitter: Fitter,
    tasks: Sequence[tuple],
    processes: int = 1,
    cache: FitCache | None = None,
    progress: DiagnosisProgress | None = None,
    final: bool = True,
) -> list[Trial]:
    """Fit and score several models; results do not depend on the number of processes.

    Parameters
    ----------
    tasks : sequence of tuple
        (effects, given, against, needed), as `trial` takes them; all but the first are optional.
    cache : FitCache, optional
        Trials are read from it and written to it.
    final : bool, optional
        As Fitter.fit.

    Raises
    ------
    InputError
        As `run_parallel`.
    """

    def make(*task) -> Trial:
        found = trial(fitter, *task, final=final)
        if cache is not None:
            cache.put(found, *task)
        LOGGER.info("fitted %s: log score %.1f", " and ".join(task[0]) or "the alignment", found.score)
        return found

    made = [None if cache is None else cache.get(*task) for task in tasks]
    missing = [task for task, found in zip(tasks, made, strict=True) if found is None]
    done = progress.begin(FITTED, len(missing)) if progress is not None and missing else None
    fresh = iter(run_parallel(make, missing, processes, done))
    return [next(fresh) if found is None else found for found in made]
