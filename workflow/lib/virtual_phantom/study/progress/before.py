"""The console before jobs run, and in dry runs: no line that says nothing of this run.

Snakemake writes some ten lines and a table of rules before the first job, and in a dry run every path of every job.
"""

from __future__ import annotations

import logging
import re
import sys
from collections import Counter
from collections.abc import Callable, Mapping

from ...base.words import counted
from . import words
from .failures import described
from .load import slowdown
from .status import duration_range
from .time_left import Progress, Seconds, Step, stage_of

SILENT_EVENTS = {"resources_info", "run_info", "workflow_started"}
# How many of the files that trigger jobs a dry run names.
NAMED = 3
# Reasons that follow from another job of the same run.
FOLLOWS = "Input files updated by another job"


def terminal(logger: logging.Logger) -> list[logging.Handler]:
    """Handlers that write to the terminal: Snakemake's own, or what has replaced it; none of a logger plugin."""
    return [
        handler
        for handler in logger.handlers
        if isinstance(handler, Before)
        or (isinstance(handler, logging.StreamHandler) and handler.stream in (sys.stdout, sys.stderr))
    ]


def wants_snakemake_s_words(settings) -> bool:
    """Whether the user set more or fewer lines than usual: these are Snakemake's.

    Parameters
    ----------
    settings : OutputSettings
        Snakemake's.
    """
    # The profile's, and one that leaves a line for each job out, as this console does.
    usual = {"HOST"} if settings.dryrun else {"HOST", "RULES"}
    more = settings.verbose or settings.debug_dag or (settings.dryrun and settings.printshellcmds)
    return more or bool({what.name for what in settings.quiet or ()} - usual)


def be_quiet(logger: logging.Logger, settings) -> None:
    """Replace Snakemake's handler for the terminal by one that leaves out what says nothing of this run.

    Parameters
    ----------
    logger : Logger
        Snakemake's.
    settings : OutputSettings
        Snakemake's.
    """
    if wants_snakemake_s_words(settings):
        return
    for handler in terminal(logger):
        if not isinstance(handler, Before):
            logger.removeHandler(handler)
            logger.addHandler((DryRun if settings.dryrun else Before)(handler))


class Before(logging.Handler):
    """Passes on what says something of this run.

    Parameters
    ----------
    inner : StreamHandler
        Snakemake's handler for the terminal.
    """

    def __init__(self, inner: logging.StreamHandler):
        super().__init__()
        self.inner = inner

    def emit(self, record: logging.LogRecord) -> None:
        """Take a record."""
        event = getattr(record, "event", None)
        if event is None:
            silent = str(record.msg).startswith((*words.BEFORE, *words.NOISE))
        else:
            silent = str(event) in SILENT_EVENTS
        if not silent:
            self.inner.handle(record)

    def close(self) -> None:
        """End."""
        self.inner.close()
        super().close()


class DryRun(Before):
    """Prints a line for each stage in place of a block for each job.

    Attributes
    ----------
    expected : callable or None
        As Progress takes it; None until rules are read.
    cores : callable
        Gives how many cores a run may use, or None.
    folder : str
        Of the results.
    jobs : dict of int to dict
        Records of the jobs that would run, by number.
    """

    def __init__(self, inner: logging.StreamHandler):
        super().__init__(inner)
        self.expected: Callable[[], Mapping[str, Seconds]] | None = None
        self.cores: Callable[[], int | None] = lambda: None
        self.folder = ""
        self.jobs: dict[int, dict] = {}

    def emit(self, record: logging.LogRecord) -> None:
        """Take a record."""
        event, text = str(getattr(record, "event", "")), str(record.msg)
        if event == "group_info":
            return
        if event == "job_info":
            if record.output:
                self.jobs[record.jobid] = vars(record)
        elif not event and text.startswith(words.DRY_RUN_ENDS):
            self.inner.stream.write("".join(f"{line}\n" for line in self.lines()))
            self.inner.stream.flush()
        elif event or not text.startswith(words.DRY_RUN):
            super().emit(record)

    def lines(self) -> list[str]:
        """What would run, by stage, and why."""
        jobs = list(self.jobs.values())
        steps = [Step(one["jobid"], one["rule_name"], tuple(one["output"]), one["threads"]) for one in jobs]
        time, cores = "", self.cores()
        if self.expected is not None:
            progress = Progress(steps, cores, self.expected, 0.0, slowdown(cores))
            time = duration_range(*progress.range_left(0.0))
        given = f" on {counted(cores, 'core')}" if cores else ""
        first = f"{counted(len(jobs), 'job')} would run" + (f", {time}{given}" if time else "")
        stages: dict[str, list[dict]] = {}
        for one in jobs:
            stages.setdefault(stage_of(one["rule_name"]), []).append(one)
        width = max(map(len, stages), default=0)
        rows = [
            f"  {stage:<{width}} {len(some):>5}  {described(some[0]).partition(' of ')[2]}{_more(some)}"
            for stage, some in stages.items()
        ]
        ends = f"Results: {self.folder}. " if self.folder else ""
        return [
            f"{first}:",
            *rows,
            *self.reasons(),
            f"{ends}Dry run: nothing was made. -p lists all files of each job.",
        ]

    def reasons(self) -> list[str]:
        """Why jobs would run, apart from those that follow from others."""
        counts, named = Counter(), {}
        for one in self.jobs.values():
            for reason in filter(None, re.split(r"; (?=[A-Z])", one["reason"] or "")):
                kind, _, files = reason.partition(": ")
                if kind == FOLLOWS:
                    continue
                counts[kind] += 1
                if kind.startswith("Updated"):
                    named.setdefault(kind, dict.fromkeys([])).update(dict.fromkeys(files.split(", ")))
        reasons = []
        for kind, count in counts.items():
            files = list(named.get(kind, ()))
            more = f" and {len(files) - NAMED} more" if len(files) > NAMED else ""
            names = f": {', '.join(files[:NAMED])}{more}" if files else ""
            reasons.append(f"{kind.lower()} ({counted(count, 'job')}{names})")
        return [f"Why: {'; '.join(reasons)}"] if reasons else []


def _more(jobs):
    return ", ..." if len(jobs) > 1 else ""
