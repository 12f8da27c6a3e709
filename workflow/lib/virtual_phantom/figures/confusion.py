"""Confusion matrix of the blind validation: hidden effects and the effects that the diagnosis ranked first."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from . import style

STRENGTHS = ("weak", "medium", "strong")  # thirds of a cell, from the left
CELL_MM, LABELS_MM, HEAD_MM = 5.5, 60.0, 42.0
RIGHT, WRONG, ALTERNATIVE = style.BLUE, style.VERMILLION, "#FFFFFF"
INK = {"weak": 0.4, "medium": 0.75}  # fraction of the full color
DIAGONAL = "#EAEAEA"


def worst(outcomes: Mapping[str, int]) -> str:
    """Return the outcome that a group of cases is drawn with: the worst of its cases."""
    return next(name for name in ("wrong", "stand-in", "right") if outcomes[name])


@style.styled()
def draw(matrix: Mapping) -> Figure:
    """Draw the confusion matrix.

    A cell contains the counts of weak (light), medium and strong cases from left to right, or a single count without
    strengths. Filled blue is right and filled vermillion is wrong. A blue frame means that the hidden effect was
    reported as an alternative explanation.

    Parameters
    ----------
    matrix : mapping
        Keys rows, columns and cells. A cell has the keys row, column, strength, count and outcomes, and `outcomes`
        counts the cases of each outcome of proof.scoring.confusion.
    """
    rows, columns = list(matrix["rows"]), list(matrix["columns"])
    width = max(style.DOUBLE_COLUMN_MM, LABELS_MM + CELL_MM * len(columns))
    figure = style.figure(width, HEAD_MM + CELL_MM * len(rows))
    axes = figure.subplots()
    for index, row in enumerate(rows):
        if row in columns:
            axes.add_patch(
                Rectangle((columns.index(row) - 0.5, index - 0.5), 1, 1, facecolor=DIAGONAL, edgecolor="none")
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
    axes.set(xlabel="ranked first", ylabel="hidden effect")
    for edge in range(len(columns) + 1):
        axes.axvline(edge - 0.5, color="#CCCCCC", linewidth=0.4, zorder=0.5)
    for edge in range(len(rows) + 1):
        axes.axhline(edge - 0.5, color="#CCCCCC", linewidth=0.4, zorder=0.5)
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    keys = [
        Patch(facecolor=RIGHT, label="right (unknown effect: reported as unexplained)"),
        Patch(facecolor=ALTERNATIVE, edgecolor=RIGHT, label="hidden effect reported as alternative"),
        Patch(facecolor=WRONG, label="wrong"),
    ]
    title = "number of cases; thirds of a cell: weak (light), medium and strong effect"
    figure.legend(handles=keys, loc="outside lower center", ncols=3, title=title)
    return figure


def _cell(axes, column: int, row: int, cell: Mapping) -> None:
    strength = cell["strength"]
    left, width = (-0.46, 0.92) if strength is None else (-0.46 + 0.92 * STRENGTHS.index(strength) / 3, 0.92 / 3)
    outcome = worst(cell["outcomes"])
    ink = INK.get(strength, 1.0)
    full = np.array(to_rgb({"right": RIGHT, "wrong": WRONG, "stand-in": ALTERNATIVE}[outcome]))
    face = tuple(1 - ink * (1 - full))
    edge = RIGHT if outcome == "stand-in" else "white"
    axes.add_patch(
        Rectangle((column + left, row - 0.46), width, 0.92, facecolor=face, edgecolor=edge, linewidth=0.8, zorder=2)
    )
    color, middle = "black" if outcome == "stand-in" or strength == "weak" else "white", column + left + width / 2
    axes.text(middle, row, str(cell["count"]), ha="center", va="center_baseline", color=color, zorder=3)
