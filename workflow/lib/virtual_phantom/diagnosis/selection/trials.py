"""Trials of several models side by side."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from ..fitting.fit import Fitter
from ..fitting.trial import Trial, trial
from .fit_cache import FitCache
from .processes import side_by_side
from .progress import FITTED, DiagnosisProgress

LOGGER = logging.getLogger("virtual_phantom")  # of the job


def trials(
    fitter: Fitter,
    tasks: Sequence[tuple],
    processes: int = 1,
    kept: FitCache | None = None,
    how_far: DiagnosisProgress | None = None,
) -> list[Trial]:
    """Make trials.

    Predictions depend on what is asked alone, so that results are the same whatever the number of processes and their
    order.

    Parameters
    ----------
    tasks : sequence of tuple
        (effects, given, against), as `trial` takes them.
    processes : int, optional
        At most.
    kept : FitCache, optional
        Where trials are taken from that were made before, and left for the next time.
    how_far : DiagnosisProgress, optional
        What is told of those that are to be made.

    Returns
    -------
    list of Trial
        In the order of the tasks.

    Raises
    ------
    InputError
        As `side_by_side`.
    """

    def make(*task) -> Trial:
        found = trial(fitter, *task)
        if kept is not None:
            kept.put(found, *task)
        LOGGER.info("fitted %s: log score %.1f", " and ".join(task[0]) or "the alignment", found.score)
        return found

    made = [None if kept is None else kept.get(*task) for task in tasks]
    missing = [task for task, one in zip(tasks, made, strict=True) if one is None]
    done = how_far.begin(FITTED, len(missing)) if how_far is not None and missing else None
    fresh = iter(side_by_side(make, missing, processes, done))
    return [next(fresh) if one is None else one for one in made]
