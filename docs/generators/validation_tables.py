"""Make the page of all recorded validation results, docs/reference/validation-record.md, when the site is built.

The counts of the blind test come from the library's proof_record.yaml, the origin of its equations from the catalog of
hidden effects. All other tables come from validation_results.yaml in this folder.
"""

from collections.abc import Sequence
from pathlib import Path

import yaml

from virtual_phantom.base.data import RESOURCES
from virtual_phantom.base.names import label
from virtual_phantom.physics.effect import names
from virtual_phantom.proof.hiding.catalogue import MODELS, never_hidden
from virtual_phantom.proof.hiding.hidden_effect import EQUATIONS
from virtual_phantom.proof.scoring.record import class_table, table_of
from virtual_phantom.statistics.proof_record import read_proof_record

RUN = read_proof_record(RESOURCES / "proof_record.yaml")[-1]
RESULTS = Path(__file__).with_name("validation_results.yaml")
HEAD = """# Validation record

All recorded results of the validation benchmarks. [Validation](../validation/index.md) interprets them.
This page is generated from `proof_record.yaml` and `docs/generators/validation_results.yaml`.
"""


def page() -> str:
    """Return the page in Markdown."""
    parts = [HEAD, "## Last blind test", last_run(), coverage(), origins()]
    for section in yaml.safe_load(RESULTS.read_text(encoding="utf-8")):
        parts.append(f"## {section['section']}")
        parts += [result(one) for one in section["tables"]]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def last_run() -> str:
    """Return the results of the last run, in all and by class of cases."""
    attempts = ", ".join(f"{event} {count} times" for event, count in RUN.attempts.items())
    note = f"Seed {RUN.seed}, commit {RUN.commit}, {RUN.cases} cases, scoring rule {RUN.rule}. {RUN.note}"
    logged = f"Log of runs of this commit: {attempts}." if attempts else ""
    return "\n\n".join(
        filter(
            None,
            [
                "\n".join(table_of(RUN)),
                "\n".join(class_table(RUN)),
                note,
                logged,
            ],
        )
    )


def coverage() -> str:
    """Return how many 95 % intervals of the last run covered the true value, by effect."""
    rows = [[label(name), f"{count} of {n}"] for name, (count, n) in sorted(RUN.coverage.items())]
    return "### Coverage of 95 % intervals by effect\n\n" + table(
        ["effect", "intervals that cover the true value"], rows
    )


def origins() -> str:
    """Return whose equations make each hidden effect, and which effects are never hidden."""
    rows = []
    for source, made in zip(EQUATIONS.values(), MODELS.values(), strict=True):
        known, lacking = ([label(one) for one in made if (one in names()) == wanted] for wanted in (True, False))
        rows.append([source, ", ".join(known), ", ".join(lacking)])
    head = ["made by", "effects of Virtual Phantom", "faults outside the library"]
    never = f"Never hidden: {', '.join(map(label, never_hidden()))}."
    return "\n\n".join(["### Origin of the equations", table(head, rows), never])


def result(one: dict) -> str:
    """Return one table of validation_results.yaml with its title, command and notes."""
    head, *rows = ([cell.strip() for cell in line.split("|")] for line in one["table"].splitlines())
    parts = [f"### {one['name']}", *([f"Command: {one['command']}"] if "command" in one else [])]
    parts.append(table(head, rows))
    if "notes" in one:
        parts.append("\n".join(f"* {note}" for note in one["notes"]))
    return "\n\n".join(parts)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown. Raises ValueError if a row has another number of cells than the header."""
    lines = [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    for row in rows:
        if len(row) != len(head):
            raise ValueError(f"{RESULTS.name}: row {row} has {len(row)} cells; the header has {len(head)}")
        lines.append(f"| {' | '.join(row)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    print(page(), end="")
