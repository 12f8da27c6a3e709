"""Lines that say how far a run is, few of them."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TextIO

from ...base.names import counted
from .time_left import Progress

# Each line after the first comes this long after the one before it, or a thirtieth of the time since the start: the
# longer a run, the rarer, so that hours have no more than hundreds of lines.
SECONDS_BETWEEN = 10.0
SHARE_BETWEEN = 1 / 30
# Slowdown by other work from which on the first line mentions it: half of the error that forecasts have anyway.
NOTICED = 1.3
# Round numbers of (s, number, unit).
ROUND = [
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
MOST_SAID = 3  # jobs whose own words are in a line: more would fill the terminal


class Status:
    """Writes lines that begin with the time.

    Parameters
    ----------
    stream : TextIO
        Where to.
    progress : Progress
        The run.
    clock : callable
        Gives seconds since the epoch.
    start : str, optional
        The page to start with, said once all is done.
    """

    def __init__(self, stream: TextIO, progress: Progress, clock: Callable[[], float], start: str | None = None):
        self.stream, self.progress, self.clock, self.start = stream, progress, clock, start
        self.said: float | None = None

    def begin(self, results: str, logs: str) -> None:
        """Say what is going to run.

        Parameters
        ----------
        results, logs : str
            Folders.
        """
        progress, time = self.progress, ""
        try:
            time = duration_range(*progress.range_left(self.clock()))
        finally:  # whatever is wrong with forecasts, the run begins
            self.write(self._first(time, results, logs))

    def _first(self, time: str, results: str, logs: str) -> str:
        progress = self.progress
        cores = "" if progress.cores is None else f" on {counted(progress.cores, 'core')}"
        other = ", beside the other work of this machine" if time and progress.load >= NOTICED else ""
        folders = f"Results: {results}; logs: {logs}" if results else f"Logs: {logs}"
        return f"Jobs to do: {len(progress.steps)}{f', {time}{cores}{other}' if time else ''}. {folders}"

    def say(self, failed: int, ending: bool) -> None:
        """Say how far it is, if it has not just been said.

        Parameters
        ----------
        failed : int
            Failures so far.
        ending : bool
            No more jobs are started.
        """
        progress, now = self.progress, self.clock()
        between = max(SECONDS_BETWEEN, SHARE_BETWEEN * (now - progress.began))
        if len(progress.took) == len(progress.steps):
            rest = f" in {duration(now - progress.began)}" + (f". Start with {self.start}" if self.start else "")
        elif self.said is not None and now - self.said < between:
            return
        else:
            left = "" if self.said is None else time_left(*progress.range_left(now))
            stages = ", ".join(f"{stage} ({some} of {all_} done)" for stage, some, all_ in progress.stages())
            said = "".join(f"; {one}" for one in [*progress.said().values()][:MOST_SAID])
            rest = f"{'; no more are started' if ending else left}{'; now: ' if stages else ''}{stages}{said}"
        self.said = now
        self.write(self.counts(failed) + rest)

    def counts(self, failed: int) -> str:
        """Jobs done and failed."""
        done = f"{len(self.progress.took)} of {len(self.progress.steps)} jobs done"
        return f"{done}, {failed} failed" if failed else done

    def write(self, text: str) -> None:
        """Any line."""
        stamp = time.strftime("%H:%M:%S ", time.localtime(self.clock()))
        self.stream.write(f"{stamp}{text}\n")
        self.stream.flush()


def time_left(low: float, high: float, complete: bool) -> str:
    """An estimate in words; nothing where there is none."""
    words = duration_range(low, high, complete)
    return f", {words} left" if words else ""


def duration(seconds: float) -> str:
    """Time to the precision that one needs to plan with."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 90 * 60 else f"{seconds / 3600:.1f} h"


def duration_range(low: float, high: float, complete: bool = True) -> str:
    """A range of time in round numbers, no more precise than what is known.

    Parameters
    ----------
    low, high : float
        s.
    complete : bool, optional
        Whether the time of everything is in it; otherwise there is no upper end.

    Returns
    -------
    str
        "2 to 5 min", "40 s to 2 min", "under 5 s", "over 2 min"; empty where nothing is known.
    """
    if high < 0.5:
        return ""
    least, most = (max((one for one in ROUND if one[0] <= low), default=None), _at_least(high))
    if not complete:
        return f"over {least[1]} {least[2]}" if least else ""
    if least is None:
        return f"under {most[1]} {most[2]}"
    if least == most:
        return f"about {most[1]} {most[2]}"
    unit = "" if least[2] == most[2] else f" {least[2]}"
    return f"{least[1]}{unit} to {most[1]} {most[2]}"


def _at_least(seconds):
    return next((one for one in ROUND if one[0] >= seconds), ROUND[-1])
