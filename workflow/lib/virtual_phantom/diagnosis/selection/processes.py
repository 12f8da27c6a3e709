"""Parallel work in forked processes."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from threadpoolctl import threadpool_limits

from ...base.errors import InputError
from ...projectors.threads import limit_threads

Result = TypeVar("Result")

_work: Callable | None = None  # inherited by forked processes: too large to be sent with every task


def run_parallel(
    work: Callable[..., Result], tasks: Sequence[tuple], processes: int = 1, done: Callable[[], None] | None = None
) -> list[Result]:
    """Return work(*task) for all tasks in order, each with one thread for linear algebra; several in forked processes.

    Parameters
    ----------
    work : callable
        Forked processes share its data. Results that it caches in them are lost.
    processes : int, optional
        Maximum number of processes.
    done : callable, optional
        Called in this process whenever a task is done, perhaps by another thread.

    Raises
    ------
    InputError
        If a process was killed.
    """
    import scipy.linalg  # noqa: F401  slow; threads of libraries that are loaded later would not be limited

    global _work
    at_once, before, done = min(processes, len(tasks)), _work, done or (lambda: None)
    _work = work
    try:
        if at_once <= 1:  # this process has the cache of traced rays
            with threadpool_limits(1):
                found = []
                for task in tasks:
                    found.append(work(*task))
                    done()
                return found
        forked = multiprocessing.get_context("fork")
        with ProcessPoolExecutor(at_once, forked, _use_one_thread) as pool:
            return _of_all([pool.submit(_one, task) for task in tasks], done)
    except BrokenProcessPool as error:
        raise InputError(
            f"one of the {at_once} processes that fit side by side was killed, most likely for want of memory: run "
            "with fewer cores. Fits that were made are kept"
        ) from error
    finally:
        _work = before


def _use_one_thread() -> None:
    limit_threads(1)
    threadpool_limits(1)


def _one(task: tuple):
    return _work(*task)


def _of_all(futures: list[Future], done: Callable[[], None]) -> list:
    """Return results in order; after a failure no other task is begun."""

    def count(future: Future) -> None:
        if not future.cancelled() and future.exception() is None:
            done()

    for future in futures:
        future.add_done_callback(count)
    try:
        return [future.result() for future in futures]
    finally:
        for future in futures:
            future.cancel()
