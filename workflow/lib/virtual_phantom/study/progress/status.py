"""Progress lines of a run, with the estimated time left."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TextIO

from ...base.names import counted
from .time_left import Progress

# Time between two lines: 10 s, or 1/30 of the time since the start if that is longer. A run of hours then prints no
# more than a few hundred lines.
SECONDS_BETWEEN = 10.0
SHARE_BETWEEN = 1 / 30
# The first line mentions other work on the machine from this slowdown on: half of the usual error of forecasts.
NOTICED = 1.3
# Durations in round numbers: (s, number, unit).
ROUND_DURATIONS = [
    *((number, f"{number}", "s") for number in (5, 8, 10, 12, 15, 20, 25, 30, 40, 50)),
    *(
        (60 * number, f"{number:g}", "min")
        for number in (1, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10, 12, 15, 20, 25, 30, 40, 50)
    ),
    *((3600 * number, f"{number:g}", "h") for number in (1, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10, 12, 15, 20, 25, 30, 36)),
    *(
        (86400 * number, f"{number}", "days")
        for number in (2, 3, 4, 5, 6, 8, 10, 12, 15, 20, 30, 50, 100, 200, 500, 1000)
    ),
]
STATUSES_SHOWN = 3  # jobs whose own status is in a line: more would fill the terminal


class StatusLines:
    """Writer of progress lines, each with the time of day.

    Parameters
    ----------
    stream : TextIO
        Stream to write to.
    progress : Progress
        State of the run.
    clock : callable
        Returns seconds since the epoch.
    start_page : str, optional
        Page that the last line recommends to open first.
    """

    def __init__(self, stream: TextIO, progress: Progress, clock: Callable[[], float], start_page: str | None = None):
        self.stream, self.progress, self.clock, self.start_page = stream, progress, clock, start_page
        self.last_report: float | None = None

    def begin(self, results: str, logs: str) -> None:
        """Write the first line: jobs, expected time, folders of results and logs."""
        progress, time = self.progress, ""
        try:
            time = duration_range(*progress.range_left(self.clock()))
        finally:  # an error of the forecast must not keep the run from starting
            self.write(self._first(time, results, logs))

    def _first(self, time: str, results: str, logs: str) -> str:
        progress = self.progress
        cores = "" if progress.cores is None else f" on {counted(progress.cores, 'core')}"
        other = ", including the slowdown by other work on this machine" if time and progress.load >= NOTICED else ""
        folders = f"Results: {results}; logs: {logs}" if results else f"Logs: {logs}"
        return f"Jobs to do: {len(progress.steps)}{f', {time}{cores}{other}' if time else ''}. {folders}"

    def report(self, failed: int, ending: bool) -> None:
        """Write a progress line if one is due, given the failures so far and whether no more jobs are started."""
        progress, now = self.progress, self.clock()
        between = max(SECONDS_BETWEEN, SHARE_BETWEEN * (now - progress.began))
        if len(progress.took) == len(progress.steps):
            page = f". Start with {self.start_page}" if self.start_page else ""
            rest = f" in {duration(now - progress.began)}{page}"
        elif self.last_report is not None and now - self.last_report < between:
            return
        else:
            left = "" if self.last_report is None else time_left(*progress.range_left(now))
            stages = ", ".join(f"{stage} ({done} of {jobs} done)" for stage, done, jobs in progress.stages())
            statuses = "".join(f"; {status}" for status in [*progress.job_statuses().values()][:STATUSES_SHOWN])
            rest = f"{'; no more are started' if ending else left}{'; now: ' if stages else ''}{stages}{statuses}"
        self.last_report = now
        self.write(self.counts(failed) + rest)

    def counts(self, failed: int) -> str:
        """Return the numbers of finished and failed jobs in words."""
        done = f"{len(self.progress.took)} of {len(self.progress.steps)} jobs done"
        return f"{done}, {failed} failed" if failed else done

    def write(self, text: str) -> None:
        """Write a line with the time of day."""
        stamp = time.strftime("%H:%M:%S ", time.localtime(self.clock()))
        self.stream.write(f"{stamp}{text}\n")
        self.stream.flush()


def time_left(low: float, high: float, complete: bool) -> str:
    """Return an estimate in words; "" if there is none."""
    words = duration_range(low, high, complete)
    return f", {words} left" if words else ""


def duration(seconds: float) -> str:
    """Return a time with a unit, with about two digits."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 90 * 60 else f"{seconds / 3600:.1f} h"


def duration_range(low: float, high: float, complete: bool = True) -> str:
    """Return a range of time in round numbers.

    Parameters
    ----------
    low, high : float
        s.
    complete : bool, optional
        Whether the range includes every job; otherwise it has no upper end.

    Returns
    -------
    str
        "2 to 5 min", "40 s to 2 min", "under 5 s", "over 2 min"; "" if nothing is known.
    """
    if high < 0.5:
        return ""
    least = max((duration for duration in ROUND_DURATIONS if duration[0] <= low), default=None)
    most = next((duration for duration in ROUND_DURATIONS if duration[0] >= high), ROUND_DURATIONS[-1])
    if not complete:
        return f"over {least[1]} {least[2]}" if least else ""
    if least is None:
        return f"under {most[1]} {most[2]}"
    if least == most:
        return f"about {most[1]} {most[2]}"
    unit = "" if least[2] == most[2] else f" {least[2]}"
    return f"{least[1]}{unit} to {most[1]} {most[2]}"
