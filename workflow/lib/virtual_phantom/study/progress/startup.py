"""Console output before the first job and in dry runs, without Snakemake's lines that are the same in every run.

Snakemake prints about ten lines and a table of rules before the first job, and in a dry run all files of every job.
"""

from __future__ import annotations

import logging
import re
import sys
from collections import Counter
from collections.abc import Callable, Mapping

from ...base.names import counted
from . import snakemake_messages
from .failures import described
from .load import slowdown
from .status import duration_range
from .time_left import Progress, Seconds, Step, stage_of

SILENT_EVENTS = {"resources_info", "run_info", "workflow_started"}
# Files that trigger jobs, as many as a dry run names.
NAMED = 3
# The reason of jobs that run because another job of the same run does. It is not printed.
FOLLOWS = "Input files updated by another job"


def terminal_handlers(logger: logging.Logger) -> list[logging.Handler]:
    """Return the handlers that write to the terminal: Snakemake's or its replacement, but no logger plugin."""
    return [
        handler
        for handler in logger.handlers
        if isinstance(handler, StartupHandler)
        or (isinstance(handler, logging.StreamHandler) and handler.stream in (sys.stdout, sys.stderr))
    ]


def wants_snakemake_output(settings) -> bool:
    """Return whether the options of the run (Snakemake's OutputSettings) set more or fewer lines than usual."""
    # HOST is set by the default profile. RULES hides the block of each job, as this console does.
    usual = {"HOST"} if settings.dryrun else {"HOST", "RULES"}
    more = settings.verbose or settings.debug_dag or (settings.dryrun and settings.printshellcmds)
    return more or bool({what.name for what in settings.quiet or ()} - usual)


def install_startup_handler(logger: logging.Logger, settings) -> None:
    """Replace the terminal handler of Snakemake's logger, unless its OutputSettings set more or fewer lines."""
    if wants_snakemake_output(settings):
        return
    for handler in terminal_handlers(logger):
        if not isinstance(handler, StartupHandler):
            logger.removeHandler(handler)
            logger.addHandler((DryRunHandler if settings.dryrun else StartupHandler)(handler))


class StartupHandler(logging.Handler):
    """Filter in front of Snakemake's terminal handler `inner`, which hides lines that are the same in every run."""

    def __init__(self, inner: logging.StreamHandler):
        super().__init__()
        self.inner = inner

    def emit(self, record: logging.LogRecord) -> None:
        """Handle a record."""
        event = getattr(record, "event", None)
        if event is None:
            hidden = str(record.msg).startswith((*snakemake_messages.HIDDEN_AT_STARTUP, *snakemake_messages.HIDDEN))
        else:
            hidden = str(event) in SILENT_EVENTS
        if not hidden:
            self.inner.handle(record)

    def close(self) -> None:
        """Close the handler."""
        self.inner.close()
        super().close()


class DryRunHandler(StartupHandler):
    """Handler of dry runs: prints one line for each stage instead of a block for each job."""

    def __init__(self, inner: logging.StreamHandler):
        super().__init__(inner)
        self.expected: Callable[[], Mapping[str, Seconds]] | None = None  # as in `Progress`; set with the rules
        self.cores: Callable[[], int | None] = lambda: None  # cores that a run may use
        self.folder = ""  # of the results
        self.jobs: dict[int, dict] = {}  # records by job number

    def emit(self, record: logging.LogRecord) -> None:
        """Handle a record."""
        event, text = str(getattr(record, "event", "")), str(record.msg)
        if event == "group_info":
            return
        if event == "job_info":
            if record.output:
                self.jobs[record.jobid] = vars(record)
        elif not event and text.startswith(snakemake_messages.DRY_RUN_ENDS):
            self.inner.stream.write("".join(f"{line}\n" for line in self.lines()))
            self.inner.stream.flush()
        elif event or not text.startswith(snakemake_messages.DRY_RUN):
            super().emit(record)

    def lines(self) -> list[str]:
        """Return lines with the jobs that would run, by stage, and the reasons."""
        jobs = list(self.jobs.values())
        steps = [Step(job["jobid"], job["rule_name"], tuple(job["output"]), job["threads"]) for job in jobs]
        time, cores = "", self.cores()
        if self.expected is not None:
            progress = Progress(steps, cores, self.expected, 0.0, slowdown(cores))
            time = duration_range(*progress.range_left(0.0))
        on_cores = f" on {counted(cores, 'core')}" if cores else ""
        first = f"{counted(len(jobs), 'job')} would run" + (f", {time}{on_cores}" if time else "")
        stages: dict[str, list[dict]] = {}
        for job in jobs:
            stages.setdefault(stage_of(job["rule_name"]), []).append(job)
        width = max(map(len, stages), default=0)
        rows = [
            f"  {stage:<{width}} {len(group):>5}  {described(group[0]).partition(' of ')[2]}"
            + (", ..." if len(group) > 1 else "")
            for stage, group in stages.items()
        ]
        results = f"Results: {self.folder}. " if self.folder else ""
        return [
            f"{first}:",
            *rows,
            *self.reasons(),
            f"{results}Dry run: nothing was made. -p lists all files of each job.",
        ]

    def reasons(self) -> list[str]:
        """Return a line with the reasons for the jobs, except for jobs that run because another job does."""
        counts, named = Counter(), {}
        for job in self.jobs.values():
            for reason in filter(None, re.split(r"; (?=[A-Z])", job["reason"] or "")):
                kind, _, files = reason.partition(": ")
                if kind == FOLLOWS:
                    continue
                counts[kind] += 1
                if kind.startswith("Updated"):
                    named.setdefault(kind, {}).update(dict.fromkeys(files.split(", ")))
        reasons = []
        for kind, count in counts.items():
            files = list(named.get(kind, ()))
            more = f" and {len(files) - NAMED} more" if len(files) > NAMED else ""
            names = f": {', '.join(files[:NAMED])}{more}" if files else ""
            reasons.append(f"{kind.lower()} ({counted(count, 'job')}{names})")
        return [f"Why: {'; '.join(reasons)}"] if reasons else []
