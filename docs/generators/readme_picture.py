"""Draw the picture of the README from a completed default study: `python docs/generators/readme_picture.py RESULTS`.

It is a low version of the figure of stability and discriminative power, with the best features named inside the panels.
It is written to docs/images/stability_discrimination.png.
"""

import sys
from pathlib import Path

from virtual_phantom.figures import stability_discrimination, style
from virtual_phantom.io import files
from virtual_phantom.statistics import further_seeds, measured, robustness

OUT = Path(__file__).resolve().parents[1] / "images" / "stability_discrimination.png"
WIDTH_MM, HEIGHT_MM = 205, 74
NAMES = (0.03, 0.47), (0.66, 0.985)  # upper left corner of the list of the best features in each panel


def main(results: Path) -> None:
    """Draw the picture from the tables of a study."""
    table = files.read_csv(results / "tables" / "stability.csv")
    trust = robustness.between_protocols(files.read_csv(results / "tables" / "trust.csv"))
    sd = further_seeds.sd_over_seeds(further_seeds.read_seed_scores())
    repeats = int(measured.load_score_draws(10)["repeats"].iloc[0])
    figure = stability_discrimination.draw(
        table, 1.0, measured.load_score_draws(repeats), repeats=repeats, sd=sd, intervals=trust
    )
    figure.set_size_inches(WIDTH_MM / 25.4, HEIGHT_MM / 25.4)
    for axes, corner in zip(figure.axes, NAMES, strict=True):
        heading, names = (text for text in axes.texts if getattr(text, "xycoords", "") == "axes fraction")
        heading.remove()
        names.xy, names.xyann = corner, (0, 0)
        names.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 1.5})
        axes.set_xlabel("stability between protocols (%)")
    figure.axes[0].set_ylabel("discriminative power (%)")
    style.save(figure, [OUT])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
