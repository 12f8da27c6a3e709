"""Draw the example of a blind validation: `python docs/generators/proof_before_after.py results-quick-proof/proof`.

The case is chosen by `proof.scoring.example.example`. The picture is docs/images/proof_before_after.png.
"""

import sys
from pathlib import Path

from virtual_phantom.figures import before_after, style
from virtual_phantom.proof.scoring.collect import collect
from virtual_phantom.proof.scoring.example import example, in_words, residual_maps

OUT = Path(__file__).resolve().parents[1] / "images" / "proof_before_after.png"


def main(proof: Path) -> None:
    """Choose the case among the scored cases of a blind validation and draw it."""
    names = sorted(path.name for path in (proof / "diagnosis").iterdir())
    files = {
        "sealed": [proof / "sealed" / f"{name}.json" for name in names],
        "seals": proof / "seals.json",
        "verdicts": [proof / "verdicts" / f"{name}.json" for name in names],
        "diagnoses": [proof / "diagnosis" / name / "diagnosis.json" for name in names],
        "others": [proof / "diagnosis" / name / "held_out_protocol.json" for name in names],
    }
    shown = example(collect(**files))
    maps = residual_maps(proof / "diagnosis" / shown.name / "maps")
    print(
        f"{shown.name}: hidden {', '.join(shown.hidden)}, named {', '.join(shown.named)}, {shown.diagnosis['verdict']}"
    )
    style.save(before_after.draw(*maps, shown.kind, *in_words(shown)), [OUT])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
