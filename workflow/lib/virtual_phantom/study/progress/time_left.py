"""Jobs that are to be done, are under way and are done, and how long the rest may take."""

from __future__ import annotations

import math
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from statistics import NormalDist

from .said import Said, heard

# Rules of one kind differ by a number, or by the seeds of a batch.
NUMBERED = re.compile(r"_\d+$|_seeds_\d+_to_\d+$")

# Time taken over time expected is lognormal. Its median before any job is done, beside other work on the machine, and
# the standard deviations of its logarithm: for a whole run (another processor), for a stage within a run, for a job
# within its stage, and the least (other work begins and ends). Studies took 0.8 to 2.4 times what was expected
# (docs/how-to/cluster.md).
SLOWER, RUN_SD, STAGE_SD, JOB_SD, LEAST_SD = 1.3, 0.5, 0.3, 0.4, 0.15
# A range contains the middle 80 percent.
TAIL = 0.1
NORMAL = NormalDist()
WIDE = NORMAL.inv_cdf(1 - TAIL)
# Seconds that are expected, or a range of them.
Seconds = float | tuple[float, float]


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
        Gives {file: seconds of one core that its job takes, or the lower and upper end of them}, of jobs with a
        measured rate; called once at most.
    began : float
        When the run began, s.
    load : float, optional
        How many times slower other work makes this run, as load.slowdown gives it.

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
        self,
        steps: Iterable[Step],
        cores: int | None,
        expected: Callable[[], Mapping[str, Seconds]],
        began: float,
        load: float = 1.0,
    ):
        self.steps = {step.number: step for step in steps}
        self.cores, self.began, self.load = cores, began, load
        self.under_way: dict[int, float] = {}
        self.took: dict[int, float] = {}
        self.failed: set[int] = set()
        self._expected = expected
        self._rates: Mapping[str, Seconds] | None = None
        self._logs: dict[int, tuple[float, float] | None] = {}
        self._done, self._new = Paces(load), list[int]()

    def start(self, number: int, now: float) -> None:
        """A job has been started, for another time perhaps."""
        if number in self.steps:
            self.under_way[number] = now
            self.failed.discard(number)

    def finish(self, number: int, now: float) -> None:
        """A job is done."""
        if number in self.steps and number not in self.took:
            self.took[number] = (now - self.under_way.pop(number, now)) * self.steps[number].threads
            self._new.append(number)

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

    def range_left(self, now: float) -> tuple[float, float, bool]:
        """How long it takes until all is done that can be.

        A job takes its expected time, times what finished jobs of this run took more than was expected of them: of its
        stage as far as there are such jobs, or else of the run. One without an expected time takes the mean of its
        stage, and is left out where there is none. The range is as wide as is known from these jobs, and narrows as
        more are done. A job under way is past the time that it has had, or reports its remaining time.

        Parameters
        ----------
        now : float
            s.

        Returns
        -------
        low, high : float
            s: with the cores always at work, and by Graham's bound of any schedule (SIAM J. Appl. Math. 17, 416, 1969).
        complete : bool
            Whether all jobs are in them.
        """
        paces, lost, said = self._paces(now), self.lost(), self.said()
        ends: dict[int, tuple[float, float]] = {}
        alike: dict[tuple, tuple[float, float]] = {}  # jobs that have not begun, of one stage and size
        work, complete = [0.0, 0.0], True
        for number, step in self.steps.items():
            if number in self.took or number in lost or not step.files:
                continue
            expected = self._expected_log(step)
            kind = (step.stage, expected, step.threads)
            if number in self.under_way or kind not in alike:
                spent = now - self.under_way[number] if number in self.under_way else 0.0
                pace = paces.of(step.stage, expected)
                complete &= pace is not None
                left = _left(pace, spent, step.threads, said.get(number))
                if number not in self.under_way:
                    alike[kind] = left
            else:
                left = alike[kind]
            ends[number] = left
            for place, seconds in enumerate(left):
                work[place] += seconds * step.threads
        at_a_time = self._at_a_time(now)
        low = self._longest({number: left[0] for number, left in ends.items()})
        # While a job of the longest chain runs, other cores may have none.
        idle = {number: max(1 - self.steps[number].threads / at_a_time, 0.0) for number in ends}
        high = self._longest({number: left[1] * idle[number] for number, left in ends.items()})
        return max(work[0] / at_a_time, low), work[1] / at_a_time + high, complete

    def _longest(self, seconds: Mapping[int, float]) -> float:
        """The longest chain of jobs that wait for each other, s."""
        until: dict[int, float] = {}
        for first in seconds:
            waiting = [first]
            while waiting:
                number = waiting[-1]
                before = [need for need in self.steps[number].needs if need in seconds]
                missing = [need for need in before if need not in until]
                if missing:
                    waiting += missing
                    continue
                until[waiting.pop()] = seconds[number] + max((until[need] for need in before), default=0.0)
        return max(until.values(), default=0.0)

    def _expected_log(self, step: Step) -> tuple[float, float] | None:
        """Median and standard deviation of what is expected, of the logarithm; None without a rate."""
        if self._rates is None:
            self._rates = {}  # if there are none to be had, that is said once
            self._rates = self._expected()
        if step.number not in self._logs:
            self._logs[step.number] = self._log(step)
        return self._logs[step.number]

    def _log(self, step: Step) -> tuple[float, float] | None:
        found = next((self._rates[file] for file in step.files if file in self._rates), None)
        if found is None:
            return None
        low, high = found if isinstance(found, tuple) else (found, found)
        if low <= 0:
            return None
        return (math.log(low) + math.log(high)) / 2, (math.log(high) - math.log(low)) / (2 * WIDE)

    def _paces(self, now: float) -> Paces:
        while self._new:
            step = self.steps[self._new.pop()]
            self._done.add(step.stage, self._expected_log(step), self.took[step.number])
        paces = self._done.copy()
        for number, since in self.under_way.items():
            step = self.steps[number]
            expected, spent = self._expected_log(step), (now - since) * step.threads
            # A job of known size that takes longer tells already that this run is slower.
            if expected is not None and not expected[1] and spent > math.exp(expected[0]):
                paces.add(step.stage, expected, spent)
        return paces

    def _at_a_time(self, now):
        """Cores at work: as many as there are, or as have been at work on average."""
        if self.cores is not None:
            return self.cores
        busy = sum(self.took.values())
        busy += sum((now - since) * self.steps[number].threads for number, since in self.under_way.items())
        return max(busy / max(now - self.began, 1e-9), 1.0)


