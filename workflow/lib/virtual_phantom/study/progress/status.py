"""Lines that say how far a run is, few of them."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TextIO

from .time_left import Progress

# Each line after the first comes this long after the one before it, or a thirtieth of the time since the start: the
# longer a run, the rarer, so that hours have no more than hundreds of lines.
SECONDS_BETWEEN = 10.0
SHARE_BETWEEN = 1 / 30
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
            left = "" if self.said is None else time_left(*progress.seconds_left(now))
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


def time_left(seconds: float, complete: bool) -> str:
    """An estimate in words; nothing where there is none, or where jobs have had all the time that was expected."""
    if seconds < 0.5:
        return ""
    return f", {'about' if complete else 'more than'} {duration(seconds)} left"


def duration(seconds: float) -> str:
    """Time to the precision that one needs to plan with."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 90 * 60 else f"{seconds / 3600:.1f} h"
