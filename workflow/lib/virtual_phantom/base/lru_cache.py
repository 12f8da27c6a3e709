"""A cache of the most recently used results.

cachetools.LRUCache is not used: `get` would need the same code in a subclass.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import TypeVar

Result = TypeVar("Result")


class LRUCache:
    """A cache of at most `size` results that removes the least recently used result first."""

    def __init__(self, size: int):
        self._size, self._results = size, {}

    def __contains__(self, key: Hashable) -> bool:
        return key in self._results

    def get(self, key: Hashable, make: Callable[[], Result] | None = None) -> Result:
        """Return the result of a key; `make`, which is needed if the key is missing, computes it."""
        result = self._results.pop(key) if key in self._results else make()
        self._results[key] = result
        while len(self._results) > self._size:
            self._results.pop(next(iter(self._results)))
        return result
