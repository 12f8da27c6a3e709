"""Jobs that are to be done, are under way and are done, and how long the rest may take."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from .said import Said, heard

# Rules of one kind differ by a number, or by the seeds of a batch.
NUMBERED = re.compile(r"_\d+$|_seeds_\d+_to_\d+$")


def stage_of(rule: str) -> str:
    """What users know a rule as: figures are one stage, and so are rules that differ by a number."""
    return "figures" if rule.startswith("figure_") else NUMBERED.sub("", rule)


@dataclass(frozen=True)
class Step:
    """One job.

    Attributes
    ----------
    number : int
        What Snakemake calls it.
    rule : str
    files : tuple of str
        What it makes.
    threads : int
        Cores that it takes.
    needs : tuple of int
        Numbers of the jobs that it waits for.
    log : str, optional
        Beside which it says how far it is.
    """

    number: int
    rule: str
    files: tuple[str, ...]
    threads: int = 1
    needs: tuple[int, ...] = ()
    log: str | None = None

    @property
    def stage(self) -> str:
        """What users know its rule as."""
        return stage_of(self.rule)


class Progress:
    """How far a run is.

    Parameters
    ----------
    steps : iterable of Step
        Its jobs.
    cores : int or None
        How many it may use at a time; None where that is not known, as on a cluster.
    expected : callable
        Gives {file: seconds of one core that its job takes}, of jobs with a measured rate; called once at most.
    began : float
        When the run began, s.

    Attributes
    ----------
    steps : dict of int to Step
        By number.
    under_way : dict of int to float
        When each of these jobs was started, s.
    took : dict of int to float
        Of each job that is done, s times the cores that it took.
    failed : set of int
        Jobs that have failed and are not under way again.
    """

    def __init__(
        self, steps: Iterable[Step], cores: int | None, expected: Callable[[], dict[str, float]], began: float
    ):
        self.steps = {step.number: step for step in steps}
        self.cores, self.began = cores, began
        self.under_way: dict[int, float] = {}
        self.took: dict[int, float] = {}
        self.failed: set[int] = set()
        self._expected = expected
        self._rates: dict[str, float] | None = None

    def start(self, number: int, now: float) -> None:
        """A job has been started, for another time perhaps."""
        if number in self.steps:
            self.under_way[number] = now
            self.failed.discard(number)

    def finish(self, number: int, now: float) -> None:
        """A job is done."""
        if number in self.steps and number not in self.took:
            self.took[number] = (now - self.under_way.pop(number, now)) * self.steps[number].threads

    def fail(self, number: int) -> None:
        """A job is no longer under way, and not done."""
        self.under_way.pop(number, None)
        if number in self.steps:
            self.failed.add(number)

    def lost(self) -> set[int]:
        """Jobs that failed, and those that wait for them in vain."""
        lost: set[int] = set()
        found = set(self.failed)
        while found:
            lost |= found
            found = {n for n, step in self.steps.items() if n not in lost and not lost.isdisjoint(step.needs)}
        return lost

    def stages(self) -> list[tuple[str, int, int]]:
        """(stage, jobs done, jobs) of the stages that are under way, in the order in which they began."""
        done = Counter(self.steps[number].stage for number in self.took)
        jobs = Counter(step.stage for step in self.steps.values())
        now = dict.fromkeys(self.steps[number].stage for number in self.under_way)
        return [(stage, done[stage], jobs[stage]) for stage in now]

    def said(self) -> dict[int, Said]:
        """What jobs that are under way say of how far they are, in the order in which they began."""
        logs = ((number, self.steps[number].log, since) for number, since in self.under_way.items())
        heard_of = ((number, heard(log, since)) for number, log, since in logs if log is not None)
        return {number: said for number, said in heard_of if said is not None}

    def seconds_left(self, now: float) -> tuple[float, bool]:
        """How long it takes until all is done that can be.

        A job takes its expected time, times what the finished jobs of its stage took more than was expected of them,
        or longer if it says so; one that nothing is expected of takes their mean, and is left out where there are none.
        The rest is shared among the cores, and no job is split.

        Parameters
        ----------
        now : float
            s.

        Returns
        -------
        seconds : float
        complete : bool
            Whether all jobs are in them.
        """
        ratios, lost, said = self._ratios(), self.lost(), self.said()
        seconds, longest, complete = 0.0, 0.0, True
        for number, step in self.steps.items():
            if number in self.took or number in lost or not step.files:
                continue
            expected = self._seconds_expected(step)
            ratio = ratios.get((step.stage, expected is None), None if expected is None else 1.0)
            least = (said[number].seconds_left or 0.0) * step.threads if number in said else 0.0
            complete &= ratio is not None
            whole = 0.0 if ratio is None else ratio * (1.0 if expected is None else expected)
            spent = (now - self.under_way[number]) * step.threads if number in self.under_way else 0.0
            left = max(whole - spent, least)
            seconds += left
            longest = max(longest, left / step.threads)
        return max(seconds / self._at_a_time(now), longest), complete

    def _seconds_expected(self, step):
        if self._rates is None:
            self._rates = {}  # if there are none to be had, that is said once
            self._rates = self._expected()
        return next((self._rates[file] for file in step.files if file in self._rates), None)

    def _ratios(self):
        """What finished jobs took: {(stage, False): core-seconds per second expected}, {(stage, True): the mean, s}."""
        taken, work = Counter(), Counter()
        for number, took in self.took.items():
            expected = self._seconds_expected(self.steps[number])
            key = (self.steps[number].stage, expected is None)
            taken[key] += took
            work[key] += 1.0 if expected is None else expected
        return {key: taken[key] / work[key] for key in taken if work[key]}

    def _at_a_time(self, now):
        """Cores at work: as many as there are, or as have been at work on average."""
        if self.cores is not None:
            return self.cores
        busy = sum(self.took.values())
        busy += sum((now - since) * self.steps[number].threads for number, since in self.under_way.items())
        return max(busy / max(now - self.began, 1e-9), 1.0)
