"""One line for each failed job: its name and the reason.

A job is a dict with these keys of Snakemake's record of the failure: rule_name, jobid, output, log.
"""

from __future__ import annotations

import itertools
import os
import re
import signal
from collections.abc import Sequence

from ..job import last_reason
from . import snakemake_messages
from .time_left import Step, stage_of

SHOWN_AT_END = 10
# Most frequent cause of each signal, and what to do.
CRASHED = " (a crash); run the command again, and report the log if it fails again"
SIGNALLED = {
    "SIGKILL": ", most often because memory ran out; run with fewer --cores, or a smaller grid",
    "SIGTERM": " (stopped from outside or out of time); run the same command again to continue",
    "SIGINT": " (Ctrl-C); run the same command again to continue",
    "SIGHUP": " (terminal closed); run the same command again to continue",
    "SIGXCPU": ": the limit of CPU time is reached; raise it (ulimit -t)",
    "SIGXFSZ": ": a file exceeds the size limit of this shell; raise it (ulimit -f)",
    "SIGBUS": ", most often because a disk or shared memory is full; free some space",
    "SIGSEGV": CRASHED,
    "SIGABRT": CRASHED,
    "SIGILL": CRASHED,
    "SIGFPE": CRASHED,
}
ACQUISITION = re.compile(r"(.*/seed\d+)\.[a-z0-9.]+")


def from_logs(jobs: Sequence[dict], since: float) -> dict[int, str]:
    """Return {job number: line} for jobs whose log gives a reason that is newer than `since` (s since the epoch)."""
    lines = {}
    for job in jobs:
        if reason := next(filter(None, (last_reason(log, since) for log in job["log"])), None):
            lines[job["jobid"]] = f"Failed: {described(job)}: {reason} (log: {job['log'][0]})"
    return lines


def without_reason(jobs: Sequence[dict], more_logs: Sequence[str] = (), message: str = "") -> dict[int, str]:
    """Return {number of the first job: line} for jobs that ended together without a reason in their logs.

    The line names further logs, such as a cluster's, and how the script ended, from Snakemake's message.
    """
    names = ", ".join(map(described, jobs))
    logs = ", ".join([*more_logs, *(log for job in jobs for log in job["log"])])
    where = f" (log: {logs})" if logs else ""
    return {jobs[0]["jobid"]: f"Failed: {names}: {ending(message)}{where}"}


def ending(message: str) -> str:
    """Return how a script without a reason in its log ended, and what to do, from Snakemake's message."""
    found = snakemake_messages.ENDED_BY.search(message)
    if found is None:
        return "gave no reason in its log (killed, out of time, or failed at startup)"
    name, code = found[1], int(found[2] or 0)
    if name is None and code > 128:  # a shell adds 128 to the number of the signal
        name = next((number.name for number in signal.Signals if number == code - 128), None)
    if name is None:
        return f"ended with exit status {code} before its log began; see the lines above for the reason"
    return f"ended by {name}{SIGNALLED.get(name, '; run the same command again')}"


def without_files(step: Step) -> dict[int, str]:
    """Return {job number: line} for a job that ended without an error but without some of its files."""
    job = described({"rule_name": step.rule, "output": step.files})
    return {step.number: f"Failed: {job}: no error, but files are missing; Snakemake's message names them"}


def at_end(lines: Sequence[str]) -> list[str]:
    """Return the number of omitted failures, if any, and the first failures: these often cause the later ones."""
    omitted = len(lines) - SHOWN_AT_END
    more = [f"Failed: {omitted} more jobs; the first failures were:"] if omitted > 0 else []
    return more + list(lines[:SHOWN_AT_END])


def described(job: dict) -> str:
    """Name a job by its stage and by its acquisitions or its first file."""
    files = job["output"]
    if not files:
        return job["rule_name"]
    acquisitions = [match[1] for match in map(ACQUISITION.fullmatch, files) if match]
    if len(acquisitions) < len(files):
        outputs = f"{files[0]} and {len(files) - 1} more" if len(files) > 1 else files[0]
    else:
        levels = [list(seeds) for _, seeds in itertools.groupby(acquisitions, os.path.dirname)]
        outputs = ", ".join(
            seeds[0] + (f" to {os.path.basename(seeds[-1])}" if len(seeds) > 1 else "") for seeds in levels
        )
    return f"{stage_of(job['rule_name'])} of {outputs}"
