"""Draw the confusion matrix of the last blind validation on record.

python docs/generators/proof_confusion.py results-proof/proof/score.json

The picture is docs/images/proof_confusion.png.
"""

import sys
from pathlib import Path

from virtual_phantom.base.data import RESOURCES
from virtual_phantom.figures import confusion, style
from virtual_phantom.io.documents import SCORE, read_document
from virtual_phantom.statistics.proof_record import read_proof_record

RECORD = RESOURCES / "proof_record.yaml"
OUT = Path(__file__).resolve().parents[1] / "images" / "proof_confusion.png"


def main(path: Path) -> None:
    """Draw the matrix of a score, if it is of the run that the pages show."""
    score, published = read_document(path, SCORE), read_proof_record(RECORD)[-1]
    if score["registration"]["commit"] != published.commit:
        raise SystemExit(f"{path}: is not of commit {published.commit}, the last one in {RECORD.name}")
    style.save(confusion.draw(score["confusion"]), [OUT])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
