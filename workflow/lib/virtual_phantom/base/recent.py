"""The last few results by key."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import TypeVar

Result = TypeVar("Result")


class Kept:
    """A cache of at most `most` results, the least recently used going first."""

    def __init__(self, most: int):
        self._most, self._results = most, {}

    def __contains__(self, key: Hashable) -> bool:
        return key in self._results

    def get(self, key: Hashable, make: Callable[[], Result] | None = None) -> Result:
        """The result of this key, made if it is not there; without `make` it must be."""
        result = self._results.pop(key) if key in self._results else make()
        self._results[key] = result
        while len(self._results) > self._most:
            self._results.pop(next(iter(self._results)))
        return result
