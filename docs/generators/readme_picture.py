"""Draw the picture of the README from a completed default study: `python docs/generators/readme_picture.py RESULTS`.

It is the figure of stability and discriminative power without its controls, and is written to
docs/images/stability_discrimination.png.
"""

import sys
from pathlib import Path

from virtual_phantom.figures import stability_discrimination, style
from virtual_phantom.io import files
from virtual_phantom.statistics import further_seeds, measured, robustness

OUT = Path(__file__).resolve().parents[1] / "images" / "stability_discrimination.png"


def main(results: Path) -> None:
    """Draw the picture from the tables of a study."""
    table = files.read_csv(results / "tables" / "stability.csv")
    trust = robustness.between_protocols(files.read_csv(results / "tables" / "trust.csv"))
    sd = further_seeds.sd_over_seeds(further_seeds.read_seed_scores())
    draws = measured.load_score_draws(10, "all")
    figure = stability_discrimination.draw(table, 1.0, draws, repeats=10, sd=sd, intervals=trust)
    style.save(figure, [OUT])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
