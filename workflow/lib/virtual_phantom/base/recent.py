"""A cache of the most recently used results."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import TypeVar

Result = TypeVar("Result")


class Kept:
    """A cache of at most `most` results that removes the least recently used result first."""

    def __init__(self, most: int):
        self._most, self._results = most, {}

    def __contains__(self, key: Hashable) -> bool:
        return key in self._results

    def get(self, key: Hashable, make: Callable[[], Result] | None = None) -> Result:
        """Return the result of a key. A missing result is computed by `make`."""
        result = self._results.pop(key) if key in self._results else make()
        self._results[key] = result
        while len(self._results) > self._most:
            self._results.pop(next(iter(self._results)))
        return result
