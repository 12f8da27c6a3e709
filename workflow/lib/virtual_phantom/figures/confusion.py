"""Confusion matrix of the blind validation: hidden effects and the effects that the diagnosis ranked first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from . import style

CELL_MM, HEAD_MM, LEGEND_MM = 4.2, 32.0, 12.0  # height of a row, of the column labels and of the legend
ITSELF = "the hidden effect"  # first column
LOOK = {  # outcome: color of fill, edge and text; also different without color
    "right": (style.BLUE, style.BLUE, "white"),
    "alternative": ("white", style.BLUE, "black"),
    "wrong": ("#F6C9A8", style.VERMILLION, "black"),
}


def worst(outcomes: Mapping[str, int]) -> str:
    """Return the outcome that a group of cases is drawn with: the worst of its cases."""
    return next(name for name in ("wrong", "alternative", "right") if outcomes.get(name))


@style.styled()
def draw(matrix: Mapping) -> Figure:
    """Draw the shares of each row's cases by the effect that was ranked first; other cells are empty.

    The first column holds the cases whose hidden effect was ranked first. Other columns are the effects that were
    ranked first instead, the most frequent first. Rows are sorted by the share of right cases, the worst first: hidden
    effects of the library, nothing, and effects that the library lacks.

    Parameters
    ----------
    matrix : mapping
        Keys rows, columns and cells. The last two columns are for nothing and for differences without a named effect;
        the row of nothing has the name of its column. A cell has the keys row, column, count and outcomes, and
        `outcomes` counts the cases of each outcome of proof.scoring.confusion.
    """
    nothing, nothing_fits = matrix["columns"][-2:]
    counts: Counter = Counter()  # by row, column and outcome
    for cell in matrix["cells"]:
        column = ITSELF if cell["row"] == cell["column"] != nothing else cell["column"]
        for outcome, count in cell["outcomes"].items():
            counts[cell["row"], column, outcome] += count
    counts = +counts
    total, right, named = Counter(), Counter(), Counter()
    for (row, column, outcome), count in counts.items():
        total[row] += count
        right[row] += count * (outcome == "right")
        named[column] += count

    def place(row: str) -> tuple:
        return row == nothing or 2 * (row not in matrix["columns"]), right[row] / total[row], row

    rows = sorted((row for row in matrix["rows"] if total[row]), key=place)
    others = sorted(set(named) - {ITSELF, nothing, nothing_fits}, key=lambda column: (-named[column], column))
    columns = [ITSELF, *others, nothing, nothing_fits]

    figure = style.figure(style.DOUBLE_COLUMN_MM, HEAD_MM + LEGEND_MM + CELL_MM * len(rows))
    axes = figure.subplots()
    for edge in range(len(rows) + 1):
        axes.axhline(edge - 0.5, color="#DDDDDD", linewidth=0.4, zorder=0.5)
    for y, row in enumerate(rows):
        for x, column in enumerate(columns):
            outcomes = {name: counts[row, column, name] for name in LOOK}
            if count := sum(outcomes.values()):
                face, edge, color = LOOK[worst(outcomes)]
                box = {"facecolor": face, "edgecolor": edge, "linewidth": 0.8, "zorder": 2}
                axes.add_patch(Rectangle((x - 0.47, y - 0.42), 0.94, 0.84, **box))
                share = f"{100 * count / total[row]:.0f}"
                axes.text(x, y, share, ha="center", va="center_baseline", color=color, zorder=3)
    axes.set(xlim=(-0.5, len(columns) - 0.5), ylim=(len(rows) - 0.5, -0.5))
    axes.set_xticks(range(len(columns)), map(style.label, columns), rotation=45, ha="left", rotation_mode="anchor")
    axes.xaxis.tick_top()
    axes.xaxis.set_label_position("top")
    axes.set_yticks(range(len(rows)), [f"{style.label(row)} (n = {total[row]})" for row in rows])
    axes.set(xlabel="ranked first", ylabel="hidden")
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    meaning = {
        "right": "right (not in library: reported as unexplained)",
        "alternative": "hidden effect reported as alternative",
        "wrong": "wrong in at least one case",
    }
    keys = [Patch(facecolor=face, edgecolor=edge, label=meaning[name]) for name, (face, edge, _) in LOOK.items()]
    figure.legend(handles=keys, loc="outside lower center", ncols=3, title="percentage of the cases in a row")
    return figure
