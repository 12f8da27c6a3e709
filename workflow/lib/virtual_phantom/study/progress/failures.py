"""What failed jobs are called, and why they failed, in a line each.

A job is a dict with the keys of Snakemake's record of its failure: rule_name, jobid, output and log are read.
"""

from __future__ import annotations

import itertools
import os
import re
import signal
from collections.abc import Sequence

from ..job import last_reason
from . import words
from .time_left import Step, stage_of

SHOWN_AT_END = 10
# What a signal that ended a script most often means, and what to do.
CRASHED = " (a crash); run it again, and report it with its log if that fails too"
SIGNALLED = {
    "SIGKILL": ", most often because memory ran out; run with fewer --cores, or a smaller grid",
    "SIGTERM": " (stopped from outside, or out of time); the same command goes on from there",
    "SIGINT": " (Ctrl-C); the same command goes on from there",
    "SIGHUP": " (its terminal closed); the same command goes on from there",
    "SIGXCPU": ": its limit of CPU time is reached; raise the limit (ulimit -t)",
    "SIGXFSZ": ": a file is larger than the limit of this shell; raise the limit (ulimit -f)",
    "SIGBUS": ", most often because a disk or shared memory is full; free some space",
    "SIGSEGV": CRASHED,
    "SIGABRT": CRASHED,
    "SIGILL": CRASHED,
    "SIGFPE": CRASHED,
}
ACQUISITION = re.compile(r"(.*/seed\d+)\.[a-z0-9.]+")


def from_logs(jobs: Sequence[dict], since: float) -> dict[int, str]:
    """{number: line} of the jobs whose logs give a reason that was written since then (s, of the epoch)."""
    lines = {}
    for job in jobs:
        if reason := next(filter(None, (last_reason(log, since) for log in job["log"])), None):
            lines[job["jobid"]] = f"Failed: {described(job)}: {reason} (log: {job['log'][0]})"
    return lines


def without_reason(jobs: Sequence[dict], more_logs: Sequence[str] = (), said: str = "") -> dict[int, str]:
    """One line for jobs that ended together without a reason in a log, under the number of the first.

    Parameters
    ----------
    more_logs : sequence of str, optional
        Logs that are no job's own, as a cluster's.
    said : str, optional
        Snakemake's message about how the script ended.

    Returns
    -------
    dict of int to str
        {number: line}.
    """
    names = ", ".join(map(described, jobs))
    logs = ", ".join([*more_logs, *(log for job in jobs for log in job["log"])])
    return {jobs[0]["jobid"]: f"Failed: {names}: {ending(said)}{' (log: ' if logs else ''}{logs}{')' if logs else ''}"}


def ending(said: str) -> str:
    """How a script ended that gave no reason, and what to do about it.

    Parameters
    ----------
    said : str
        Snakemake's message.
    """
    found = words.ENDED_BY.search(said)
    if found is None:
        return "gave no reason in its log (killed, out of time, or failed before it began)"
    name, code = found[1], int(found[2] or 0)
    if name is None and code > 128:  # as shells report a program that a signal ended
        name = next((one.name for one in signal.Signals if one == code - 128), None)
    if name is None:
        return f"ended with exit status {code} before its log began; the lines above say why"
    return f"ended by {name}{SIGNALLED.get(name, '; run the same command again')}"


def without_files(step: Step) -> dict[int, str]:
    """Of a job that ended well and left files out."""
    made = described({"rule_name": step.rule, "output": step.files})
    return {step.number: f"Failed: {made}: ended well, but files are missing; Snakemake's message says which"}


def at_end(lines: Sequence[str]) -> list[str]:
    """The first ones, as these are the cause of others more often than not, after how many are left out."""
    left_out = len(lines) - SHOWN_AT_END
    more = [f"Failed: {left_out} more jobs than these, which were the first"] if left_out > 0 else []
    return more + list(lines[:SHOWN_AT_END])


def described(job: dict) -> str:
    """A job by what it was to make: its acquisitions, or its first file."""
    files = job["output"]
    if not files:
        return job["rule_name"]
    found = [match[1] for match in map(ACQUISITION.fullmatch, files) if match]
    if len(found) < len(files):
        made = f"{files[0]} and {len(files) - 1} more" if len(files) > 1 else files[0]
    else:
        levels = [list(seeds) for _, seeds in itertools.groupby(found, os.path.dirname)]
        made = ", ".join(
            seeds[0] + (f" to {os.path.basename(seeds[-1])}" if len(seeds) > 1 else "") for seeds in levels
        )
    return f"{stage_of(job['rule_name'])} of {made}"
