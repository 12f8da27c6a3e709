"""Record of the blind validation: counts of every registered run, and coverage of the stated intervals.

A diagnosis reads these counts to report the coverage of its intervals. The module is separate from the blind validation
itself, which a diagnosis must not know.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from ..base.errors import InputError, refusing
from ..io.files import read_text

# {quantity: description}
QUANTITIES = {
    "first_medium_or_strong": "one medium or strong effect: ranked first",
    "first_weak": "one weak effect: ranked first",
    "exact": "one or two effects: precisely these named",
    "left_open": "one or two effects, all named: differences reported as unexplained",
    "pairs": "two effects: both named",
    "false_alarms": "nothing hidden: false alarms",
    "false_alarms_undeclared": "nothing hidden but a small undeclared deviation: false alarms",
    "unknown": "a fault outside of Virtual Phantom: reported as unexplained, or an equivalent named",
    "intervals": "95 % intervals of parameters that cover the true value",
}
Count = tuple[float, int]  # sum of the scores, and their number


@dataclass(frozen=True)
class RecordedRun:
    """Counts of one run.

    Attributes
    ----------
    commit : str
        Commit of the code that was run.
    rule : int
        Version of the scoring rule.
    note : str
        What a reader must know before comparing the counts with others.
    counts, own : mapping of str to tuple
        {name of QUANTITIES: (sum of scores, n)}, without and with the library's own equations.
    by_significance : mapping of str to tuple
        As `counts`, with all named effects counted, however irrelevant.
    worst : mapping of str to str
        {name of QUANTITIES: the worst class of cases in words}.
    classes : mapping
        {kind of class: {class: {name of QUANTITIES: (sum of scores, n)}}}.
    coverage : mapping of str to tuple
        {effect: (number of 95 % intervals that cover the true value, n)}.
    attempts : mapping of str to int
        {event of the log of runs: number}.
    """

    seed: int
    commit: str
    rule: int
    cases: int
    note: str
    counts: Mapping[str, Count]
    own: Mapping[str, Count] = field(default_factory=dict)
    by_significance: Mapping[str, Count] = field(default_factory=dict)
    worst: Mapping[str, str] = field(default_factory=dict)
    classes: Mapping[str, Mapping[str, Mapping[str, Count]]] = field(default_factory=dict)
    coverage: Mapping[str, Count] = field(default_factory=dict)
    attempts: Mapping[str, int] = field(default_factory=dict)


def read_proof_record(path: str | Path) -> tuple[RecordedRun, ...]:
    """Read all runs; InputError if the file is missing or broken, or has a commit twice. The last one is published."""
    kinds = (OSError, KeyError, TypeError, ValueError, AttributeError, yaml.YAMLError)
    with refusing(f"{path}: is not a record of the blind validation", *kinds, advice="restore it"):
        runs = tuple(_run(entry) for entry in yaml.safe_load(read_text(path, "restore it")))
    commits = [run.commit for run in runs]
    if twice := sorted({commit for commit in commits if commits.count(commit) > 1}):
        raise InputError(f"{path}: has commit {twice[0]} twice; keep the first run of a commit")
    return runs


def _run(entry: Mapping) -> RecordedRun:
    pairs = {name: _pairs(entry.get(name, {})) for name in ("counts", "own", "by_significance", "coverage")}
    if unknown := {*pairs["counts"], *pairs["own"], *pairs["by_significance"]} - set(QUANTITIES):
        raise ValueError(f"there is no count {sorted(unknown)[0]}")
    classes = {
        kind: {name: _pairs(counts) for name, counts in values.items()}
        for kind, values in entry.get("classes", {}).items()
    }
    return RecordedRun(**{**entry, **pairs, "classes": classes, "commit": str(entry["commit"])})


def _pairs(counts: Mapping[str, Sequence]) -> dict[str, Count]:
    for count, n in counts.values():
        if not (isinstance(count, int | float) and isinstance(n, int) and 0 <= count <= n):
            raise ValueError(f"{[count, n]} is not a count and its total")
    return {name: (count, n) for name, (count, n) in counts.items()}


def with_coverage(content: dict, runs: Sequence[RecordedRun]) -> dict:
    """Add the coverage of 95 % intervals in the published run to the content of diagnosis.json.

    Every parameter gets `ci95_coverage`: {count, n, effects, all: {count, n}}. `effects` are the effects that were
    counted together; count, n and effects are None if the coverage is unknown. `all` counts all effects.
    """
    count, n = runs[-1].counts["intervals"]

    def coverage(effect: str) -> dict:
        found = runs[-1].coverage.get(effect)
        known = {"count": found[0], "n": found[1], "effects": [effect]} if found else None
        return (known or dict.fromkeys(("count", "n", "effects"))) | {"all": {"count": count, "n": n}}

    effects = []
    for effect in content["effects"]:
        added = {"ci95_coverage": coverage(effect["name"])}
        effects.append(effect | {"parameters": {key: value | added for key, value in effect["parameters"].items()}})
    return content | {"effects": effects}
