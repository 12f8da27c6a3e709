"""Draw the confusion matrix of seed 16 of the blind validation: `python docs/generators/proof_confusion.py`.

The cases in proof_seed_16.yaml are checked against the counts of the record (resources/proof_record.yaml). The picture
is docs/images/proof_confusion.png.
"""

from collections import Counter
from pathlib import Path

import yaml

from virtual_phantom.base.data import RESOURCES
from virtual_phantom.figures import confusion, style
from virtual_phantom.proof.hiding.hidden_effect import STRENGTHS
from virtual_phantom.proof.scoring.confusion import NOT_IN_LIBRARY, NOTHING, NOTHING_FITS

CASES = Path(__file__).with_name("proof_seed_16.yaml")
OUT = Path(__file__).resolve().parents[1] / "images" / "proof_confusion.png"


def matrix(found: dict) -> dict:
    """Return the cases in the form of proof.scoring.confusion.matrix."""
    other = {(case["hidden"], case["strength"]): case for case in found["other"]}
    rows = [(row, row, strength, "right") for row in found["effects"] for strength in STRENGTHS]
    rows = [row for row in rows if (row[0], row[2]) not in other]
    rows += [(case["hidden"], case["first"], case["strength"], case["outcome"]) for case in found["other"]]
    rows += [(NOTHING, NOTHING, None, "right")] * found["nothing"]
    missing = {NOT_IN_LIBRARY.format(name): first for name, first in found["not_in_library"].items()}
    rows += [(name, first, None, "right") for name, first in missing.items()]
    cells = [
        {"row": row, "column": column, "strength": strength, "count": count, "outcomes": {outcome: count}}
        for (row, column, strength, outcome), count in Counter(rows).items()
    ]
    columns = [*found["effects"], NOTHING, NOTHING_FITS]
    return {"rows": [*found["effects"], NOTHING, *missing], "columns": columns, "cells": cells}


def counts(drawn: dict) -> dict[str, list[int]]:
    """Return the counts of a matrix in the form of the record: right cases, and all cases."""
    found = {name: [0, 0] for name in ("first_medium_or_strong", "first_weak", "false_alarms", "unknown")}
    for cell in drawn["cells"]:
        right = cell["outcomes"].get("right", 0)
        if cell["row"] == NOTHING:
            name, right = "false_alarms", cell["count"] - right
        elif cell["strength"] is None:
            name = "unknown"
        else:
            name = "first_weak" if cell["strength"] == "weak" else "first_medium_or_strong"
        found[name][0] += right
        found[name][1] += cell["count"]
    return found


def main() -> None:
    """Check the cases and draw them."""
    drawn = matrix(yaml.safe_load(CASES.read_text(encoding="utf-8")))
    record = yaml.safe_load((RESOURCES / "proof_record.yaml").read_text(encoding="utf-8"))
    recorded = next(entry for entry in record if entry["seed"] == 16)["counts"]
    for name, count in counts(drawn).items():
        if recorded[name] != count:
            raise SystemExit(
                f"{CASES.name}: {name} is {count}, but {recorded[name]} in proof_record.yaml; correct the cases"
            )
    style.save(confusion.draw(drawn), [OUT])


if __name__ == "__main__":
    main()
