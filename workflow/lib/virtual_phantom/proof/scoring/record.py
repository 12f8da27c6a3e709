"""What a score adds to the record of the proof, what the page shows of it, and two scores' coverage side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import yaml

from ...base.errors import InputError, refusing
from ...io.files import replacing
from ...statistics.proof_record import QUANTITIES, SeedResult, pooled_counts, read_proof_record
from .intervals import share_of

MEANING = (
    "Every seed that was looked at, counted as it was first scored. Pooled are those that were unseen then. Their "
    "states of the code differ: Wilson's interval of a pooled count takes all cases to be alike, and is that of the "
    "code as it was on average, not of its last state."
)


def counts_of(score: Mapping) -> dict[str, tuple[int, int]]:
    """The counts of a score that the record keeps, {name of QUANTITIES: (how many, of how many)}."""
    accuracy = score["accuracy"]
    shares = {
        "first_medium_or_strong": accuracy["first"]["medium_or_strong"],
        "first_weak": accuracy["first"]["by_strength"]["weak"],
        "pairs": accuracy["pairs"]["both_named"],
        "false_alarms": accuracy["false_alarms"],
        "unknown": accuracy["unknown"],
        "exact": accuracy["exact"]["all"],
        "intervals": score["parameters"]["all"]["covered"],
    }
    return {name: (shares[name]["count"], shares[name]["n"]) for name in QUANTITIES}


def add(path: str | Path, score: Mapping, state: str, note: str, unseen: bool = True) -> None:
    """Add the entry of a score to a record, after those that are there.

    Parameters
    ----------
    path : str or Path
        Of the record.
    score : mapping
        Content of score.json.
    state, note : str
        As SeedResult has them.
    unseen : bool, optional
        As SeedResult has it.

    Raises
    ------
    InputError
        If the record is broken or has the seed, or the score is none that says its seed.
    """
    with refusing("the score: is none that the record could keep", KeyError, TypeError, advice="score the suite again"):
        entry = {
            "seed": score["suite"]["seed"],
            "unseen": unseen,
            "state": state,
            "cases": score["counts"]["cases"],
            "note": note,
            "counts": {name: list(pair) for name, pair in counts_of(score).items()},
            "coverage": [
                {"effects": [name], "held": [one["covered"]["count"], one["covered"]["n"]]}
                for name, one in score["parameters"]["by_effect"].items()
            ],
        }
    if entry["seed"] in [one.seed for one in read_proof_record(path)]:
        raise InputError(f"{path}: has seed {entry['seed']} already; a seed counts once, as it was first scored")
    text = yaml.safe_dump([entry], sort_keys=False, width=120, default_flow_style=None, allow_unicode=True)
    with replacing(path, checksum=False) as made:
        made.write_text(Path(path).read_text(encoding="utf-8") + text, encoding="utf-8")


def summary(entries: Sequence[SeedResult]) -> dict:
    """What the page shows: every seed's counts, and the pooled ones with Wilson's 95 % intervals."""
    return {
        "meaning": MEANING,
        "quantities": QUANTITIES,
        "pooled": {name: share_of(*pair) for name, pair in pooled_counts(entries).items()},
        "pooled_seeds": [entry.seed for entry in entries if entry.unseen and entry.counts],
        "seeds": [
            {
                "seed": entry.seed,
                "unseen": entry.unseen,
                "state": entry.state,
                "note": entry.note,
                "counts": {name: list(pair) for name, pair in entry.counts.items()},
            }
            for entry in entries
        ],
    }


def coverage_table(first: Mapping, second: Mapping) -> list[str]:
    """Lines of a table: which 95 % intervals held the truth, by effect, in one score and in another."""
    tables = [one["parameters"] for one in (first, second)]
    names = sorted(set(tables[0]["by_effect"]) | set(tables[1]["by_effect"]))
    rows = [(name, [table["by_effect"].get(name) for table in tables]) for name in names]
    rows.append(("all", [table["all"] for table in tables]))
    seeds = [f"seed {one['suite']['seed']}" for one in (first, second)]
    width = max(len(name) for name, _ in rows)
    lines = [f"{'95 % intervals that held':{width}}  {seeds[0]:>16}  {seeds[1]:>16}"]
    return lines + [f"{name:{width}}  " + "  ".join(f"{_of(one):>16}" for one in pair) for name, pair in rows]


def _of(one: Mapping | None) -> str:
    return "-" if one is None or not one["covered"]["n"] else f"{one['covered']['count']} of {one['covered']['n']}"
