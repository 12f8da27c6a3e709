"""Make the page of all recorded validation results, docs/reference/validation-record.md, when the site is built.

The counts of the blind test come from the library's proof_record.yaml, the origin of its equations from the catalog of
hidden effects. All other tables come from validation_results.yaml in this folder.
"""

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import yaml

from virtual_phantom.base.data import RESOURCES
from virtual_phantom.base.names import label
from virtual_phantom.physics.effect import names
from virtual_phantom.proof.hiding.catalogue import MODELS
from virtual_phantom.proof.scoring.record import summary
from virtual_phantom.report.proof import tally
from virtual_phantom.statistics.proof_record import read_proof_record

RESULTS = Path(__file__).with_name("validation_results.yaml")
HEAD = """# Validation record

All recorded results of the validation benchmarks. [Validation](../validation/index.md) interprets them.
This page is generated from `proof_record.yaml` and `docs/generators/validation_results.yaml`.
"""


def page() -> str:
    """Return the page in Markdown."""
    parts = [HEAD, "## Blind test by seed", by_seed(), coverage(), origins()]
    for section in yaml.safe_load(RESULTS.read_text(encoding="utf-8")):
        parts.append(f"## {section['section']}")
        parts += [result(one) for one in section["tables"]]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def by_seed() -> str:
    """Return the counts of every unseen seed, the pooled counts, and in what the states of the code differ."""
    shown = summary(read_proof_record(RESOURCES / "proof_record.yaml"))
    counted = [one for one in shown["seeds"] if one["seed"] in shown["pooled_seeds"]]
    rows = [
        [
            name,
            *("{} of {}".format(*one["counts"][key]) for one in counted),
            tally(shown["pooled"][key]).replace("\N{NO-BREAK SPACE}", " "),
        ]
        for key, name in shown["quantities"].items()
    ]
    notes = [f"Seed {one['seed']}, state {one['state']}: {' '.join(one['note'].split())}" for one in shown["seeds"]]
    lines = table(["", *(f"seed {one['seed']}" for one in counted), "pooled (95 % interval)"], rows)
    return "\n".join([lines, "", shown["meaning"], "", *(f"* {note}" for note in notes)])


def coverage() -> str:
    """Return how many 95 % intervals covered the true value, by effect or group of effects and seed."""
    entries = [one for one in read_proof_record(RESOURCES / "proof_record.yaml") if one.unseen and one.coverage]
    found: dict[tuple[str, ...], dict[int, str]] = defaultdict(dict)
    for entry in entries:
        for part in entry.coverage:
            found[part.effects][entry.seed] = f"{part.count} of {part.n}"
    rows = [
        [", ".join(map(label, effects)), *(counts.get(entry.seed, "") for entry in entries)]
        for effects, counts in sorted(found.items())
    ]
    head = ["effects", *(f"seed {entry.seed}" for entry in entries)]
    return "### Coverage of 95 % intervals by effect\n\n" + table(head, rows)


def origins() -> str:
    """Return whose equations make each hidden effect."""
    rows = []
    for model, made in MODELS.items():
        known, lacking = ([label(one) for one in made if (one in names()) == wanted] for wanted in (True, False))
        rows.append([model, ", ".join(known), ", ".join(lacking)])
    head = ["made by", "effects of Virtual Phantom", "faults outside the library"]
    return "### Origin of the equations\n\n" + table(head, rows)


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