@dataclass
class Taken:
    """Finished jobs of a stage: seconds taken, seconds expected (1 of a job without a rate), and their squares."""

    took: float = 0.0
    expected: float = 0.0
    squares: float = 0.0

    def add(self, took: float, expected: float) -> None:
        """One more."""
        self.took, self.expected, self.squares = (
            self.took + took,
            self.expected + expected,
            self.squares + expected**2,
        )

    @property
    def log_ratio(self) -> float:
        """Logarithm of what they took over what was expected."""
        return math.log(max(self.took, 1e-3) / self.expected)

    @property
    def variance(self) -> float:
        """Of that: long jobs count most."""
        return JOB_SD**2 * self.squares / self.expected**2


@dataclass
class Paces:
    """What jobs of this run took, over what was expected of them.

    Attributes
    ----------
    load : float
        How many times slower other work makes the run, before any job is done.
    """

    load: float
    _stages: dict[tuple[str, bool], Taken] = field(default_factory=lambda: defaultdict(Taken))

    def add(self, stage: str, expected: tuple[float, float] | None, took: float) -> None:
        """A job is done.

        Parameters
        ----------
        expected : tuple of 2 float or None
            As `of` takes it.
        took : float
            s of one core.
        """
        self._stages[stage, expected is None].add(took, 1.0 if expected is None else math.exp(expected[0]))

    def copy(self) -> Paces:
        """One to which further jobs are added."""
        return Paces(self.load, defaultdict(Taken, {key: replace(taken) for key, taken in self._stages.items()}))

    def of(self, stage: str, expected: tuple[float, float] | None) -> tuple[float, float] | None:
        """What a job takes.

        Parameters
        ----------
        expected : tuple of 2 float or None
            Median and standard deviation of the logarithm of the seconds that are expected; None without a rate.

        Returns
        -------
        tuple of 2 float or None
            The same of what the job takes; None where nothing is known.
        """
        own = self._stages.get((stage, expected is None))
        if expected is None:
            return None if own is None else (own.log_ratio, math.sqrt(own.variance + LEAST_SD**2))
        mean, variance = self._run()
        variance += STAGE_SD**2
        if own is not None:
            mean, variance = _both(mean, variance, own.log_ratio, own.variance)
        return expected[0] + mean, math.sqrt(max(variance, LEAST_SD**2) + expected[1] ** 2)

    def _run(self) -> tuple[float, float]:
        """Of the run: what is known before it, then what its stages took."""
        mean, variance = math.log(SLOWER * self.load), RUN_SD**2
        for (_, without), taken in self._stages.items():
            if not without:
                mean, variance = _both(mean, variance, taken.log_ratio, taken.variance + STAGE_SD**2)
        return mean, variance


def _both(mean: float, variance: float, other: float, its_variance: float) -> tuple[float, float]:
    """Two estimates of one number as one."""
    weight = variance / (variance + its_variance)
    return mean + weight * (other - mean), variance * (1 - weight)


def _left(pace: tuple[float, float] | None, spent: float, threads: int, said: Said | None) -> tuple[float, float]:
    """Remaining wall time of a job, s.

    Parameters
    ----------
    pace : tuple of 2 float or None
        Median and standard deviation of the logarithm of its seconds of one core.
    spent : float
        Wall time since its start, s.
    """
    low, high = 0.0, 0.0
    if pace is not None:
        median, sd = pace[0] - math.log(threads), pace[1]
        # Of jobs that took longer than this one has had.
        longer = NORMAL.cdf((median - math.log(spent)) / sd) if spent > 0 else 1.0
        if longer > 1e-9:
            low, high = (
                math.exp(median - sd * NORMAL.inv_cdf(longer * (1 - share))) - spent for share in (TAIL, 1 - TAIL)
            )
        else:
            high = spent
    if said is not None and said.seconds_left is not None:
        low, high = said.seconds_left, max(high, 2 * said.seconds_left)
    if said is not None and said.most_left is not None:
        low = said.seconds_left or 0.0
        high = max(said.most_left, low)
    return max(low, 0.0), max(high, 0.0)
