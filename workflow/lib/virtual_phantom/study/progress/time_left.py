"""State of the jobs of a run, and an estimate of the time left."""

from __future__ import annotations

import math
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from statistics import NormalDist

from .job_status import JobStatus, read_status

# Rules of one stage differ by a number.
NUMBERED = re.compile(r"_\d+$")

# The ratio of actual to expected time is lognormal. SLOWER is its median before any job is done, without the slowdown
# by other work. RUN_SD, STAGE_SD and JOB_SD are standard deviations of its logarithm: between runs, between stages of a
# run, and between jobs of a stage. LEAST_SD is their minimum. Measured studies took 0.8 to 2.4 times the expected time
# (docs/how-to/cluster.md).
SLOWER, RUN_SD, STAGE_SD, JOB_SD, LEAST_SD = 1.3, 0.5, 0.3, 0.4, 0.15
# Ranges contain the central 80 %.
TAIL = 0.1
NORMAL = NormalDist()
WIDE = NORMAL.inv_cdf(1 - TAIL)
# Expected seconds, or a range.
Seconds = float | tuple[float, float]


def stage_of(rule: str) -> str:
    """Return the stage of a rule. All figures are one stage, and so are rules that differ by a number."""
    return "figures" if rule.startswith("figure_") else NUMBERED.sub("", rule)


@dataclass(frozen=True)
class Step:
    """One job.

    Attributes
    ----------
    number : int
        Snakemake's number of the job.
    files : tuple of str
        Output files.
    threads : int
        Cores that the job uses.
    needs : tuple of int
        Numbers of the jobs that must finish first.
    log : str, optional
        Log of the job, next to which it may write its status.
    """

    number: int
    rule: str
    files: tuple[str, ...]
    threads: int = 1
    needs: tuple[int, ...] = ()
    log: str | None = None

    @property
    def stage(self) -> str:
        """Stage of the rule."""
        return stage_of(self.rule)


