"""Snakemake's messages for people: few lines while all goes well, and the reason as the last one when it does not.

Records are told apart by their `event`, which has the names of snakemake_interface_logger_plugins.common.LogEvent. They
go on to Snakemake's log file as they are. Written for Snakemake 9: what it logs otherwise is handed on.
"""

from __future__ import annotations

import itertools
import logging
import os
import re
import time
from collections.abc import Callable, Iterable
from pathlib import Path

from ..job import last_reason
from .time_left import Progress, Step, stage_of

# Each line after the first comes this long after the one before it, or a thirtieth of the time since the start: the
# longer a run, the rarer, so that hours have no more than hundreds of lines.
SECONDS_BETWEEN = 10.0
SHARE_BETWEEN = 1 / 30
FAILURES_SHOWN = 10
STOPPED_START = "Terminating processes on user request"
ACQUISITION = re.compile(r"(.*/seed\d+)\.[a-z0-9.]+")

SILENT_EVENTS = {"progress", "job_started", "group_info", "shellcmd", "resources_info", "run_info"}
SILENT_STARTS = ("Select jobs to execute...", "Removing temporary output ", "Exiting because a job execution failed.")


class Console(logging.Handler):
    """Takes the place of Snakemake's own handler for the terminal.

    inner     that handler, which gets what is not said here
    progress  the run
    logs      folder of the jobs' logs
    clock     seconds since the epoch
    """

    def __init__(
        self, inner: logging.StreamHandler, progress: Progress, logs: str, clock: Callable[[], float] = time.time
    ):
        super().__init__()
        self.inner, self.progress, self.clock = inner, progress, clock
        self.said: float | None = None
        self.failures: list[str] = []
        self.stopped = False
        self._write(f"Jobs to do: {len(progress.steps)}. Their logs: {logs}")

    def emit(self, record: logging.LogRecord) -> None:
        event = str(getattr(record, "event", None))
        act = getattr(self, f"_{event}", None)
        self.stopped |= str(record.msg).startswith(STOPPED_START)
        if act is not None:
            act(record)
        elif event not in SILENT_EVENTS and not str(record.msg).startswith(SILENT_STARTS):
            self.inner.handle(record)

    def close(self) -> None:
        self.inner.close()
        super().close()

    def _job_info(self, record):
        self.progress.start(record.jobid, self.clock())
        self._status()

    def _job_finished(self, record):
        self.progress.finish(record.job_id, self.clock())
        # Between two jobs there is nothing to say: the next one is about to begin.
        if self.progress.under_way or len(self.progress.took) == len(self.progress.steps):
            self._status()

    def _status(self):
        """Say how far it is, if it has not just been said."""
        progress, now = self.progress, self.clock()
        done, jobs = len(progress.took), len(progress.steps)
        between = max(SECONDS_BETWEEN, SHARE_BETWEEN * (now - progress.began))
        if done == jobs:
            self._write(f"{done} of {jobs} jobs done in {duration(now - progress.began)}", now)
        elif self.said is None or now - self.said >= between:
            left = "" if self.said is None else time_left(*progress.seconds_left(now))
            stages = ", ".join(f"{stage} ({some} of {all_} done)" for stage, some, all_ in progress.stages())
            self._write(f"{done} of {jobs} jobs done{left}{'; now: ' if stages else ''}{stages}", now)

    def _write(self, text, now=None):
        self.said = now
        stamp = time.strftime("%H:%M:%S ", time.localtime(self.clock()))
        self.inner.stream.write(f"{stamp}{text}\n")
        self.inner.stream.flush()

    def _job_error(self, record):
        # Of a group, the group has been told of.
        if not getattr(record, "indent", False):
            self._failed([vars(record)], [], record)

    def _group_error(self, record):
        self._failed(record.job_error_info, record.aux_logs, record)

    def _failed(self, jobs, more_logs, record):
        """Remember why, and say so now if others go on. What gave no reason is told in Snakemake's words too."""
        if self.stopped:
            return
        told = []
        for job in jobs:
            self.progress.fail(job["jobid"])
            if reason := next(filter(None, (last_reason(log, self.progress.began) for log in job["log"])), None):
                told.append(f"Failed: {described(job)}: {reason} (log: {job['log'][0]})")
        if not told:
            self.inner.handle(record)
            logs = ", ".join([*more_logs, *(log for job in jobs for log in job["log"])])
            names = ", ".join(map(described, jobs))
            told = [f"Failed: {names}: ended without a word, as jobs do that are killed; see {logs}"]
        self.failures += told
        if self.progress.under_way:
            for line in told:
                self._write(line, self.said)

    def _error(self, record):
        """The end of a run with failures; an exception otherwise, unless all it says is that a script ended with 1."""
        kind, text = getattr(record, "exception", ""), str(record.msg)
        if self.stopped and not self.failures and kind in ("RuleException", "WorkflowError"):
            if kind == "WorkflowError":
                self._write("Stopped. What is done stays; the same command goes on from there.")
        elif kind == "WorkflowError" and "At least one job did not complete" in text and self.failures:
            left_out = len(self.failures) - FAILURES_SHOWN
            if left_out > 0:
                self.inner.stream.write(f"Failed: {left_out} more jobs than these\n")
            self.inner.stream.write("".join(f"{line}\n" for line in self.failures[-FAILURES_SHOWN:]))
            self.inner.stream.flush()
        elif kind != "RuleException" or "returned non-zero exit status 1." not in text:
            self.inner.handle(record)


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


def time_left(seconds: float, complete: bool) -> str:
    """An estimate in words; nothing where there is none."""
    if complete:
        return f", about {duration(seconds)} left"
    return f", more than {duration(seconds)} left" if seconds else ""


def duration(seconds: float) -> str:
    """Time to the precision that one needs to plan with."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 90 * 60 else f"{seconds / 3600:.1f} h"


def take_over(logger: logging.Logger, steps: Iterable[Step], cores: int | None, expected, logs: str | Path) -> None:
    """Say the rest of a run's messages in our words, where Snakemake writes to the terminal in its own.

    Another logger plugin, or another name of that handler in a later Snakemake, leaves all as it is.
    """
    for handler in list(logger.handlers):
        if handler.get_name() == "DefaultStreamHandler":
            logger.removeHandler(handler)
            logger.addHandler(Console(handler, Progress(steps, cores, expected, time.time()), str(logs)))
