"""What was concealed against what the diagnosis named first."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from . import style

PLACES = ("weak", "medium", "strong")  # thirds of a cell, from the left
CELL_MM, LABELS_MM, HEAD_MM = 5.5, 60.0, 42.0
RIGHT, WRONG, STAND_IN = style.BLUE, style.VERMILLION, "#FFFFFF"
INK = {"weak": 0.4, "medium": 0.75}  # share of the full colour
DIAGONAL = "#EAEAEA"


def worst(outcomes: Mapping[str, int]) -> str:
    """What a group of cases is drawn as: wrong if any is, else a stand-in if any is."""
    return next(name for name in ("wrong", "stand-in", "right") if outcomes[name])


@style.styled()
def draw(matrix: Mapping) -> Figure:
    """The confusion matrix.

    A cell holds counts of weak (light), medium and strong cases side by side, or one where there are no strengths.
    Filled blue is right, filled vermillion wrong; framed: the concealed effect was reported as an equal explanation.

    Parameters
    ----------
    matrix : mapping
        rows, columns, and cells {row, column, strength, count, outcomes {right, stand-in, wrong}}.
    """
    rows, columns = list(matrix["rows"]), list(matrix["columns"])
    width = max(style.DOUBLE_COLUMN_MM, LABELS_MM + CELL_MM * len(columns))
    figure = style.figure(width, HEAD_MM + CELL_MM * len(rows))
    axes = figure.subplots()
    for place, row in enumerate(rows):
        if row in columns:
            axes.add_patch(
                Rectangle((columns.index(row) - 0.5, place - 0.5), 1, 1, facecolor=DIAGONAL, edgecolor="none")
            )
    for cell in matrix["cells"]:
        _cell(axes, columns.index(cell["column"]), rows.index(cell["row"]), cell)
    axes.set(xlim=(-0.5, len(columns) - 0.5), ylim=(len(rows) - 0.5, -0.5), aspect="equal")
    axes.set_xticks(range(len(columns)), [style.label(name) for name in columns], rotation=55, ha="left")
    for text in axes.get_xticklabels():
        text.set_rotation_mode("anchor")
    axes.xaxis.set_ticks_position("top")
    axes.xaxis.set_label_position("top")
    axes.set_yticks(range(len(rows)), [style.label(name) for name in rows])
    axes.set(xlabel="named first", ylabel="concealed")
    for edge in range(len(columns) + 1):
        axes.axvline(edge - 0.5, color="#CCCCCC", linewidth=0.4, zorder=0.5)
    for edge in range(len(rows) + 1):
        axes.axhline(edge - 0.5, color="#CCCCCC", linewidth=0.4, zorder=0.5)
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    keys = [
        Patch(facecolor=RIGHT, label="right; of an effect not in the library: something is left unexplained"),
        Patch(facecolor=STAND_IN, edgecolor=RIGHT, label="concealed one reported as its equal"),
        Patch(facecolor=WRONG, label="wrong"),
    ]
    figure.legend(
        handles=keys,
        loc="outside lower center",
        ncols=3,
        title="number of cases; thirds of a cell: weak (light), medium, strong",
    )
    return figure


def _cell(axes, column: int, row: int, cell: Mapping) -> None:
    strength = cell["strength"]
    left, width = (-0.46, 0.92) if strength is None else (-0.46 + 0.92 * PLACES.index(strength) / 3, 0.92 / 3)
    outcome = worst(cell["outcomes"])
    ink = INK.get(strength, 1.0)
    full = np.array(to_rgb({"right": RIGHT, "wrong": WRONG, "stand-in": STAND_IN}[outcome]))
    face = tuple(1 - ink * (1 - full))
    edge = RIGHT if outcome == "stand-in" else "white"
    axes.add_patch(
        Rectangle((column + left, row - 0.46), width, 0.92, facecolor=face, edgecolor=edge, linewidth=0.8, zorder=2)
    )
    axes.text(
        column + left + width / 2,
        row,
        str(cell["count"]),
        ha="center",
        va="center_baseline",
        color="black" if outcome == "stand-in" or strength == "weak" else "white",
        zorder=3,
    )
