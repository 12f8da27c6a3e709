"""Record of the blind validation: counts of every scored seed, and coverage of the stated intervals.

A diagnosis reads these counts to report the coverage of its intervals. The module is separate from the blind validation
itself, which a diagnosis must not know.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from ..base.errors import InputError, refusing
from ..io.files import read_text

# {count: description}
QUANTITIES = {
    "first_medium_or_strong": "one effect of medium or strong size: ranked first",
    "first_weak": "one weak effect: ranked first",
    "pairs": "two effects: both named",
    "false_alarms": "no hidden effect: false alarms",
    "unknown": "an effect outside of Virtual Phantom: reported as unexplained",
    "exact": "exactly the hidden effects, and no others",
    "intervals": "95 % intervals of parameters that covered the true value",
}


@dataclass(frozen=True)
class IntervalCoverage:
    """Number of 95 % intervals of these effects' parameters that covered the true value: `count` of `n`."""

    effects: tuple[str, ...]
    count: int
    n: int


@dataclass(frozen=True)
class SeedResult:
    """Scores of one seed.

    Attributes
    ----------
    unseen : bool
        Whether nothing had been tuned on this seed, and nobody had looked at it, when it was scored.
    state : str
        State of the code that was run.
    note : str
        Differences from the other seeds.
    cases : int or None
        Number of cases; None if the suite was not run completely.
    counts : mapping of str to tuple of 2 int
        {name of QUANTITIES: (count, n)}; empty if the suite was not run completely.
    coverage : tuple of IntervalCoverage
        Per effect, or per group of effects if the record has no more detail.
    """

    seed: int
    unseen: bool
    state: str
    note: str
    cases: int | None = None
    counts: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    coverage: tuple[IntervalCoverage, ...] = ()


def read_proof_record(path: str | Path) -> tuple[SeedResult, ...]:
    """Read the results of all seeds; InputError if the file is missing or broken, or has a seed twice."""
    kinds = (OSError, KeyError, TypeError, ValueError, AttributeError, yaml.YAMLError)
    with refusing(f"{path}: is not a record of the blind validation", *kinds, advice="restore it"):
        results = tuple(_seed_result(entry) for entry in yaml.safe_load(read_text(path, "restore it")))
    seeds = [result.seed for result in results]
    if twice := sorted({seed for seed in seeds if seeds.count(seed) > 1}):
        raise InputError(f"{path}: has seed {twice[0]} twice; keep the first score of a seed")
    return results


def _seed_result(entry: Mapping) -> SeedResult:
    seed, unseen = entry["seed"], entry["unseen"]
    counts = {name: _pair(pair) for name, pair in entry.get("counts", {}).items()}
    if counts and set(counts) != set(QUANTITIES):
        raise ValueError(f"seed {seed} needs the counts {', '.join(QUANTITIES)}")
    coverage = tuple(
        IntervalCoverage(tuple(sorted(part["effects"])), *_pair(part["held"])) for part in entry.get("coverage", ())
    )
    if not isinstance(unseen, bool):
        raise ValueError(f"unseen of seed {seed} is neither true nor false")
    return SeedResult(int(seed), unseen, str(entry["state"]), str(entry["note"]), entry.get("cases"), counts, coverage)


def _pair(pair: Sequence) -> tuple[int, int]:
    count, n = pair
    if not (isinstance(count, int) and isinstance(n, int) and 0 <= count <= n):
        raise ValueError(f"{pair} is not a count and its total")
    return count, n


def pooled_counts(results: Iterable[SeedResult]) -> dict[str, tuple[int, int]]:
    """Counts over all seeds that were unseen and scored."""
    counts = [result.counts for result in results if result.unseen and result.counts]
    return {name: _sum(seed_counts[name] for seed_counts in counts) for name in QUANTITIES}


def interval_coverage(results: Iterable[SeedResult], effect: str) -> IntervalCoverage | None:
    """Coverage of the intervals of an effect's parameters over the unseen seeds; None if it is unknown.

    If a seed has counts for groups of effects only, the smallest group with this effect is used. `effects` of the
    result are all effects that were counted.
    """
    found = []
    for result in results:
        if result.unseen and (parts := [part for part in result.coverage if effect in part.effects]):
            found.append(min(parts, key=lambda part: len(part.effects)))
    if not found:
        return None
    effects = tuple(sorted({name for part in found for name in part.effects}))
    return IntervalCoverage(effects, *_sum((part.count, part.n) for part in found))


def with_coverage(content: dict, results: Sequence[SeedResult]) -> dict:
    """Add the coverage of noise-only intervals in the blind validation to the content of diagnosis.json.

    Every parameter gets `ci95_held`: {count, n, effects, all: {count, n}}. `effects` are the effects that were counted
    together; count, n and effects are None if the coverage is unknown. `all` counts all effects.
    """
    count, n = pooled_counts(results)["intervals"]

    def coverage(effect: str) -> dict:
        part = interval_coverage(results, effect)
        known = {"count": part.count, "n": part.n, "effects": list(part.effects)} if part else None
        return (known or dict.fromkeys(("count", "n", "effects"))) | {"all": {"count": count, "n": n}}

    effects = []
    for effect in content["effects"]:
        added = {"ci95_held": coverage(effect["name"])}
        effects.append(effect | {"parameters": {key: value | added for key, value in effect["parameters"].items()}})
    return content | {"effects": effects}


def _sum(pairs: Iterable[tuple[int, int]]) -> tuple[int, int]:
    pairs = list(pairs)
    return sum(count for count, _ in pairs), sum(n for _, n in pairs)
