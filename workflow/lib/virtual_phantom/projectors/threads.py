"""Work that the threads of one process share out."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

_most: int | None = None  # of this process


def limit_threads(most: int) -> None:
    """Let `share_out` use no more threads in this process: for one of several that work side by side."""
    global _most
    _most = most


def share_out(run: Callable[[int, int], None], count: int, threads: int) -> None:
    """Call run(first, last) over [0, count) in one contiguous share per thread; the shares write to separate places."""
    threads = threads if _most is None else min(threads, _most)
    if threads == 1:
        run(0, count)
        return
    edges = np.linspace(0, count, threads + 1).astype(int)
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(run, edges[:-1], edges[1:]))
