"""Snakemake's messages for people: few lines while all goes well, and the reason as the last one when it does not.

Records are told apart by their `event`, which has the names of snakemake_interface_logger_plugins.common.LogEvent, and
by the fields that come with it. That somebody stops a run is heard from the signal. What is left is in `words`. Records
go on to Snakemake's log file as they are.

This is no logger plugin: Snakemake loads one by --logger alone and from an installed package, and the library beside
the rules need not be installed (rules/library.smk). A plugin also gets no event for which jobs there are and which of
them wait for which.
"""

from __future__ import annotations

import logging
import signal
import threading
import time
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

from . import failures, words
from .before import Before, terminal
from .load import slowdown
from .status import Status
from .time_left import Progress, Step

SECONDS_BETWEEN_LOOKS = 1.0  # whether it is time for a line

INDEX = "index_page"  # the rule whose page is named at the end

SILENT_EVENTS = {"progress", "job_started", "shellcmd", "resources_info", "run_info"}


class Console(logging.Handler):
    """Takes the place of Snakemake's own handler for the terminal.

    Parameters
    ----------
    inner : StreamHandler
        That handler, which gets what is not said here.
    progress : Progress
        The run.
    logs : str
        Folder of the jobs' logs.
    keep_going : bool, optional
        Whether further jobs are started after one has failed.
    clock : callable, optional
        Gives seconds since the epoch.
    results : str, optional
        Folder of the results.
    in_full : bool, optional
        Whether Snakemake's block for a job that failed without a reason is printed too.
    """

    def __init__(
        self,
        inner: logging.StreamHandler,
        progress: Progress,
        logs: str,
        keep_going: bool = False,
        clock: Callable[[], float] = time.time,
        results: str = "",
        in_full: bool = False,
    ):
        super().__init__()
        self.inner, self.progress, self.keep_going, self.clock = inner, progress, keep_going, clock
        self.in_full = in_full
        made = (file for step in progress.steps.values() if step.rule == INDEX for file in step.files)
        self.status = Status(inner.stream, progress, clock, start=next(made, None))
        self.failed: dict[int, str] = {}
        self.untold: list[str] = []
        self.ended: dict[int, logging.LogRecord] = {}
        self.groups: dict[int, list[int]] = {}
        self.cut_short = self.let_finish = False
        self.said_without_event = ""
        self.closed = threading.Event()
        self.handle(logging.makeLogRecord({"event": "began", "msg": "began", "results": results, "logs": logs}))

    def emit(self, record: logging.LogRecord) -> None:
        # What went wrong in here must not end the run: Snakemake would cancel its jobs.
        """Take a record."""
        try:
            self._take(record)
        except Exception:
            self.handleError(record)

    def look_on(self) -> None:
        """Say how far it is while jobs run, too, from a thread that ends with `close` or with the program."""
        self._looking = threading.Thread(target=self._look, name="progress", daemon=True)
        self._looking.start()

    def hear_of_stops(self) -> None:
        """Hear of Ctrl-C, which ends what is under way, and of SIGTERM, which lets it finish; before Snakemake does."""
        for number in (signal.SIGINT, signal.SIGTERM):
            before = signal.getsignal(number)
            if callable(before) and threading.current_thread() is threading.main_thread():
                signal.signal(number, partial(self._stop, before))

    def _stop(self, before, number, frame):
        # No more than this: the thread that is interrupted may be saying something.
        if number == signal.SIGINT:
            self.cut_short = True
        else:
            self.let_finish = True
        before(number, frame)

    def close(self) -> None:
        """End, and with it the thread that looks on."""
        self.closed.set()
        self.inner.close()
        super().close()

    def _look(self):
        # As a record, so that the handler's lock keeps its lines apart from others.
        while not self.closed.wait(SECONDS_BETWEEN_LOOKS):
            self.handle(logging.makeLogRecord({"event": "time_passed", "msg": "progress"}))

    def _take(self, record):
        event = getattr(record, "event", None)
        act = getattr(self, f"_{event}", None)
        if act is not None:
            act(record)
        elif event is None:
            self._without_event(record)
        elif str(event) not in SILENT_EVENTS:
            self.inner.handle(record)

    def _without_event(self, record):
        """What is said once: that jobs may finish is repeated each time that one ends."""
        text = str(record.msg)
        if not text.startswith(words.NOISE) and text != self.said_without_event:
            self.said_without_event = text
            self.inner.handle(record)

    def _began(self, record):
        self.status.begin(record.results, record.logs)

    def _time_passed(self, record):
        if self.progress.under_way and not self.closed.is_set():
            self._say()

    def _group_info(self, record):
        numbers = [job.jobid for job in record.jobs]
        self.groups |= dict.fromkeys(numbers, numbers)

    def _job_info(self, record):
        if record.jobid not in self.progress.steps:
            return
        self.progress.start(record.jobid, self.clock())
        if record.jobid in self.failed:  # tried again: why, is told now
            self._tell()
            del self.failed[record.jobid]
        self._say()

    def _job_finished(self, record):
        if record.job_id not in self.progress.steps:
            return
        self.progress.finish(record.job_id, self.clock())
        # Between two jobs there is nothing to say: the next one is about to begin.
        if self.progress.under_way or len(self.progress.took) == len(self.progress.steps):
            self._say()

    def _say(self):
        ending = self.cut_short or self.let_finish or (bool(self.failed) and not self.keep_going)
        self.status.say(len(self.failed), ending)

    def _job_error(self, record):
        # Of a group, the group has been told of.
        if not getattr(record, "indent", False):
            self._jobs_failed([vars(record)], [], record)

    def _group_error(self, record):
        self._jobs_failed(record.job_error_info, record.aux_logs, record)

    def _jobs_failed(self, jobs, more_logs, record):
        """Remember why: the reason in the log, or else how the script ended."""
        ended = self.ended.pop(record.thread, None)
        if self.cut_short:
            return
        for job in jobs:
            self.progress.fail(job["jobid"])
        lines = failures.from_logs(jobs, self.progress.began)
        if not lines:
            lines = failures.without_reason(jobs, more_logs, "" if ended is None else str(ended.msg))
            if self.in_full:
                for said in filter(None, (ended, record)):
                    self.inner.handle(said)
        self._remember(lines)

    def _remember(self, lines):
        """Keep why jobs failed for the end, and say so now if others go on: otherwise the end is near."""
        self.failed |= lines
        self.untold += lines.values()
        if self.progress.under_way or self.keep_going:
            self._tell()

    def _tell(self):
        lines, self.untold = self.untold, []
        for line in lines:
            self.status.write(line)

    def _error(self, record):
        """The end of a run that is not complete, or an exception."""
        kind, text = getattr(record, "exception", ""), str(record.msg)
        if kind == "WorkflowError" and words.INCOMPLETE in text:
            self._ended(record)
        elif kind == "RuleException" and self.cut_short:
            pass  # how the jobs ended that were under way
        elif kind == "RuleException" and words.ENDED_BY.search(text):
            # What the same thread says next is that the job failed, and its log says why, if it got so far.
            self.ended[record.thread] = record
        else:
            self.inner.handle(record)
            missing = words.FILES_MISSING.search(text)
            step = self.progress.steps.get(int(missing[1])) if missing else None
            if step is not None:
                # Snakemake gives up the whole group, and says no more of it.
                for number in self.groups.get(step.number, [step.number]):
                    self.progress.fail(number)
                self._remember(failures.without_files(step))

    def _ended(self, record):
        for unexplained in self.ended.values():
            self.inner.handle(unexplained)
        if self.failed:
            self.status.write(self.status.counts(len(self.failed)))
            self.inner.stream.write("".join(f"{line}\n" for line in failures.at_end(list(self.failed.values()))))
            self.inner.stream.flush()
        elif self.cut_short or self.let_finish:
            self.status.write("Stopped. What is done stays; the same command goes on from there.")
        else:
            self.inner.handle(record)


