"""Record of the blind validation (docs/validation/blind-validation.md), proof_record.yaml. Run it by hand:

python workflow/scripts/proof_record.py add results/proof/score.json --state COMMIT --note "what differs" [--seen]
python workflow/scripts/proof_record.py coverage FIRST/score.json SECOND/score.json   95 % intervals side by side
python workflow/scripts/proof_record.py rows results/proof/score.json    one run as the table of the page
python workflow/scripts/proof_record.py pooled                           all unseen seeds, with intervals
"""

import argparse
import sys

from virtual_phantom.base.data import RESOURCES
from virtual_phantom.base.errors import InputError
from virtual_phantom.io.documents import SCORE, read_document
from virtual_phantom.proof.hiding import seal
from virtual_phantom.proof.scoring import record
from virtual_phantom.proof.scoring.rows import rows
from virtual_phantom.report.proof import tally
from virtual_phantom.statistics.proof_record import read_proof_record

RECORD = RESOURCES / "proof_record.yaml"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--record", default=RECORD, help="another record")
    tasks = parser.add_subparsers(dest="task", required=True)
    add = tasks.add_parser("add")
    add.add_argument("score", help="a run's score.json")
    add.add_argument("--state", required=True, help="of the code: its commit or version")
    add.add_argument("--note", required=True, help="in what the code or the suite differs from the last entry's")
    add.add_argument("--seen", action="store_true", help="the seed had been looked at, or something was tuned on it")
    coverage = tasks.add_parser("coverage")
    coverage.add_argument("first", help="a run's score.json")
    coverage.add_argument("second", help="another's")
    tasks.add_parser("rows").add_argument("score", help="a run's score.json")
    tasks.add_parser("pooled")
    asked = parser.parse_args()
    try:
        if asked.task == "add":
            record.add(asked.record, read_document(asked.score, SCORE), asked.state, asked.note, unseen=not asked.seen)
        if asked.task == "coverage":
            print("\n".join(record.coverage_table(seal.read(asked.first), seal.read(asked.second))))
            return 0
        if asked.task == "rows":
            print("\n".join(rows(read_document(asked.score, SCORE))))
            return 0
        shown = record.summary(read_proof_record(asked.record))
    except InputError as error:
        print(f"Error: {error}", file=sys.stderr)
        return 1
    print(f"seeds {', '.join(map(str, shown['pooled_seeds']))}")
    for name, share in shown["pooled"].items():
        print(f"{shown['quantities'][name]}: {tally(share)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
