"""The record of the blind test: counts of every seed that was looked at, and how often stated intervals held.

Apart from the proof itself, of which a diagnosis knows nothing: it reads counts alone, to say what its intervals are
worth.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from ..base.errors import InputError, refusing
from ..io.files import read_text

# What is counted, and what it is called.
QUANTITIES = {
    "first_medium_or_strong": "one effect of medium or strong strength: named first",
    "first_weak": "one weak effect: named first",
    "pairs": "two effects: both named",
    "false_alarms": "nothing concealed: false alarms",
    "unknown": "an effect that the library lacks: something left unexplained",
    "exact": "precisely what was concealed, and nothing else",
    "intervals": "95 % intervals of parameters that held the truth",
}


@dataclass(frozen=True)
class Held:
    """How many 95 % intervals of these effects' parameters held the truth."""

    effects: tuple[str, ...]
    count: int
    n: int


@dataclass(frozen=True)
class Entry:
    """One seed.

    Attributes
    ----------
    unseen : bool
        Nobody had looked at it and nothing was tuned on it when it was scored.
    state : str
        Of the code that was run.
    note : str
        In what it differs from others.
    cases : int or None
        Of the suite; None if it was never run as a whole.
    counts : mapping of str to tuple of 2 int
        {name of QUANTITIES: (how many, of how many)}; empty if it was never run as a whole.
    coverage : tuple of Held
        By effect, or by groups of effects where no more was kept.
    """

    seed: int
    unseen: bool
    state: str
    note: str
    cases: int | None = None
    counts: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    coverage: tuple[Held, ...] = ()


def read(path: str | Path) -> tuple[Entry, ...]:
    """All entries, in the order of the file.

    Raises
    ------
    InputError
        If it is missing or broken, or names a seed twice.
    """
    kinds = (OSError, KeyError, TypeError, ValueError, AttributeError, yaml.YAMLError)
    with refusing(f"{path}: is no record of the proof", *kinds, advice="restore it"):
        entries = tuple(_entry(one) for one in yaml.safe_load(read_text(path, "restore it")))
    seeds = [entry.seed for entry in entries]
    if twice := sorted({seed for seed in seeds if seeds.count(seed) > 1}):
        raise InputError(f"{path}: has seed {twice[0]} twice; a seed counts once, as it was first scored")
    return entries


def _entry(one: Mapping) -> Entry:
    counts = {name: _pair(pair) for name, pair in one.get("counts", {}).items()}
    if counts and set(counts) != set(QUANTITIES):
        raise ValueError(f"seed {one['seed']} needs the counts {', '.join(QUANTITIES)}")
    coverage = tuple(Held(tuple(sorted(part["effects"])), *_pair(part["held"])) for part in one.get("coverage", ()))
    if not isinstance(one["unseen"], bool):
        raise ValueError(f"unseen of seed {one['seed']} is neither true nor false")
    return Entry(
        int(one["seed"]), one["unseen"], str(one["state"]), str(one["note"]), one.get("cases"), counts, coverage
    )


def _pair(pair: Sequence) -> tuple[int, int]:
    count, n = pair
    if not (isinstance(count, int) and isinstance(n, int) and 0 <= count <= n):
        raise ValueError(f"{pair} are not so many of so many")
    return count, n


def pooled(entries: Iterable[Entry]) -> dict[str, tuple[int, int]]:
    """Counts over all seeds that were unseen and scored."""
    counted = [entry.counts for entry in entries if entry.unseen and entry.counts]
    return {name: _sum(one[name] for one in counted) for name in QUANTITIES}


def held(entries: Iterable[Entry], effect: str) -> Held | None:
    """How often intervals of an effect's parameters held over the unseen seeds.

    Of a seed that kept groups alone the group counts that the effect is in; `effects` are all that counted together.

    Returns
    -------
    Held or None
        None if nothing is known of it.
    """
    found = []
    for entry in entries:
        if entry.unseen and (parts := [part for part in entry.coverage if effect in part.effects]):
            found.append(min(parts, key=lambda part: len(part.effects)))
    if not found:
        return None
    together = tuple(sorted({name for part in found for name in part.effects}))
    return Held(together, *_sum((part.count, part.n) for part in found))


def with_coverage(content: dict, entries: Sequence[Entry]) -> dict:
    """What diagnosis.json holds, each parameter with how often intervals for noise alone held the truth.

    Returns
    -------
    dict
        The content with, beside every `ci95`, `ci95_held`: {count, n, effects, all: {count, n}} of this effect's
        parameters, or of all the `effects` that were counted together (None each if nothing is known of it), and of all
        effects.
    """
    count, n = pooled(entries)["intervals"]

    def known(effect: str) -> dict:
        part = held(entries, effect)
        own = {"count": part.count, "n": part.n, "effects": list(part.effects)} if part else None
        return (own or dict.fromkeys(("count", "n", "effects"))) | {"all": {"count": count, "n": n}}

    effects = []
    for one in content["effects"]:
        told = {"ci95_held": known(one["name"])}
        effects.append(one | {"parameters": {key: value | told for key, value in one["parameters"].items()}})
    return content | {"effects": effects}


def _sum(pairs: Iterable[tuple[int, int]]) -> tuple[int, int]:
    pairs = list(pairs)
    return sum(count for count, _ in pairs), sum(n for _, n in pairs)