def take_over(
    logger: logging.Logger,
    steps: Iterable[Step],
    cores: int | None,
    expected,
    logs: str | Path,
    keep_going: bool,
    results: str = "",
    in_full: bool = False,
) -> None:
    """Say the rest of a run's messages in our words, where Snakemake writes to the terminal in its own.

    Another handler, as that of a logger plugin, stays as it is.

    Parameters
    ----------
    logger : Logger
        Snakemake's.
    steps : iterable of Step
        The run's jobs.
    cores : int or None
        How many it may use at a time; None where that is not known, as on a cluster.
    expected : callable
        Gives {file: seconds of one core that its job takes}, of jobs with a measured rate.
    logs : str or Path
        Folder of the jobs' logs.
    keep_going : bool
        Whether further jobs are started after one has failed.
    results : str, optional
        Folder of the results.
    in_full : bool, optional
        Whether Snakemake's block for a job that failed without a reason is printed too.
    """
    for handler in terminal(logger):
        inner = handler.inner if isinstance(handler, Before) else handler
        progress = Progress(steps, cores, expected, time.time(), slowdown(cores))
        console = Console(inner, progress, str(logs), keep_going, results=results, in_full=in_full)
        logger.removeHandler(handler)
        logger.addHandler(console)
        console.hear_of_stops()
        console.look_on()
