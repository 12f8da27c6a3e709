"""Console output while jobs run: short progress lines, and the reason of each failure at the end.

Log records are recognized by their `event` (snakemake_interface_logger_plugins.common.LogEvent), by the fields of the
event, and otherwise by the texts in `snakemake_messages`. A stop by the user is recognized by its signal. Snakemake's
log file still gets every record.

The console is not a Snakemake logger plugin, for two reasons. The events of a plugin lack the list of jobs and their
dependencies, which the estimate of the time left needs. Snakemake loads plugins only from installed packages, and the
library next to the rules need not be installed (rules/library.smk).
"""

from __future__ import annotations

import logging
import signal
import threading
import time
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

from . import failures, snakemake_messages
from .load import slowdown
from .startup import StartupHandler, terminal_handlers
from .status import StatusLines
from .time_left import Progress, Step

TIMER_SECONDS = 1.0  # between two checks whether a progress line is due
INDEX = "index_page"  # rule whose page is named at the end
SILENT_EVENTS = {"progress", "job_started", "shellcmd", "resources_info", "run_info"}


class Console(logging.Handler):
    """Handler that replaces Snakemake's terminal handler while jobs run.

    Parameters
    ----------
    inner : StreamHandler
        Snakemake's handler. It prints the records that this handler does not replace.
    progress : Progress
        State of the run.
    logs : str
        Folder of the logs.
    keep_going : bool, optional
        Whether jobs are still started after a failure.
    clock : callable, optional
        Returns seconds since the epoch.
    results : str, optional
        Folder of the results.
    show_failed_logs : bool, optional
        Whether Snakemake's block is also printed for a job whose log gives no reason.
    """

    def __init__(
        self,
        inner: logging.StreamHandler,
        progress: Progress,
        logs: str,
        keep_going: bool = False,
        clock: Callable[[], float] = time.time,
        results: str = "",
        show_failed_logs: bool = False,
    ):
        super().__init__()
        self.inner, self.progress, self.keep_going, self.clock = inner, progress, keep_going, clock
        self.show_failed_logs = show_failed_logs
        pages = (file for step in progress.steps.values() if step.rule == INDEX for file in step.files)
        self.status = StatusLines(inner.stream, progress, clock, start_page=next(pages, None))
        self.failed: dict[int, str] = {}
        self.pending: list[str] = []
        self.ended: dict[int, logging.LogRecord] = {}
        self.groups: dict[int, list[int]] = {}
        self.interrupted = self.finishing = False
        self.last_message = ""
        self.closed = threading.Event()
        self.handle(logging.makeLogRecord({"event": "began", "msg": "began", "results": results, "logs": logs}))

    def emit(self, record: logging.LogRecord) -> None:
        """Handle a record. An error in this handler must not end the run: Snakemake would cancel its jobs."""
        try:
            self._dispatch(record)
        except Exception:
            self.handleError(record)

    def start_timer(self) -> None:
        """Start a thread that prints progress while jobs run. It ends with `close` or with the program."""
        self._timer = threading.Thread(target=self._run_timer, name="progress", daemon=True)
        self._timer.start()

    def catch_signals(self) -> None:
        """Record Ctrl-C (ends running jobs) and SIGTERM (lets them finish), then call Snakemake's handler."""
        for number in (signal.SIGINT, signal.SIGTERM):
            handler = signal.getsignal(number)
            if callable(handler) and threading.current_thread() is threading.main_thread():
                signal.signal(number, partial(self._stop, handler))

    def _stop(self, handler, number, frame):
        # Print nothing here: the interrupted thread may be printing.
        if number == signal.SIGINT:
            self.interrupted = True
        else:
            self.finishing = True
        handler(number, frame)

    def close(self) -> None:
        """Close the handler and end its timer thread."""
        self.closed.set()
        self.inner.close()
        super().close()

    def _run_timer(self):
        # Sent as a record, so that the handler's lock prevents mixed lines.
        while not self.closed.wait(TIMER_SECONDS):
            self.handle(logging.makeLogRecord({"event": "time_passed", "msg": "progress"}))

    def _dispatch(self, record):
        event = getattr(record, "event", None)
        method = getattr(self, f"_{event}", None)
        if method is not None:
            method(record)
        elif event is None:
            self._without_event(record)
        elif str(event) not in SILENT_EVENTS:
            self.inner.handle(record)

    def _without_event(self, record):
        """Print a message unless it repeats the last one: Snakemake repeats some whenever a job ends."""
        text = str(record.msg)
        if not text.startswith(snakemake_messages.HIDDEN) and text != self.last_message:
            self.last_message = text
            self.inner.handle(record)

    def _began(self, record):
        self.status.begin(record.results, record.logs)

    def _time_passed(self, record):
        if self.progress.under_way and not self.closed.is_set():
            self._report()

    def _group_info(self, record):
        numbers = [job.jobid for job in record.jobs]
        self.groups |= dict.fromkeys(numbers, numbers)

    def _job_info(self, record):
        if record.jobid not in self.progress.steps:
            return
        self.progress.start(record.jobid, self.clock())
        if record.jobid in self.failed:  # a retry: print why the job failed before
            self._print_pending()
            del self.failed[record.jobid]
        self._report()

    def _job_finished(self, record):
        if record.job_id not in self.progress.steps:
            return
        self.progress.finish(record.job_id, self.clock())
        # No line between two jobs: the next one is about to start.
        if self.progress.under_way or len(self.progress.took) == len(self.progress.steps):
            self._report()

    def _report(self):
        ending = self.interrupted or self.finishing or (bool(self.failed) and not self.keep_going)
        self.status.report(len(self.failed), ending)

    def _job_error(self, record):
        # Indented records belong to a group, whose error is already handled.
        if not getattr(record, "indent", False):
            self._jobs_failed([vars(record)], [], record)

    def _group_error(self, record):
        self._jobs_failed(record.job_error_info, record.aux_logs, record)

    def _jobs_failed(self, jobs, more_logs, record):
        """Collect the reasons: from the logs, or else from how the script ended."""
        ended = self.ended.pop(record.thread, None)
        if self.interrupted:
            return
        for job in jobs:
            self.progress.fail(job["jobid"])
        lines = failures.from_logs(jobs, self.progress.began)
        if not lines:
            lines = failures.without_reason(jobs, more_logs, "" if ended is None else str(ended.msg))
            if self.show_failed_logs:
                for failure in filter(None, (ended, record)):
                    self.inner.handle(failure)
        self._add_failures(lines)

    def _add_failures(self, lines):
        """Keep the reasons for the summary at the end, and print them now if other jobs still run."""
        self.failed |= lines
        self.pending += lines.values()
        if self.progress.under_way or self.keep_going:
            self._print_pending()

    def _print_pending(self):
        lines, self.pending = self.pending, []
        for line in lines:
            self.status.write(line)

    def _error(self, record):
        """Handle an exception or the end of an incomplete run."""
        kind, text = getattr(record, "exception", ""), str(record.msg)
        if kind == "WorkflowError" and snakemake_messages.INCOMPLETE in text:
            self._ended(record)
        elif kind == "RuleException" and self.interrupted:
            pass  # a running job that was stopped
        elif kind == "RuleException" and snakemake_messages.ENDED_BY.search(text):
            # The next record of this thread is the failure of the job, and the log of the job may give the reason.
            self.ended[record.thread] = record
        else:
            self.inner.handle(record)
            missing = snakemake_messages.FILES_MISSING.search(text)
            step = self.progress.steps.get(int(missing[1])) if missing else None
            if step is not None:
                # Snakemake gives up the whole group without another record.
                for number in self.groups.get(step.number, [step.number]):
                    self.progress.fail(number)
                self._add_failures(failures.without_files(step))

    def _ended(self, record):
        for unexplained in self.ended.values():
            self.inner.handle(unexplained)
        if self.failed:
            self.status.write(self.status.counts(len(self.failed)))
            self.inner.stream.write("".join(f"{line}\n" for line in failures.at_end(list(self.failed.values()))))
            self.inner.stream.flush()
        elif self.interrupted or self.finishing:
            self.status.write("Stopped. Finished files are kept; run the same command again to continue.")
        else:
            self.inner.handle(record)


def install_console(
    logger: logging.Logger,
    steps: Iterable[Step],
    cores: int | None,
    expected,
    logs: str | Path,
    keep_going: bool,
    results: str = "",
    show_failed_logs: bool = False,
) -> None:
    """Replace the terminal handlers of Snakemake's logger by a `Console`. Handlers of logger plugins stay.

    Parameters
    ----------
    logger : Logger
        Snakemake's logger.
    steps, cores, expected
        See `Progress`.
    logs, keep_going, results, show_failed_logs
        See `Console`.
    """
    for handler in terminal_handlers(logger):
        inner = handler.inner if isinstance(handler, StartupHandler) else handler
        progress = Progress(steps, cores, expected, time.time(), slowdown(cores))
        console = Console(inner, progress, str(logs), keep_going, results=results, show_failed_logs=show_failed_logs)
        logger.removeHandler(handler)
        logger.addHandler(console)
        console.catch_signals()
        console.start_timer()
