"""What a file of line integrals keeps of the acquisition chain: noise is drawn from it."""

from __future__ import annotations

from pathlib import Path

from ..io.exchange import Physics, read_physics
from .state import State

ARRAYS = ("signal", "noise", "air", "gain", "dark")
NUMBERS = ("photons", "electronic", "neighbours", "lag", "slow_lag", "response", "correction", "dark_air")


def to_store(state: State) -> Physics:
    """What `read_state` makes the state of."""
    arrays = {name: getattr(state, name) for name in ARRAYS}
    kept = {
        name: array
        for name, array in arrays.items()
        if array is not None and (name != "noise" or array is not state.signal)
    }
    return Physics(kept, {name: getattr(state, name) for name in NUMBERS})


def read_state(path: str | Path) -> State | None:
    """The state in a file of line integrals.

    Returns
    -------
    State or None
        None of the baseline.

    Raises
    ------
    InputError
        For a file that is no such one.
    """
    found = read_physics(path)
    if found is None:
        return None
    physics, geometry = found
    return State(geometry, **physics.arrays, **physics.numbers)
