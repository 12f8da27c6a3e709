"""The record of registered runs, its tables for the documentation, and a comparison of coverage in two scores."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping
from pathlib import Path

import yaml

from ...base.errors import InputError, refusing
from ...base.names import label
from ...io.files import replacing
from ...report.proof import tally
from ...statistics.proof_record import QUANTITIES, Count, RecordedRun, read_proof_record
from .intervals import share_of
from .registration import attempts
from .targets import TARGETS

# Part of a page that `filled` replaces
RESULTS = re.compile(r"(<!-- blind validation: results -->\n).*?(<!-- end -->)", re.DOTALL)


def _counts(shares: Mapping) -> dict[str, list]:
    """Return {name: [sum of scores, n]} of shares that have a case."""
    return {name: [round(one["count"], 4), one["n"]] for name, one in shares.items() if one["n"]}


def summary(headline: Mapping) -> dict[str, dict]:
    """Return counts, own, by_significance and worst of a headline score, as in RecordedRun."""
    return {
        "counts": _counts(headline["all"]),
        "own": _counts(headline["own"]),
        "by_significance": _counts(headline["by_significance"]),
        "worst": {name: f"{label(one['class'])}: {_plain(one)}" for name, one in headline["worst"].items()},
    }


def add(path: str | Path, score: Mapping, runs: str | Path, note: str) -> None:
    """Append the score of a registered run to a record.

    Parameters
    ----------
    path : str or Path
        File of the record.
    score : mapping
        Content of score.json.
    runs : str or Path
        Log of runs.
    note : str
        As in RecordedRun.

    Raises
    ------
    InputError
        If the record or the log is broken, the record has the commit, or the run does not count.
    """
    with refusing("the score: is not valid", KeyError, TypeError, advice="score the suite again"):
        registered, counted = score["registration"], score["headline"]
        if not registered["counts"]:
            raise InputError(f"the score: does not count, because {'; '.join(registered['reasons'])}; register a run")
        entry = {
            **{key: registered[key] for key in ("seed", "commit", "cases")},
            "rule": counted["rule"]["version"],
            "note": note,
            **summary(counted),
            "classes": {
                kind: {name: _counts(shares) for name, shares in values.items()}
                for kind, values in counted["classes"].items()
            },
            "coverage": _counts({name: one["covered"] for name, one in score["parameters"]["by_effect"].items()}),
            "attempts": attempts(runs, registered),
        }
    if entry["commit"] in [run.commit for run in read_proof_record(path)]:
        raise InputError(f"{path}: already has commit {entry['commit']}; one run of a commit counts")
    text = yaml.safe_dump([entry], sort_keys=False, width=120, default_flow_style=None, allow_unicode=True)
    with replacing(path, checksum=False) as made:
        made.write_text(Path(path).read_text(encoding="utf-8") + text, encoding="utf-8")


def result_table(
    counts: Mapping[str, Count],
    own: Mapping[str, Count],
    by_significance: Mapping[str, Count],
    worst: Mapping[str, str],
) -> list[str]:
    """Return the lines of a Markdown table, of results as in RecordedRun."""
    signs = {"at least": "≥", "at most": "≤"}
    columns = {
        "target": {name: f"{signs[sense]} {100 * share:g} %" for name, (share, sense) in TARGETS.items()},
        "result (95 % interval)": {name: _share(pair) for name, pair in counts.items()},
        "worst class": worst,
        "by significance": {name: _share(pair) for name, pair in by_significance.items()},
        "Virtual Phantom's own equations": {name: _share(pair) for name, pair in own.items()},
    }
    columns = {title: cells for title, cells in columns.items() if cells}
    lines = [f"| test | {' | '.join(columns)} |", "|---|" + "---|" * len(columns)]
    for name, quantity in QUANTITIES.items():
        if name in {*counts, *own, *by_significance}:
            lines.append(f"| {quantity} | {' | '.join(cells.get(name, '') for cells in columns.values())} |")
    return lines


def table_of(run: RecordedRun) -> list[str]:
    """Return `result_table` of a run."""
    return result_table(run.counts, run.own, run.by_significance, run.worst)


def class_table(run: RecordedRun) -> list[str]:
    """Return the lines of a Markdown table: counts by class of cases. Empty if the run has no classes."""
    rows = [(kind, name, counts) for kind, values in run.classes.items() for name, counts in values.items()]
    if not rows:
        return []
    names = [name for name in QUANTITIES if any(name in counts for _, _, counts in rows)]
    lines = [f"| class | | {' | '.join(QUANTITIES[name] for name in names)} |", "|---|---|" + "---|" * len(names)]
    for kind, name, counts in rows:
        cells = [f"{counts[key][0]:.4g} of {counts[key][1]}" if key in counts else "" for key in names]
        lines.append(f"| {kind} | {label(name)} | {' | '.join(cells)} |")
    return lines


def filled(page: str, run: RecordedRun) -> str:
    """Return a page with the results of a run between its comments."""
    about = f"Commit {run.commit[:8]}, seed {run.seed}, {run.cases} cases, registered before its scans. {run.note}"
    lines = "\n".join([*textwrap.wrap(about, 120), "", *table_of(run)])
    return RESULTS.sub(lambda found: f"{found[1]}\n{lines}\n{found[2]}", page)


def _share(pair: Count) -> str:
    return _plain(share_of(*pair))


def _plain(share: Mapping) -> str:
    return tally(share).replace("\N{NO-BREAK SPACE}", " ")


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
