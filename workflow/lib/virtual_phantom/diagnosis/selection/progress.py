"""Progress of a diagnosis, in words; no result depends on it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from ...base.names import label

# Tasks that are counted.
RANKED, FITTED = "effects ranked", "fits made"
# Milestones.
ALIGNED, JUDGED, COMPARED = "alignment fitted", "verdict found", "images compared"

# Upper bound of the remaining time after each milestone, relative to the time since the start. Images and the page took
# 4 to 30 % of the time of twelve diagnoses (benchmarks/diagnosis_rates.py), and the page alone up to 10 %. The value
# for fits is divided by the number of their rounds. In a diagnosis with three effects and nine rounds, the ratio was 4
# after the first round, 2.3 after the second, and 0.9 after the fifth.
LEFT_AFTER = {FITTED: 6.0, JUDGED: 0.4, COMPARED: 0.1}


@dataclass
class Count:
    """Tasks of one kind.

    Attributes
    ----------
    of, done : int
        Number of tasks known so far, and number of finished tasks.
    began : float
        Start of the latest tasks, s.
    before : int
        Number of tasks finished at that time.
    """

    of: int = 0
    done: int = 0
    began: float = 0.0
    before: int = 0

    def seconds_left(self, now: float) -> float | None:
        """Return the time left at the pace of the latest tasks, s; None if none of them is done."""
        done = self.done - self.before
        return (now - self.began) / done * (self.of - self.done) if done else None


class DiagnosisProgress:
    """Progress of a diagnosis.

    Parameters
    ----------
    tell : callable, optional
        Called with this object at every step, by one thread at a time.
    """

    def __init__(
        self, tell: Callable[[DiagnosisProgress], None] | None = None, clock: Callable[[], float] = time.monotonic
    ):
        self._tell, self._clock, self._lock = tell, clock, threading.Lock()
        self._parts: dict[str, Count | None] = {}
        self._beside, self._began, self._rounds = "", clock(), 0

    @property
    def words(self) -> str:
        """Progress in order: "alignment fitted; 28 effects ranked; 4 of 6 fits made"."""
        return "; ".join(what if count is None else self._counted(what, count) for what, count in self._parts.items())

    @property
    def min_seconds_left(self) -> float | None:
        """Time left for the fits in progress, s; None if unknown. Others may follow."""
        fits = self._parts.get(FITTED)
        return None if fits is None else fits.seconds_left(self._clock())

    @property
    def max_seconds_left(self) -> float | None:
        """Upper bound of the time left at the pace so far, s; None before fits are made."""
        share = next((LEFT_AFTER[what] for what in (COMPARED, JUDGED) if what in self._parts), None)
        if share is None and self._rounds:
            share = LEFT_AFTER[FITTED] / self._rounds
        return None if share is None else share * (self._clock() - self._began)

    def reached(self, what: str) -> None:
        """Note that ALIGNED, JUDGED or COMPARED is reached."""
        with self._lock:
            self._parts[what] = None
            self._say()

    def begin(self, what: str, count: int, beside: tuple[str, ...] = ()) -> Callable[[], None]:
        """Note the start of tasks.

        Parameters
        ----------
        what : {RANKED, FITTED}
            Fits are added up; a ranking replaces the one before.
        beside : tuple of str, optional
            Fitted effects to which the ranked ones would be added.

        Returns
        -------
        callable
            To be called whenever one of the tasks is done.
        """
        with self._lock:
            known = self._parts.get(what) if what == FITTED else None
            tasks = self._parts[what] = known or Count()
            tasks.of, tasks.began, tasks.before = tasks.of + count, self._clock(), tasks.done
            self._rounds += what == FITTED
            if what == RANKED:
                self._beside = " and ".join(map(label, beside))
            self._say()

        def done() -> None:
            with self._lock:
                tasks.done += 1
                self._say()

        return done

    def _counted(self, what: str, count: Count) -> str:
        number = f"{count.of}" if count.done == count.of else f"{count.done} of {count.of}"
        return f"{number} {what}" + (f" beside {self._beside}" if what == RANKED and self._beside else "")

    def _say(self) -> None:
        if self._tell is not None:
            self._tell(self)