class Progress:
    """Jobs of a run that are waiting, running, finished or failed.

    Parameters
    ----------
    steps : iterable of Step
        Jobs of the run.
    cores : int or None
        Cores that the run may use; None if unknown, as on a cluster.
    expected : callable
        Returns {file: core seconds of its job, or their lower and upper end} for jobs with a measured rate. It is
        called at most once.
    began : float
        Start of the run, s.
    load : float, optional
        Slowdown by other work on the machine, see load.slowdown.

    Attributes
    ----------
    steps : dict of int to Step
        Jobs by number.
    under_way : dict of int to float
        Start of each running job, s.
    took : dict of int to float
        Core seconds of each finished job.
    failed : set of int
        Jobs that failed and are not running again.
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
        """Record the start of a job, or of its retry."""
        if number in self.steps:
            self.under_way[number] = now
            self.failed.discard(number)

    def finish(self, number: int, now: float) -> None:
        """Record the end of a job."""
        if number in self.steps and number not in self.took:
            self.took[number] = (now - self.under_way.pop(number, now)) * self.steps[number].threads
            self._new.append(number)

    def fail(self, number: int) -> None:
        """Record the failure of a job."""
        self.under_way.pop(number, None)
        if number in self.steps:
            self.failed.add(number)

    def lost(self) -> set[int]:
        """Return the jobs that failed and the jobs that depend on them."""
        lost: set[int] = set()
        found = set(self.failed)
        while found:
            lost |= found
            found = {n for n, step in self.steps.items() if n not in lost and not lost.isdisjoint(step.needs)}
        return lost

    def stages(self) -> list[tuple[str, int, int]]:
        """Return (stage, finished jobs, all jobs) for each running stage, in order of start."""
        done = Counter(self.steps[number].stage for number in self.took)
        jobs = Counter(step.stage for step in self.steps.values())
        now = dict.fromkeys(self.steps[number].stage for number in self.under_way)
        return [(stage, done[stage], jobs[stage]) for stage in now]

    def job_statuses(self) -> dict[int, JobStatus]:
        """Return the statuses that running jobs have written, in order of start."""
        logs = ((number, self.steps[number].log, since) for number, since in self.under_way.items())
        statuses = ((number, read_status(log, since)) for number, log, since in logs if log is not None)
        return {number: status for number, status in statuses if status is not None}

    def range_left(self, now: float) -> tuple[float, float, bool]:
        """Estimate the time until all jobs are done that can still be done.

        The estimate of a job is its expected time, scaled by the ratio of actual to expected time of the finished jobs
        of its stage, or of the run. A job without an expected time takes the mean of its stage. Running jobs are
        conditioned on the time that they have already taken, or report their remaining time themselves.

        Parameters
        ----------
        now : float
            s.

        Returns
        -------
        low, high : float
            s. The lower bound assumes that all cores are always busy. The upper bound is Graham's bound, which holds
            for every schedule (SIAM J. Appl. Math. 17, 416, 1969).
        complete : bool
            Whether the estimate includes all jobs.
        """
        paces, lost, statuses = self._paces(now), self.lost(), self.job_statuses()
        ends: dict[int, tuple[float, float]] = {}
        alike: dict[tuple, tuple[float, float]] = {}  # waiting jobs, by stage, expected time and threads
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
                left = _left(pace, spent, step.threads, statuses.get(number))
                if number not in self.under_way:
                    alike[kind] = left
            else:
                left = alike[kind]
            ends[number] = left
            for end, seconds in enumerate(left):
                work[end] += seconds * step.threads
        at_a_time = self._at_a_time(now)
        low = self._longest({number: left[0] for number, left in ends.items()})
        # While a job of the longest chain runs, the other cores may be idle.
        idle = {number: max(1 - self.steps[number].threads / at_a_time, 0.0) for number in ends}
        high = self._longest({number: left[1] * idle[number] for number, left in ends.items()})
        return max(work[0] / at_a_time, low), work[1] / at_a_time + high, complete

    def _longest(self, seconds: Mapping[int, float]) -> float:
        """Return the duration of the longest chain of dependent jobs, s."""
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
        """Return median and standard deviation of the logarithm of the expected core seconds; None without a rate."""
        if self._rates is None:
            self._rates = {}  # if the call fails, the error is reported once
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
            # A running job that exceeds its expected time already shows that this run is slower.
            if expected is not None and not expected[1] and spent > math.exp(expected[0]):
                paces.add(step.stage, expected, spent)
        return paces

    def _at_a_time(self, now):
        """Return the cores of the run, or the mean number of busy cores if these are unknown."""
        if self.cores is not None:
            return self.cores
        busy = sum(self.took.values())
        busy += sum((now - since) * self.steps[number].threads for number, since in self.under_way.items())
        return max(busy / max(now - self.began, 1e-9), 1.0)


@dataclass
class Taken:
    """Sums over finished jobs of a stage: actual and expected core seconds (1 without a rate), squared expectation."""

    took: float = 0.0
    expected: float = 0.0
    squares: float = 0.0

    def add(self, took: float, expected: float) -> None:
        """Add a job."""
        self.took += took
        self.expected += expected
        self.squares += expected**2

    @property
    def log_ratio(self) -> float:
        """Logarithm of the ratio of actual to expected time."""
        return math.log(max(self.took, 1e-3) / self.expected)

    @property
    def variance(self) -> float:
        """Variance of `log_ratio`, with jobs weighted by their expected time."""
        return JOB_SD**2 * self.squares / self.expected**2


@dataclass
class Paces:
    """Ratios of actual to expected time in this run.

    Attributes
    ----------
    load : float
        Slowdown by other work before any job is done.
    """

    load: float
    _stages: dict[tuple[str, bool], Taken] = field(default_factory=lambda: defaultdict(Taken))

    def add(self, stage: str, expected: tuple[float, float] | None, took: float) -> None:
        """Add a finished job: its expectation as in `of`, and its core seconds."""
        self._stages[stage, expected is None].add(took, 1.0 if expected is None else math.exp(expected[0]))

    def copy(self) -> Paces:
        """Return a copy to which jobs can be added."""
        return Paces(self.load, defaultdict(Taken, {key: replace(taken) for key, taken in self._stages.items()}))

    def of(self, stage: str, expected: tuple[float, float] | None) -> tuple[float, float] | None:
        """Predict the core seconds of a job from the expected ones; None if nothing is known.

        Both are median and standard deviation of the logarithm. The expectation is None without a rate.
        """
        taken = self._stages.get((stage, expected is None))
        if expected is None:
            return None if taken is None else (taken.log_ratio, math.sqrt(taken.variance + LEAST_SD**2))
        mean, variance = self._run()
        variance += STAGE_SD**2
        if taken is not None:
            mean, variance = _combined(mean, variance, taken.log_ratio, taken.variance)
        return expected[0] + mean, math.sqrt(max(variance, LEAST_SD**2) + expected[1] ** 2)

    def _run(self) -> tuple[float, float]:
        """Return mean and variance of the log ratio of the run: the prior, updated by each stage."""
        mean, variance = math.log(SLOWER * self.load), RUN_SD**2
        for (_, without_rate), taken in self._stages.items():
            if not without_rate:
                mean, variance = _combined(mean, variance, taken.log_ratio, taken.variance + STAGE_SD**2)
        return mean, variance


def _combined(mean: float, variance: float, other: float, other_variance: float) -> tuple[float, float]:
    """Return the inverse-variance weighted mean of two estimates, and its variance."""
    weight = variance / (variance + other_variance)
    return mean + weight * (other - mean), variance * (1 - weight)


def _left(
    pace: tuple[float, float] | None, spent: float, threads: int, status: JobStatus | None
) -> tuple[float, float]:
    """Return a range of the remaining wall time of a job, s, from its predicted core seconds and the time spent."""
    low, high = 0.0, 0.0
    if pace is not None:
        median, sd = pace[0] - math.log(threads), pace[1]
        # Share of jobs that take longer than the time already spent: the estimate is conditioned on it.
        longer = NORMAL.cdf((median - math.log(spent)) / sd) if spent > 0 else 1.0
        if longer > 1e-9:
            low, high = (
                math.exp(median - sd * NORMAL.inv_cdf(longer * (1 - share))) - spent for share in (TAIL, 1 - TAIL)
            )
        else:
            high = spent
    if status is not None and status.min_seconds_left is not None:
        low, high = status.min_seconds_left, max(high, 2 * status.min_seconds_left)
    if status is not None and status.max_seconds_left is not None:
        low = status.min_seconds_left or 0.0
        high = max(status.max_seconds_left, low)
    return max(low, 0.0), max(high, 0.0)
