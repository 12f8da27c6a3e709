"""Estimate how much other work on the machine slows a run down."""

from __future__ import annotations

import os
from pathlib import Path

# Control group with the CPU limit of a container: cpu.max in version 2 ("quota period"), cpu.cfs_* in version 1.
CGROUP = Path("/sys/fs/cgroup")


def slowdown(cores: int | None) -> float:
    """Return the factor (at least 1) by which a run on this many cores is slower than on an idle machine.

    It is 1 if `cores` is None, as on a cluster, where jobs run on other machines.
    """
    if cores is None:
        return 1.0
    here = os.cpu_count() or 1
    # One process of the load average is the start of this run.
    others = max(load_average() - 1, 0.0)
    shared = max((others + min(cores, here)) / here, 1.0)
    return shared * max(cores / available(), 1.0)


def load_average() -> float:
    """Return the mean number of processes that ran or waited for a processor in the last minute."""
    try:
        return os.getloadavg()[0]
    except OSError:
        return 0.0


def available(cgroup: Path = CGROUP) -> float:
    """Return the number of processors that this process may use: its affinity, limited by its control group."""
    affinity = getattr(os, "sched_getaffinity", None)
    count = float(len(affinity(0)) if affinity else os.cpu_count() or 1)
    for quota, period in (
        _two_numbers(cgroup / "cpu.max"),
        _two_numbers(cgroup / "cpu/cpu.cfs_quota_us", cgroup / "cpu/cpu.cfs_period_us"),
    ):
        if quota > 0 and period > 0:
            count = min(count, quota / period)
    return count


def _two_numbers(*paths: Path) -> tuple[float, float]:
    """Read two numbers from files; zeros if there is no limit."""
    try:
        first, second = " ".join(path.read_text() for path in paths).split()
        return float(first), float(second)
    except (OSError, ValueError):  # "max 100000": no limit
        return 0.0, 0.0
