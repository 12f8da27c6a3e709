"""How much other work slows a run down, as far as the operating system says it."""

from __future__ import annotations

import os
from pathlib import Path

# Of a control group: its share of processors' time, version 2 ("quota period") and version 1.
CGROUP = Path("/sys/fs/cgroup")


def slowdown(cores: int | None) -> float:
    """How many times slower a run is than on idle cores that are all its own.

    Parameters
    ----------
    cores : int or None
        That it uses; None on a cluster, which is another machine.

    Returns
    -------
    float
        At least 1.
    """
    if cores is None:
        return 1.0
    here = os.cpu_count() or 1
    # Of the average, one process is the start of this run.
    others = max(load_average() - 1, 0.0)
    shared = max((others + min(cores, here)) / here, 1.0)
    return shared * max(cores / available(), 1.0)


def load_average() -> float:
    """Processes that ran or waited for a processor in the last minute, on average."""
    try:
        return os.getloadavg()[0]
    except OSError:
        return 0.0


def available(cgroup: Path = CGROUP) -> float:
    """Processors that this process may use: by affinity and by the limit of a container or a batch system."""
    affinity = getattr(os, "sched_getaffinity", None)
    count = float(len(affinity(0)) if affinity else os.cpu_count() or 1)
    for quota, period in (
        _two(cgroup / "cpu.max"),
        _two(cgroup / "cpu/cpu.cfs_quota_us", cgroup / "cpu/cpu.cfs_period_us"),
    ):
        if quota > 0 and period > 0:
            count = min(count, quota / period)
    return count


def _two(*paths: Path) -> tuple[float, float]:
    """Two numbers of the files; zeros where there is no limit."""
    try:
        first, second = " ".join(path.read_text() for path in paths).split()
        return float(first), float(second)
    except (OSError, ValueError):  # "max 100000": no limit
        return 0.0, 0.0
