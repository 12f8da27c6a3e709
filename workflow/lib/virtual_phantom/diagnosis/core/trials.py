"""Trials of several models side by side."""

from __future__ import annotations

import logging
import multiprocessing
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool

from threadpoolctl import threadpool_limits

from ...base.errors import InputError
from ...projectors.threads import limit_threads
from .fit import Fitter
from .kept import KeptFits
from .trial import Trial, trial

LOGGER = logging.getLogger("virtual_phantom")  # of the job

_shared: tuple[Fitter, KeptFits | None] | None = None  # with processes that are forked: too large for every task


def trials(fitter: Fitter, tasks: Sequence[tuple], processes: int = 1, kept: KeptFits | None = None) -> list[Trial]:
    """Make trials, with one thread for linear algebra each; of several, in processes that are forked.

    Predictions depend on what is asked alone, so that results are the same whatever the number of processes and their
    order.

    Parameters
    ----------
    fitter : Fitter
    tasks : sequence of tuple
        (effects, given, against), as `trial` takes them.
    processes : int, optional
        At most.
    kept : KeptFits, optional
        Where trials are taken from that were made before, and left for the next time.

    Returns
    -------
    list of Trial
        In the order of the tasks.

    Raises
    ------
    InputError
        If a process was killed.
    """
    global _shared
    made = [None if kept is None else kept.get(*task) for task in tasks]
    missing = [task for task, one in zip(tasks, made, strict=True) if one is None]
    at_once, before = min(processes, len(missing)), _shared
    _shared = fitter, kept
    try:
        if at_once > 1:
            forked = multiprocessing.get_context("fork")
            with ProcessPoolExecutor(at_once, forked, limit_threads, (1,)) as pool:
                fresh = list(pool.map(_trial, missing))
        else:  # no other process would know what rays this one has traced
            fresh = [_trial(task) for task in missing]
    except BrokenProcessPool as error:
        raise InputError(
            f"one of the {at_once} processes that fit side by side was killed, most likely for want of memory: run "
            "with fewer cores. Fits that were made are kept"
        ) from error
    finally:
        _shared = before
    ready = iter(fresh)
    return [next(ready) if one is None else one for one in made]


def _trial(task: tuple) -> Trial:
    fitter, kept = _shared
    with threadpool_limits(1):
        found = trial(fitter, *task)
    if kept is not None:
        kept.put(found, *task)
    LOGGER.info("fitted %s: log score %.1f", " and ".join(task[0]) or "the alignment", found.score)
    return found
