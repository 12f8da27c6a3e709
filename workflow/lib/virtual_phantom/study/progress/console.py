"""Snakemake's messages for people: few lines while all goes well, and the reason as the last one when it does not.

Records are told apart by their `event`, which has the names of snakemake_interface_logger_plugins.common.LogEvent. They
go on to Snakemake's log file as they are. Written for Snakemake 9: what it logs otherwise is handed on.
"""

from __future__ import annotations

import logging
import re
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path

from . import failures
from .status import Status
from .time_left import Progress, Step

SECONDS_BETWEEN_LOOKS = 1.0  # whether it is time for a line

# Ctrl-C ends what is under way; SIGTERM lets it finish, and is told of again each time that a job ends.
CUT_SHORT_START = "Terminating processes on user request"
LET_FINISH_START = "Will exit after finishing currently running jobs"
AGAIN_START = "Trying to restart job "
INCOMPLETE = "At least one job did not complete"
FILES_MISSING = re.compile(r"Job (\d+)\s+completed successfully, but some output files are missing")

SILENT_EVENTS = {"progress", "job_started", "shellcmd", "resources_info", "run_info"}
SILENT_STARTS = ("Select jobs to execute...", "Removing temporary output ", "Exiting because a job execution failed.")


class Console(logging.Handler):
    """Takes the place of Snakemake's own handler for the terminal.

    inner       that handler, which gets what is not said here
    progress    the run
    logs        folder of the jobs' logs
    keep_going  whether further jobs are started after one has failed
    clock       seconds since the epoch
    """

    def __init__(
        self,
        inner: logging.StreamHandler,
        progress: Progress,
        logs: str,
        keep_going: bool = False,
        clock: Callable[[], float] = time.time,
    ):
        super().__init__()
        self.inner, self.progress, self.keep_going, self.clock = inner, progress, keep_going, clock
        self.status = Status(inner.stream, progress, clock)
        self.failed: dict[int, str] = {}
        self.untold: list[str] = []
        self.exited_with_1: dict[int, logging.LogRecord] = {}
        self.groups: dict[int, list[int]] = {}
        self.cut_short = self.let_finish = False
        self.closed = threading.Event()
        self.status.write(f"Jobs to do: {len(progress.steps)}. Their logs: {logs}")

    def emit(self, record: logging.LogRecord) -> None:
        # What went wrong in here must not end the run: Snakemake would cancel its jobs.
        try:
            self._take(record)
        except Exception:
            self.handleError(record)

    def look_on(self) -> None:
        """Say how far it is while jobs run, too, from a thread that ends with `close` or with the program."""
        self._looking = threading.Thread(target=self._look, name="progress", daemon=True)
        self._looking.start()

    def close(self) -> None:
        self.closed.set()
        self.inner.close()
        super().close()

    def _look(self):
        # As a record, so that the handler's lock keeps its lines apart from others.
        while not self.closed.wait(SECONDS_BETWEEN_LOOKS):
            self.handle(logging.makeLogRecord({"event": "time_passed", "msg": "progress"}))

    def _take(self, record):
        event, text = str(getattr(record, "event", None)), str(record.msg)
        act = getattr(self, f"_{event}", None)
        if act is not None:
            act(record)
            return
        told_before = text.startswith(LET_FINISH_START) and self.let_finish
        self.cut_short |= text.startswith(CUT_SHORT_START)
        self.let_finish |= text.startswith(LET_FINISH_START)
        if text.startswith(AGAIN_START):
            self._tell()
        if not told_before and event not in SILENT_EVENTS and not text.startswith(SILENT_STARTS):
            self.inner.handle(record)

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
        self.failed.pop(record.jobid, None)
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
        """Remember why. What gave no reason is told in Snakemake's words too."""
        exited_with_1 = self.exited_with_1.pop(record.thread, None)
        if self.cut_short:
            return
        for job in jobs:
            self.progress.fail(job["jobid"])
        lines = failures.from_logs(jobs, self.progress.began)
        if not lines:
            lines = failures.without_reason(jobs, more_logs)
            for said in filter(None, (exited_with_1, record)):
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
        if kind == "WorkflowError" and INCOMPLETE in text:
            self._ended(record)
        elif kind == "RuleException" and self.cut_short:
            pass  # how the jobs ended that were under way
        elif kind == "RuleException" and "returned non-zero exit status 1." in text:
            # What the same thread says next is that the job failed, and its log says why, if it got so far.
            self.exited_with_1[record.thread] = record
        else:
            self.inner.handle(record)
            missing = FILES_MISSING.search(text)
            step = self.progress.steps.get(int(missing[1])) if missing else None
            if step is not None:
                # Snakemake gives up the whole group, and says no more of it.
                for number in self.groups.get(step.number, [step.number]):
                    self.progress.fail(number)
                self._remember(failures.without_files(step))

    def _ended(self, record):
        for unexplained in self.exited_with_1.values():
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
    logger: logging.Logger, steps: Iterable[Step], cores: int | None, expected, logs: str | Path, keep_going: bool
) -> None:
    """Say the rest of a run's messages in our words, where Snakemake writes to the terminal in its own.

    Another logger plugin, or another name of that handler in a later Snakemake, leaves all as it is.
    """
    for handler in list(logger.handlers):
        if handler.get_name() == "DefaultStreamHandler":
            console = Console(handler, Progress(steps, cores, expected, time.time()), str(logs), keep_going)
            logger.removeHandler(handler)
            logger.addHandler(console)
            console.look_on()
