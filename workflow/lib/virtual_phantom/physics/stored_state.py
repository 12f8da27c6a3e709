"""Part of a State that files of line integrals store, so that noise can be simulated from them."""

from __future__ import annotations

from pathlib import Path

from ..io.exchange import Physics, read_physics
from .state import State

ARRAYS = ("signal", "noise", "air", "gain", "dark")
NUMBERS = ("photons", "electronic", "neighbours", "tail", "lag", "slow_lag", "response", "correction", "dark_air")


def to_store(state: State) -> Physics:
    """Return the content of a file, which `read_state` reads."""
    arrays = {name: array for name in ARRAYS if (array := getattr(state, name)) is not None}
    if state.noise is state.signal:
        arrays.pop("noise", None)
    return Physics(arrays, {name: getattr(state, name) for name in NUMBERS})


def read_state(path: str | Path) -> State | None:
    """Return the State in a file of line integrals; None for the baseline.

    Raises
    ------
    InputError
        If it is not a file of line integrals.
    """
    found = read_physics(path)
    if found is None:
        return None
    physics, geometry = found
    return State(geometry, **physics.arrays, **physics.numbers)
