"""Record of the blind validation (docs/validation/blind-validation.md), proof_record.yaml. Run it by hand:

python workflow/scripts/proof_record.py add results/proof/score.json --note "what to know"
    add a registered run and fill the pages
python workflow/scripts/proof_record.py pages
    fill the pages with the last run
python workflow/scripts/proof_record.py coverage FIRST/score.json SECOND/score.json
    coverage of 95 % intervals side by side
python workflow/scripts/proof_record.py rows results/proof/score.json
    one run as a table
"""

import argparse
import sys
from pathlib import Path

from virtual_phantom.base.data import RESOURCES
from virtual_phantom.base.errors import InputError
from virtual_phantom.io.documents import SCORE, read_document
from virtual_phantom.io.files import replacing
from virtual_phantom.proof.hiding import seal
from virtual_phantom.proof.scoring import record
from virtual_phantom.proof.scoring.rows import rows
from virtual_phantom.statistics.proof_record import read_proof_record

RECORD = RESOURCES / "proof_record.yaml"
ROOT = Path(__file__).resolve().parents[2]
PAGES = ("README.md", "docs/validation/blind-validation.md")  # with the results of the last run


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--record", default=RECORD, help="another record")
    parser.add_argument("--root", type=Path, default=ROOT, help="another folder with the pages")
    tasks = parser.add_subparsers(dest="task", required=True)
    add = tasks.add_parser("add")
    add.add_argument("score", help="score.json of a registered run")
    add.add_argument("--note", required=True, help="what a reader must know before comparing the counts with others")
    tasks.add_parser("pages")
    coverage = tasks.add_parser("coverage")
    coverage.add_argument("first", help="score.json of a run")
    coverage.add_argument("second", help="score.json of another run")
    tasks.add_parser("rows").add_argument("score", help="score.json of a run")
    asked = parser.parse_args()
    try:
        if asked.task == "coverage":
            print("\n".join(record.coverage_table(seal.read(asked.first), seal.read(asked.second))))
            return 0
        if asked.task == "rows":
            print("\n".join(rows(read_document(asked.score, SCORE))))
            return 0
        if asked.task == "add":
            runs = Path(asked.score).with_name("runs.jsonl")
            record.add(asked.record, read_document(asked.score, SCORE), runs, asked.note)
        run = read_proof_record(asked.record)[-1]
        for page in PAGES:
            path = asked.root / page
            text = record.filled(path.read_text(encoding="utf-8"), run)
            with replacing(path, checksum=False) as made:
                made.write_text(text, encoding="utf-8")
            print(f"{page}: run of commit {run.commit}")
    except InputError as error:
        print(f"Error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
