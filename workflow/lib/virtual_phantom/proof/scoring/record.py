"""The record of all scored seeds, its summary for the page, and a comparison of coverage in two scores."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import yaml

from ...base.errors import InputError, refusing
from ...io.files import replacing
from ...statistics.proof_record import QUANTITIES, SeedResult, pooled_counts, read_proof_record
from .intervals import share_of

MEANING = (
    "All seeds that were inspected, with the counts of their first score. Pooled counts contain the seeds that were "
    "unseen then, scored by different states of the code. Wilson's interval of a pooled count assumes equal cases, and "
    "holds for the average state of the code, not for the last one."
)


def counts_of(score: Mapping) -> dict[str, tuple[int, int]]:
    """Return the counts that the record keeps of a score, {name of QUANTITIES: (count, n)}."""
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
    """Append a score to a record.

    Parameters
    ----------
    path : str or Path
        File of the record.
    score : mapping
        Content of score.json.
    state, note, unseen
        As in SeedResult.

    Raises
    ------
    InputError
        If the record is broken or has the seed, or if the score is not valid.
    """
    with refusing("the score: is not valid", KeyError, TypeError, advice="score the suite again"):
        entry = {
            "seed": score["suite"]["seed"],
            "unseen": unseen,
            "state": state,
            "cases": score["counts"]["cases"],
            "note": note,
            "counts": {name: list(pair) for name, pair in counts_of(score).items()},
            "coverage": [
                {"effects": [name], "held": [entry["covered"]["count"], entry["covered"]["n"]]}
                for name, entry in score["parameters"]["by_effect"].items()
            ],
        }
    if entry["seed"] in [entry.seed for entry in read_proof_record(path)]:
        raise InputError(f"{path}: already has seed {entry['seed']}; add each seed once, with its first score")
    text = yaml.safe_dump([entry], sort_keys=False, width=120, default_flow_style=None, allow_unicode=True)
    with replacing(path, checksum=False) as made:
        made.write_text(Path(path).read_text(encoding="utf-8") + text, encoding="utf-8")


def summary(entries: Sequence[SeedResult]) -> dict:
    """Return the counts of each seed and the pooled counts with Wilson's 95 % intervals."""
    return {
        "meaning": MEANING,
        "quantities": QUANTITIES,
        "pooled": {name: share_of(*pair) for name, pair in pooled_counts(entries).items()},
        "pooled_seeds": [entry.seed for entry in entries if entry.unseen and entry.counts],
        "seeds": [
            {key: getattr(entry, key) for key in ("seed", "unseen", "state", "note")}
            | {"counts": {name: list(pair) for name, pair in entry.counts.items()}}
            for entry in entries
        ],
    }


def coverage_table(first: Mapping, second: Mapping) -> list[str]:
    """Return the lines of a table of the coverage of 95 % intervals by effect, in two scores."""
    tables = [score["parameters"] for score in (first, second)]
    names = sorted(set(tables[0]["by_effect"]) | set(tables[1]["by_effect"]))
    rows = [(name, [table["by_effect"].get(name) for table in tables]) for name in names]
    rows.append(("all", [table["all"] for table in tables]))
    seeds = [f"seed {score['suite']['seed']}" for score in (first, second)]
    width = max(len(name) for name, _ in rows)
    lines = [f"{'95 % intervals: coverage':{width}}  {seeds[0]:>16}  {seeds[1]:>16}"]
    return lines + [f"{name:{width}}  " + "  ".join(f"{_count(entry):>16}" for entry in pair) for name, pair in rows]


def _count(entry: Mapping | None) -> str:
    covered = entry and entry["covered"]
    return f"{covered['count']} of {covered['n']}" if covered and covered["n"] else "-"
