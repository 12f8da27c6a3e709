"""How far a diagnosis is, in words, while it runs: nothing depends on it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from ...base.words import label

# What is counted, as it is said of many.
RANKED, FITTED = "effects ranked", "fits made"
# What is there or not.
ALIGNED, JUDGED, COMPARED = "alignment fitted", "verdict found", "images compared"

# Most time that remains after these, over the time since the start: images and the page were 4 to 30 percent of twelve
# diagnoses (benchmarks/diagnosis_rates.py), and the page alone up to a tenth. Of fits divided by their rounds: where
# three effects were found, 4 times after the first of nine rounds, 2.3 after the second, 0.9 after the fifth.
LEFT_AFTER = {FITTED: 6.0, JUDGED: 0.4, COMPARED: 0.1}


@dataclass
class Count:
    """Tasks of one kind.

    Attributes
    ----------
    of, done : int
        How many there are as far as is known, and are done.
    began : float
        When the last ones were begun, s.
    before : int
        Tasks that were done then.
    """

    of: int = 0
    done: int = 0
    began: float = 0.0
    before: int = 0

    def seconds_left(self, now: float) -> float | None:
        """What the others take if they take as long as those since the last were begun; None where none is done."""
        done = self.done - self.before
        return (now - self.began) / done * (self.of - self.done) if done else None


class DiagnosisProgress:
    """What of a diagnosis is done.

    Parameters
    ----------
    tell : callable, optional
        Called with this object whenever more is done, by one thread at a time.
    clock : callable, optional
        Gives seconds.
    """

    def __init__(
        self, tell: Callable[[DiagnosisProgress], None] | None = None, clock: Callable[[], float] = time.monotonic
    ):
        self._tell, self._clock, self._lock = tell, clock, threading.Lock()
        self._parts: dict[str, Count | None] = {}
        self._beside, self._began, self._rounds = "", clock(), 0

    @property
    def words(self) -> str:
        """All of it in the order in which it was begun: "alignment fitted; 28 effects ranked; 4 of 6 fits made"."""
        return "; ".join(what if count is None else self._counted(what, count) for what, count in self._parts.items())

    @property
    def seconds_left(self) -> float | None:
        """What fits take that are under way; None where nothing tells. Others may follow."""
        fits = self._parts.get(FITTED)
        return None if fits is None else fits.seconds_left(self._clock())

    @property
    def most_left(self) -> float | None:
        """Most time that remains by the pace of this diagnosis, s; None before fits are made."""
        share = next((LEFT_AFTER[what] for what in (COMPARED, JUDGED) if what in self._parts), None)
        if share is None and self._rounds:
            share = LEFT_AFTER[FITTED] / self._rounds
        return None if share is None else share * (self._clock() - self._began)

    def reached(self, what: str) -> None:
        """ALIGNED, JUDGED or COMPARED is there."""
        with self._lock:
            self._parts[what] = None
            self._say()

    def begin(self, what: str, count: int, beside: tuple[str, ...] = ()) -> Callable[[], None]:
        """Tasks are begun.

        Parameters
        ----------
        what : {RANKED, FITTED}
            Fits are counted on; a ranking takes the place of the one before.
        beside : tuple of str, optional
            Effects beside which others are ranked.

        Returns
        -------
        callable
            To be called whenever one of the tasks is done.
        """
        with self._lock:
            known = self._parts.get(what) if what == FITTED else None
            one = self._parts[what] = known or Count()
            one.of, one.began, one.before = one.of + count, self._clock(), one.done
            self._rounds += what == FITTED
            if what == RANKED:
                self._beside = " and ".join(map(label, beside))
            self._say()

        def done() -> None:
            with self._lock:
                one.done += 1
                self._say()

        return done

    def _counted(self, what: str, count: Count) -> str:
        number = f"{count.of}" if count.done == count.of else f"{count.done} of {count.of}"
        return f"{number} {what}" + (f" beside {self._beside}" if what == RANKED and self._beside else "")

    def _say(self) -> None:
        if self._tell is not None:
            self._tell(self)
