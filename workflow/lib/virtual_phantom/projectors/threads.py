"""Distribution of work over the threads of a process."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

_most: int | None = None  # of this process


def limit_threads(most: int) -> None:
    """Limit the threads of `run_in_threads` in this process, for processes that run in parallel."""
    global _most
    _most = most


def run_in_threads(run: Callable[[int, int], None], count: int, threads: int) -> None:
    """Call run(first, last) for one contiguous part of [0, count) per thread; parts must write to separate memory."""
    threads = threads if _most is None else min(threads, _most)
    if threads == 1:
        run(0, count)
        return
    edges = np.linspace(0, count, threads + 1).astype(int)
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(run, edges[:-1], edges[1:]))
